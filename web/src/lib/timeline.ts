/** The attempts of a job in lanes: a band for each worker, in it as many lanes as attempts ran side by side. */

import type { Attempt } from './types';

export interface Bar {
  attempt: Attempt;
  lane: number;
}

export interface Band {
  worker: string;
  first: number;
  lanes: number;
}

export interface Layout {
  bars: Bar[];
  bands: Band[];
  lanes: number;
  /** Seconds since the job's first lease. */
  begin: number;
  end: number;
}

export function layout(attempts: readonly Attempt[]): Layout {
  const byWorker = new Map<string, Attempt[]>();
  let [begin, end] = [Infinity, -Infinity];
  for (const attempt of attempts) {
    const own = byWorker.get(attempt.worker);
    if (own) own.push(attempt);
    else byWorker.set(attempt.worker, [attempt]);
    begin = Math.min(begin, attempt.began_seconds);
    end = Math.max(end, attempt.ended_seconds);
  }
  const bars: Bar[] = [];
  const bands: Band[] = [];
  let first = 0;
  for (const worker of [...byWorker.keys()].sort()) {
    const ends: number[] = [];
    for (const attempt of byWorker
      .get(worker)!
      .sort((a, b) => a.began_seconds - b.began_seconds || a.epoch - b.epoch)) {
      let lane = ends.findIndex((until) => until <= attempt.began_seconds);
      if (lane < 0) lane = ends.push(0) - 1;
      ends[lane] = attempt.ended_seconds;
      bars.push({ attempt, lane: first + lane });
    }
    bands.push({ worker, first, lanes: ends.length });
    first += ends.length;
  }
  return {
    bars,
    bands,
    lanes: first,
    begin: attempts.length ? begin : 0,
    end: attempts.length ? Math.max(end, begin + 1e-3) : 1,
  };
}

/** Attempts that were read in pages, each once. */
export class Attempts {
  private readonly seen = new Map<string, Attempt>();
  cursor: number | string | null = null;

  /** Takes a page; whether another one may follow. */
  add(page: { attempts: readonly Attempt[]; next: number | string | null }): boolean {
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

  all(): Attempt[] {
    return [...this.seen.values()];
  }
}
