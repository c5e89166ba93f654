/** Selection, order and grouping of the jobs on the page. */

import { fraction, secondsLeft } from './progress';
import type { Job } from './types';

export type SortKey =
  | 'job'
  | 'name'
  | 'state'
  | 'progress'
  | 'left'
  | 'frames'
  | 'time'
  | 'age'
  | 'owner'
  | 'priority'
  | 'workers'
  | 'rate'
  | 'error';

/**
 * Returns the submission date in Unix seconds. Jobs submitted to an older coordinator have only the farm's clock,
 * which stands still during outages.
 */
export const submissionDate = (job: Job): number | null => job.submitted_date ?? job.submitted;

const STATE_ORDER = ['running', 'queued', 'paused', 'failed', 'done', 'cancelled'];

const KEYS: Record<SortKey, (job: Job) => number | string> = {
  job: (job) => job.job,
  name: (job) => job.name.toLowerCase(),
  state: (job) => STATE_ORDER.indexOf(job.state),
  progress: fraction,
  left: (job) => secondsLeft(job) ?? Infinity,
  frames: (job) => job.frames,
  time: (job) => job.seconds,
  age: (job) => -(submissionDate(job) ?? Infinity),
  owner: (job) => job.owner.toLowerCase(),
  priority: (job) => job.priority,
  workers: (job) => job.workers,
  rate: (job) => job.samples_per_second,
  error: (job) => job.relative_error ?? Infinity,
};

/**
 * Checks whether a job matches all words of a filter: `owner:ann`, `state:failed`, `name:drive`, `label:shot=12`, the
 * number of a job, or a part of name, owner or comment. A word that begins with `-` must not match.
 */
export function matches(job: Job, filter: string): boolean {
  return filter
    .split(/\s+/)
    .filter(Boolean)
    .every((word) => {
      const not = word.length > 1 && word.startsWith('-');
      return fits(job, (not ? word.slice(1) : word).toLowerCase()) !== not;
    });
}

function fits(job: Job, word: string): boolean {
  const colon = word.indexOf(':');
  const [key, value] = [word.slice(0, Math.max(colon, 0)), word.slice(colon + 1)];
  if (key === 'owner') return job.owner.toLowerCase().startsWith(value);
  if (key === 'state') return value.split(',').includes(job.state);
  if (key === 'label') {
    const [label, wanted] = value.split('=');
    return Object.entries(job.labels).some(
      ([name, known]) => name.toLowerCase() === label && (wanted === undefined || known.toLowerCase() === wanted),
    );
  }
  if (key === 'name') return job.name.toLowerCase().includes(value);
  return (
    String(job.job) === word || [job.name, job.owner, job.comment].some((text) => text.toLowerCase().includes(word))
  );
}

export interface Order {
  key: SortKey;
  descending: boolean;
}

/** Parses an order such as `-job`. An unknown key gives the newest first. */
export function parseOrder(text: string | undefined): Order {
  const descending = text?.startsWith('-') ?? true;
  const key = (text ?? '-job').replace(/^-/, '');
  return key in KEYS ? { key: key as SortKey, descending } : { key: 'job', descending: true };
}

/** Returns the jobs sorted; equal ones by number. */
export function sorted(jobs: Iterable<Job>, { key, descending }: Order): Job[] {
  const of = KEYS[key];
  const sign = descending ? -1 : 1;
  return [...jobs].sort((a, b) => {
    const [x, y] = [of(a), of(b)];
    return x < y ? -sign : x > y ? sign : sign * (a.job - b.job);
  });
}

export type Grouping = 'none' | 'scene' | 'owner' | 'state';

/** A row of the table: a group heading, or a job. */
export type Line = { kind: 'group'; key: string; jobs: Job[] } | { kind: 'job'; job: Job };

/** Property that the jobs of a group share. */
const GROUPS: Record<Exclude<Grouping, 'none'>, (job: Job) => string> = {
  scene: (job) => job.scene,
  owner: (job) => job.owner,
  state: (job) => job.state,
};

/** Returns the rows of the table. A group stands at the place of its first job. */
export function lines(jobs: Job[], grouping: Grouping, closed: ReadonlySet<string>): Line[] {
  if (grouping === 'none') return jobs.map((job) => ({ kind: 'job', job }));
  const groups = new Map<string, Job[]>();
  for (const job of jobs) {
    const key = GROUPS[grouping](job);
    const group = groups.get(key);
    if (group) group.push(job);
    else groups.set(key, [job]);
  }
  const all: Line[] = [];
  for (const [key, members] of groups) {
    all.push({ kind: 'group', key, jobs: members });
    if (!closed.has(key)) all.push(...members.map((job): Line => ({ kind: 'job', job })));
  }
  return all;
}
