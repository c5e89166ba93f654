/** Requests to the coordinator. */

import type { Attempt, AuditLine, Done, Frame, Job, JobAction, LogRecord, Me, Spec, TaskWindow } from './types';
import { decodePixels, type Pixels } from './pixels';

const BASE = '/api/v1';
const FRAME_WINDOW = 10_000;
/** Largest number of jobs that the coordinator accepts in one request. */
export const MOST_JOBS = 1000;

/** An error answer of the coordinator, or no answer (`status` 0). */
export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    message: string,
    readonly help: string | null = null,
  ) {
    super(message);
  }
}

/** Describes an error for people: the message, and what to do. */
export function explain(error: unknown): string {
  if (error instanceof ApiError) return error.help ? `${error.message} (${error.help})` : error.message;
  return error instanceof Error ? error.message : String(error);
}

/** Reads the error from an unsuccessful answer. */
export async function failure(answer: Response): Promise<ApiError> {
  const text = await answer.text().catch(() => '');
  try {
    const { error } = JSON.parse(text) as { error: { code: string; message: string; help?: string | null } };
    return new ApiError(answer.status, error.code, error.message, error.help ?? null);
  } catch {
    const first = text.trim().split('\n')[0];
    return new ApiError(
      answer.status,
      'unknown',
      first && first.length < 300 ? first : `the coordinator answered ${answer.status}`,
    );
  }
}

async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(path, { credentials: 'same-origin', ...init });
  } catch (error) {
    if (init.signal?.aborted) throw error;
    const change = 'the page does not send it again: when the page is live, check the state and repeat the action if needed';
    const help = init.method === 'POST' ? change : 'the page retries automatically';
    throw new ApiError(0, 'unreachable', 'the coordinator does not answer', help);
  }
  if (!answer.ok) throw await failure(answer);
  return answer;
}

const get = async <T>(path: string, signal?: AbortSignal): Promise<T> =>
  (await ask(BASE + path, { signal: signal ?? null, cache: 'no-cache' })).json() as Promise<T>;

const post = async <T>(path: string, body: unknown): Promise<T> =>
  (
    await ask(BASE + path, {
      method: 'POST',
      headers: { 'Content-Type': 'application/json', 'X-Femc': '1' },
      body: JSON.stringify(body),
    })
  ).json() as Promise<T>;

function query(values: Record<string, string | number | null | undefined>): string {
  const kept = Object.entries(values).filter(([, v]) => v != null && v !== '');
  return kept.length ? `?${new URLSearchParams(kept.map(([k, v]) => [k, String(v)]))}` : '';
}

export interface TaskFilter {
  frame?: string | null;
  stage?: string | null;
  state?: string | null;
  /** Field of tasks to sort by; a leading `-` puts the greatest first. */
  sort?: string | null;
}

/** A frame of a job and what is wanted of it, or a statistics file. */
export type PixelSource = { job: number; frame: number; what: 'pixels' | 'maps' } | { file: number };

/** The pixels, or null until there are some. `etag` changes when they change. */
export interface PixelAnswer {
  pixels: Pixels | null;
  etag: string | null;
}

export const api = {
  me: (signal?: AbortSignal) => get<Me>('/me', signal),
  job: (job: number, signal?: AbortSignal) => get<{ job: Job; spec: Spec }>(`/jobs/${job}`, signal),
  /** Returns all frames of a job. They are requested in windows. */
  async frames(job: number, signal?: AbortSignal): Promise<Frame[]> {
    const all: Frame[] = [];
    for (;;) {
      const path = `/jobs/${job}/frames${query({ from: all.length, count: FRAME_WINDOW })}`;
      const { frames, total } = await get<{ frames: Frame[]; total: number }>(path, signal);
      all.push(...frames);
      if (frames.length < FRAME_WINDOW || all.length >= total) return all;
    }
  },
  /** Returns a window of tasks. `filter.sort` orders all tasks, not only the window. */
  tasks: (job: number, from: number, count: number, filter: TaskFilter, signal?: AbortSignal) =>
    get<TaskWindow>(`/jobs/${job}/tasks${query({ from, count, ...filter })}`, signal),
  /** Returns a page of the ended attempts of the job, or of a task, from a cursor on. */
  attempts: (job: number, from: number | null, task: string | null, signal?: AbortSignal) =>
    get<{ attempts: Attempt[]; next: number | null }>(`/jobs/${job}/attempts${query({ from, task })}`, signal),
  /** Returns the message of a task that has failed for good; `null` for any other task. */
  failure: async (job: number, task: string, signal?: AbortSignal): Promise<string | null> => {
    const named = /^[^/]+\/(\d+)\.\d+\/[^/.]+\.?(\d*)\//.exec(task);
    const filter = { frame: Number(named?.[1] ?? 0), state: 'failed', ...(named?.[2] ? { stage: Number(named[2]) } : {}) };
    const { tasks } = await get<TaskWindow>(`/jobs/${job}/tasks${query({ from: 0, count: 1000, ...filter })}`, signal);
    return tasks.find((failed) => failed.task === task)?.failure ?? null;
  },
  logs: async (job: number, task: string | null, signal?: AbortSignal) =>
    (await get<{ records: LogRecord[] }>(`/jobs/${job}/logs${query({ task })}`, signal)).records,
  thumbnail: (job: number, frame: number, version: string, height = 90) =>
    `${BASE}/jobs/${job}/frames/${frame}/thumbnail.png${query({ height, v: version })}`,

  /** Returns the pixels of a frame or file, or its light statistics for each pixel; `undefined` if `etag` still matches. */
  async pixels(source: PixelSource, etag: string | null, signal?: AbortSignal): Promise<PixelAnswer | undefined> {
    const path = 'file' in source ? `files/${source.file}/maps` : `jobs/${source.job}/frames/${source.frame}/${source.what}`;
    const answer = await fetch(`${BASE}/${path}`, {
      signal: signal ?? null,
      cache: 'no-store',
      headers: etag ? { 'If-None-Match': etag } : {},
    }).catch((error: unknown) => {
      if (signal?.aborted) throw error;
      throw new ApiError(0, 'unreachable', 'the coordinator does not answer');
    });
    if (answer.status === 304) return undefined;
    if (answer.status === 204) return { pixels: null, etag: null };
    if (!answer.ok) throw await failure(answer);
    return { pixels: decodePixels(await answer.arrayBuffer()), etag: answer.headers.get('ETag') };
  },

  /** Returns the media type of a file. */
  async fileType(address: string, signal?: AbortSignal): Promise<string> {
    const answer = await ask(address, { method: 'HEAD', signal: signal ?? null });
    return answer.headers.get('Content-Type') ?? 'application/octet-stream';
  },
  /** Returns true if a file is undamaged: the coordinator reads all of it before it sends the first byte. */
  async checkFile(address: string): Promise<true> {
    await ask(address, { headers: { Range: 'bytes=0-0' }, cache: 'no-store' });
    return true;
  },

  /** Controls jobs, in as many requests as they need. After a failed request, the rest is not sent. */
  async control(jobs: number[], action: JobAction, more: { priority?: number; frames?: number[] } = {}) {
    const all: Done<number> = { done: [], refused: [] };
    for (let at = 0; at < jobs.length; at += MOST_JOBS) {
      const part = jobs.slice(at, at + MOST_JOBS);
      try {
        const { done, refused } = await post<Done<number>>('/jobs/control', { jobs: part, action, ...more });
        all.done.push(...done);
        all.refused.push(...refused);
      } catch (error) {
        if (at === 0) throw error;
        const { code, message } = error instanceof ApiError ? error : { code: 'unknown', message: explain(error) };
        all.refused.push(...jobs.slice(at).map((job) => ({ job, code, message })));
        break;
      }
    }
    return all;
  },
  drain: (workers: (number | string)[], action: 'begin' | 'undo') =>
    post<Done<number | string>>('/workers/drain', { workers, action }),
  audit: async (count: number, signal?: AbortSignal) =>
    (await get<{ lines: AuditLine[] }>(`/audit${query({ count })}`, signal)).lines,

  /** Exchanges a token for the cookie. */
  async login(token: string): Promise<void> {
    await ask('/login', {
      method: 'POST',
      headers: { 'X-Femc': '1' },
      body: new URLSearchParams({ token }),
    });
  },
  async logout(): Promise<void> {
    await ask('/logout', { method: 'POST', headers: { 'X-Femc': '1' }, body: new URLSearchParams() });
  },
};
