/** Data sets that a job's light can be compared with. */

import { formatNumbers } from '../route';
import type { Job } from '../types';
import { formatSource } from './api';

export interface Choice {
  /** Data set, as in the address. */
  value: string;
  label: string;
  /** Heading in the menu. */
  group: string;
}

const MOST_FRAMES = 200;
const MOST_VARIANTS = 200;
const MOST_JOBS = 50;

/** Names of the labels whose values differ; null: the jobs are not variants of one sweep, which labels each job with its values. */
export function variedLabels(a: Job, b: Job): string[] | null {
  const [own, other] = [Object.keys(a.labels), Object.keys(b.labels)];
  if (a.scene !== b.scene || own.length !== other.length || !own.every((name) => name in b.labels)) return null;
  const varied = own.filter((name) => a.labels[name] !== b.labels[name]);
  return varied.length ? varied : null;
}

/**
 * Returns the other frames of a job, the other variants of its sweep, and other jobs, the newest first.
 * - `frames`: numbers of all frames of the job
 * - `chosen`: frames that are shown
 */
export function lightChoices(job: Job, jobs: readonly Job[], frames: readonly number[], chosen: readonly number[]): Choice[] {
  const group = 'frames of this job';
  const own = frames.slice(0, MOST_FRAMES).map((n) => ({ value: formatSource({ job: job.job, frames: [n] }), label: `frame ${n}`, group }));
  if (chosen.length > 1)
    own.push({ value: formatSource({ job: job.job, frames: chosen }), label: `frames ${formatNumbers(chosen)}`, group });
  const others = jobs.filter((it) => it.job !== job.job).sort((x, y) => y.job - x.job);
  const what = `${chosen.length > 1 ? 'frames' : 'frame'} ${formatNumbers(chosen)}`;
  const valueOf = (it: Job) => formatSource({ job: it.job, frames: chosen });
  const variants: Choice[] = [];
  const rest: Choice[] = [];
  for (const it of others) {
    const varied = variedLabels(job, it);
    const values = varied?.map((name) => `${name.split('.').at(-1)}=${it.labels[name]}`).join(', ');
    if (values) variants.push({ value: valueOf(it), label: `${values}, ${what} (job ${it.job})`, group: 'variants of this sweep' });
    else rest.push({ value: valueOf(it), label: `job ${it.job} ${it.name}, ${what}`, group: 'other jobs' });
  }
  return [...own, ...variants.slice(0, MOST_VARIANTS), ...rest.slice(0, MOST_JOBS)];
}
