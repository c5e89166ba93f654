/** Collects the attempts of a job while they are read. */

import type { Attempt } from './types';

/**
 * Attempts read in pages, each once: a later row with the same task and epoch replaces an earlier one. The next read
 * begins at the last page.
 */
export class Attempts {
  private readonly seen = new Map<string, Attempt>();
  cursor: number | null = null;

  /** Adds a page; returns whether another one may follow. */
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
