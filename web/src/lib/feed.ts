/**
 * The feed of changes: server-sent events, read with `fetch`. `EventSource` would hide the coordinator's signs of
 * life and give up for good after an error answer.
 */

import { ApiError, failure } from './api';
import type { Job, OfflineWorker, Worker } from './types';

/** The farm as this page knows it. */
export interface FarmState {
  /** Position from which the next connection continues. */
  seq: string | null;
  jobs: ReadonlyMap<number, Job>;
  workers: ReadonlyMap<number, Worker>;
  /** Former workers, the latest first. */
  offline: readonly OfflineWorker[];
  warnings: readonly string[];
}

export interface Snapshot {
  seq: string;
  jobs: Job[];
  workers: Worker[];
  offline: OfflineWorker[];
  warnings: string[];
}

export interface Delta {
  seq: string;
  jobs?: Job[];
  gone_jobs?: number[];
  workers?: Worker[];
  gone_workers?: number[];
  /** Null: unchanged. */
  offline?: OfflineWorker[] | null;
  warnings?: string[] | null;
}

export const EMPTY: FarmState = { seq: null, jobs: new Map(), workers: new Map(), offline: [], warnings: [] };

export function fromSnapshot(snapshot: Snapshot): FarmState {
  return {
    seq: snapshot.seq,
    jobs: new Map(snapshot.jobs.map((job) => [job.job, job])),
    workers: new Map(snapshot.workers.map((worker) => [worker.worker, worker])),
    offline: snapshot.offline,
    warnings: snapshot.warnings,
  };
}

/** Returns the state after a delta and leaves the old state unchanged. Unchanged maps are the same objects. */
export function join(state: FarmState, delta: Delta): FarmState {
  return {
    seq: delta.seq,
    jobs: merge(state.jobs, delta.jobs, (job) => job.job, delta.gone_jobs),
    workers: merge(state.workers, delta.workers, (worker) => worker.worker, delta.gone_workers),
    offline: delta.offline ?? state.offline,
    warnings: delta.warnings ?? state.warnings,
  };
}

function merge<T>(
  before: ReadonlyMap<number, T>,
  changed: T[] = [],
  key: (item: T) => number,
  gone: number[] = [],
): ReadonlyMap<number, T> {
  if (changed.length === 0 && gone.length === 0) return before;
  const after = new Map(before);
  for (const item of changed) after.set(key(item), item);
  for (const number of gone) after.delete(number);
  return after;
}

export interface FeedEvent {
  id: string | null;
  event: string;
  data: string;
}

/** Parser of server-sent events from pieces of text (WHATWG HTML, 9.2.6). Comments are dropped. */
export class EventParser {
  private rest = '';
  private id: string | null = null;
  private event = '';
  private data: string[] = [];

  push(text: string): FeedEvent[] {
    const events: FeedEvent[] = [];
    const lines = (this.rest + text).split(/\r\n|\n|\r(?!$)/);
    this.rest = lines.pop()!;
    for (const line of lines) {
      if (line === '') {
        if (this.data.length) events.push({ id: this.id, event: this.event || 'message', data: this.data.join('\n') });
        this.event = '';
        this.data = [];
        continue;
      }
      const colon = line.indexOf(':');
      if (colon === 0) continue;
      const field = colon < 0 ? line : line.slice(0, colon);
      const value = colon < 0 ? '' : line.slice(colon + 1).replace(/^ /, '');
      if (field === 'data') this.data.push(value);
      else if (field === 'event') this.event = value;
      else if (field === 'id') this.id = value;
    }
    return events;
  }
}

/** State of the connection. `denied`: the coordinator requires a login. */
export type Connection =
  | { state: 'connecting' }
  | { state: 'live' }
  | { state: 'lost'; since: number; again: number; why: string }
  | { state: 'denied'; why: string };

export interface Watcher {
  /** - `delta`: null, if the state comes from a snapshot. */
  farm(state: FarmState, delta: Delta | null): void;
  connection(connection: Connection): void;
}

/** Silence after which a connection counts as lost. The coordinator sends a sign of life every ten seconds. */
export const SILENCE_MS = 25_000;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5_000;

/** Follows the feed until it is stopped. */
export class Feed {
  private stopped = false;
  private abort = new AbortController();
  private hurry: (() => void) | null = null;
  private lostSince: number | null = null;

  constructor(
    private readonly watcher: Watcher,
    private readonly request: typeof fetch = (...args) => fetch(...args),
    private readonly now: () => number = Date.now,
    /** Known state; the first connection asks for the changes since then. */
    private state: FarmState = EMPTY,
  ) {}

  /** Connects and reconnects; returns when stopped or denied. */
  async run(): Promise<void> {
    let failures = 0;
    while (!this.stopped) {
      const before = this.state;
      let why = 'the coordinator ended the connection';
      try {
        await this.follow();
      } catch (error) {
        if (this.stopped) return;
        if (error instanceof ApiError && (error.status === 401 || error.status === 403)) {
          this.watcher.connection({ state: 'denied', why: error.message });
          return;
        }
        why = error instanceof ApiError ? error.message : 'the coordinator does not answer';
      }
      if (this.stopped) return;
      failures = this.state === before ? failures + 1 : 1;
      const wait = Math.min(FIRST_WAIT_MS * 2 ** (failures - 1), LONGEST_WAIT_MS);
      this.lostSince ??= this.now();
      this.watcher.connection({ state: 'lost', since: this.lostSince, again: this.now() + wait, why });
      await new Promise<void>((resolve) => {
        const timer = setTimeout(resolve, wait);
        this.hurry = () => {
          clearTimeout(timer);
          resolve();
        };
      });
      this.hurry = null;
    }
  }

  /** Retries at once. */
  again(): void {
    this.hurry?.();
  }

  stop(): void {
    this.stopped = true;
    this.abort.abort();
    this.hurry?.();
  }

  private async follow(): Promise<void> {
    this.abort = new AbortController();
    const { signal } = this.abort;
    let timer = setTimeout(() => this.abort.abort(), SILENCE_MS);
    const alive = () => {
      clearTimeout(timer);
      timer = setTimeout(() => this.abort.abort(), SILENCE_MS);
    };
    try {
      const headers: Record<string, string> = { Accept: 'text/event-stream' };
      if (this.state.seq !== null) headers['Last-Event-ID'] = this.state.seq;
      const answer = await this.request('/api/v1/feed', {
        headers,
        signal,
        cache: 'no-store',
        credentials: 'same-origin',
      });
      if (!answer.ok || !answer.body) throw await failure(answer);
      this.lostSince = null;
      this.watcher.connection({ state: 'live' });
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      const ended = () => void reader.cancel().catch(() => {});
      signal.addEventListener('abort', ended);
      const parser = new EventParser();
      for (;;) {
        const { done, value } = await reader.read();
        if (done) return;
        alive();
        for (const event of parser.push(value)) this.on(event);
      }
    } finally {
      clearTimeout(timer);
    }
  }

  private on({ event, data }: FeedEvent): void {
    if (event !== 'snapshot' && event !== 'delta') return;
    const delta = event === 'delta' ? (JSON.parse(data) as Delta) : null;
    this.state = delta ? join(this.state, delta) : fromSnapshot(JSON.parse(data) as Snapshot);
    this.watcher.farm(this.state, delta);
  }
}
