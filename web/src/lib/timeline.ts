/** Layout of a job's attempts: a band for each worker, with as many lanes as attempts ran in parallel. */

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
  /** Seconds by the farm's clock. */
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
