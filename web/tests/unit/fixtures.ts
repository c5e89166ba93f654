import { MAGIC } from '../../src/lib/pixels';
import type { Attempt, Job, OfflineWorker, Worker } from '../../src/lib/types';

export const job = (number: number, more: Partial<Job> = {}): Job => ({
  job: number,
  name: 'drive',
  state: 'running',
  owner: 'ann',
  scene: 'drive.mgf',
  comment: '',
  labels: {},
  notify: null,
  priority: 50,
  frames: 4,
  frames_done: 0,
  frames_failed: 0,
  samples: 0,
  samples_most: 0,
  samples_per_second: 0,
  bad_samples: 0,
  relative_error: null,
  seconds: 10,
  submitted: null,
  submitted_date: null,
  workers: 1,
  failure: null,
  active: [],
  copies: 0,
  quarantined: [],
  waits: [],
  ...more,
});

export const worker = (number: number, name = `node-${number}`): Worker => ({
  worker: number,
  name,
  threads: 8,
  tags: [],
  tasks: [],
  silent_seconds: 0,
  completed: 0,
  failed: 0,
  intake: 'open',
  engine: 'e',
});

export const offline = (name: string, last_contact: number): OfflineWorker => ({
  name,
  threads: 8,
  tags: [],
  engine: 'e',
  intake: 'offline',
  last_contact,
});

export const attempt = (task: string, began: number, ended: number, more: Partial<Attempt> = {}): Attempt => ({
  job: 1,
  task,
  frame: 1,
  stage: 'render',
  attempt: 1,
  epoch: began * 10,
  worker: 'node-1',
  ending: 'done',
  began_seconds: began,
  ended_seconds: ended,
  wait_seconds: 0,
  wall_seconds: ended - began,
  cpu_seconds: null,
  peak_memory_bytes: null,
  samples: null,
  rays: null,
  ...more,
});

/** Encodes pixels as a coordinator sends them. */
export function encode(
  width: number,
  height: number,
  planes: Record<string, number[]>,
  magic = MAGIC,
  version = 1,
): ArrayBuffer {
  const words = (...values: number[]) => new Uint8Array(new Uint32Array(values).buffer);
  const parts = [words(magic, version, width, height, Object.keys(planes).length)];
  for (const name of Object.keys(planes)) {
    const text = new TextEncoder().encode(name);
    parts.push(words(text.length), text);
  }
  for (const plane of Object.values(planes)) parts.push(new Uint8Array(new Uint16Array(plane).buffer));
  const out = new Uint8Array(parts.reduce((n, part) => n + part.length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out.buffer;
}
