/**
 * The tasks of a job as a virtual table reads them: windows of five hundred, those in sight asked for again when the
 * job changes.
 */

import { api, explain, type TaskFilter } from './api';
import type { Task } from './types';

export const WINDOW = 500;
/** Windows kept beside those in sight. */
const KEPT = 40;

export class TaskWindows {
  total = $state(0);
  error = $state<string | null>(null);
  known = $state(false);
  /** Counts answers: what reads it is drawn again. */
  answers = $state(0);
  private readonly windows = new Map<number, Task[]>();
  private readonly asked = new Map<number, AbortController>();
  private sight: [number, number] = [0, 0];
  private timer: ReturnType<typeof setTimeout> | undefined;
  private stale = false;

  constructor(
    private readonly job: number,
    private readonly filter: TaskFilter,
    private readonly ask: typeof api.tasks = api.tasks,
  ) {}

  /** The task at a place, or undefined as long as it is not there. */
  at(index: number): Task | undefined {
    return this.windows.get(Math.floor(index / WINDOW))?.[index % WINDOW];
  }

  /** These places are in sight; what is missing of them is asked for, once scrolling rests. */
  show(first: number, last: number) {
    this.sight = [first, last];
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.fetch(false), this.known ? 60 : 0);
  }

  /** The job has changed: what is in sight is asked for again, at most once a second. */
  changed() {
    if (this.stale) return;
    this.stale = true;
    setTimeout(() => {
      this.stale = false;
      this.fetch(true);
    }, 1000);
  }

  stop() {
    clearTimeout(this.timer);
    for (const abort of this.asked.values()) abort.abort();
    this.asked.clear();
    this.stale = true;
  }

  private fetch(again: boolean) {
    const [first, last] = this.sight;
    const [from, to] = [Math.floor(first / WINDOW), Math.floor(Math.max(last - 1, first) / WINDOW)];
    for (const [number, abort] of this.asked) {
      if (number >= from && number <= to) continue;
      abort.abort();
      this.asked.delete(number);
    }
    for (let number = from; number <= to; number++) {
      if (this.asked.has(number) || (!again && this.windows.has(number))) continue;
      void this.load(number);
    }
  }

  private async load(number: number) {
    const abort = new AbortController();
    this.asked.set(number, abort);
    try {
      const { total, tasks } = await this.ask(this.job, number * WINDOW, WINDOW, this.filter, abort.signal);
      this.windows.delete(number);
      this.windows.set(number, tasks);
      for (const old of this.windows.keys()) {
        if (this.windows.size <= KEPT) break;
        this.windows.delete(old);
      }
      this.total = total;
      this.error = null;
      this.known = true;
      this.answers++;
    } catch (error) {
      if (!abort.signal.aborted) this.error = explain(error);
    } finally {
      if (this.asked.get(number) === abort) this.asked.delete(number);
    }
  }
}
