/** Attempts of a job, as they are read. */

import type { Attempt } from './types';

/**
 * Attempts that were read in pages, each once: a later row of the same task and epoch takes the place of an earlier
 * one. Where
 * the last page was, the next reading begins.
 */
export class Attempts {
  private readonly seen = new Map<string, Attempt>();
  cursor: number | null = null;

  /** Takes a page; whether another one may follow. */
  add(page: { attempts: readonly Attempt[]; next: number | null }): boolean {
    let fresh = 0;
    for (const attempt of page.attempts) {
      const key = `${attempt.task} ${attempt.epoch}`;
      if (!this.seen.has(key)) fresh++;
      this.seen.set(key, attempt);
    }
    const moved = page.next !== null && page.next !== this.cursor;
    if (page.next !== null) this.cursor = page.next;
    return moved && fresh > 0;
  }

  get size(): number {
    return this.seen.size;
  }

  all(): Attempt[] {
    return [...this.seen.values()];
  }
}
