/**
 * The tasks of a job for a virtual table, in windows of five hundred. Visible windows are requested again when the
 * job changes.
 */

import { api, explain, type TaskFilter } from './api';
import type { Task } from './types';

export const WINDOW = 500;
/** Number of windows to keep besides the visible ones. */
const KEPT = 40;

export class TaskWindows {
  total = $state(0);
  error = $state<string | null>(null);
  known = $state(false);
  /** Number of answers so far. Components that read it are drawn again after every answer. */
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

  /** Returns the task at an index, or undefined until it is loaded. */
  at(index: number): Task | undefined {
    return this.windows.get(Math.floor(index / WINDOW))?.[index % WINDOW];
  }

  /** Sets the visible range. Missing tasks are requested once scrolling stops. */
  show(first: number, last: number) {
    this.sight = [first, last];
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.fetch(false), this.known ? 60 : 0);
  }

  /** Requests the visible windows again after a change of the job, at most once a second. */
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
