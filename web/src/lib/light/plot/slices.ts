/**
 * Drawing of all plots of a page, in slices. The plots share the main thread with the rest of the page, so none of them may use a
 * budget of its own: a slice does pieces of all plots in turn until its time is over. Between two slices, the browser handles input
 * and shows frames. The price is that a drawing is on the screen in parts for a moment.
 */

/** Work that is done in pieces of a few milliseconds. */
export interface Job {
  /** Does a piece of the work. Returns whether more is left. */
  step(): boolean;
}

/** Milliseconds of a slice. */
const SLICE_MS = 8;

/** Access to the browser. */
export interface Clock {
  now(): number;
  /** Runs a function before the next frame, and not while the page is hidden. */
  frame(run: () => void): void;
  /** Runs a function as the next task. */
  task(run: () => void): void;
}

export class Slices {
  private jobs: Job[] = [];
  private isWaiting = false;

  constructor(
    private readonly clock: Clock,
    private readonly sliceMs = SLICE_MS,
  ) {}

  /** Adds work, unless it is there already. It begins with the next frame, so that all changes of a frame are drawn together. */
  add(job: Job): void {
    if (!this.jobs.includes(job)) this.jobs.push(job);
    if (this.isWaiting) return;
    this.isWaiting = true;
    this.clock.frame(this.run);
  }

  remove(job: Job): void {
    this.jobs = this.jobs.filter((it) => it !== job);
  }

  private readonly run = (): void => {
    const { clock } = this;
    const end = clock.now() + this.sliceMs;
    do {
      const job = this.jobs.shift();
      if (!job) break;
      if (job.step() && !this.jobs.includes(job)) this.jobs.push(job);
    } while (clock.now() < end);
    this.isWaiting = this.jobs.length > 0;
    if (this.isWaiting) clock.task(this.run);
  };
}

/** Returns the clock of this page. Messages follow one another faster than timers. */
function pageClock(): Clock {
  const { port1, port2 } = new MessageChannel();
  const waiting: (() => void)[] = [];
  port1.onmessage = () => waiting.shift()?.();
  return {
    now: () => performance.now(),
    frame: (run) => void requestAnimationFrame(run),
    task(run) {
      waiting.push(run);
      port2.postMessage(null);
    },
  };
}

let shared: Slices | null = null;

/** Returns the slices of this page. */
export const pageSlices = (): Slices => (shared ??= new Slices(pageClock()));
