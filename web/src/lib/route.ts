/** URLs of the pages. They hold the view, so that a link shows another person the same. */

import { ranges } from './format';

export type JobTab = 'frames' | 'picture' | 'light' | 'tasks' | 'timeline' | 'logs' | 'settings' | 'clip';
/** Views of a job, in the order of their tabs. */
export const JOB_TABS: readonly JobTab[] = ['frames', 'picture', 'light', 'tasks', 'timeline', 'logs', 'settings', 'clip'];
/** Views of a job that the keys from `1` on open. */
export const TAB_KEYS: readonly JobTab[] = ['frames', 'picture', 'tasks', 'timeline', 'logs', 'settings', 'clip', 'light'];

export type Route =
  | { page: 'jobs' }
  | { page: 'job'; job: number; tab: JobTab }
  | { page: 'workers' }
  | { page: 'audit' }
  | { page: 'view' }
  | { page: 'login' }
  | { page: 'unknown'; path: string };

/** Parses the path of a page. */
export function parsePath(path: string): Route {
  const parts = path.split('/').filter(Boolean);
  const [first, second, third] = parts;
  if (parts.length === 0 || (first === 'jobs' && parts.length === 1)) return { page: 'jobs' };
  if (parts.length === 1 && (['workers', 'audit', 'view', 'login'].includes(first!))) {
    return { page: first as 'workers' | 'audit' | 'view' | 'login' };
  }
  const tab = (third ?? 'frames') as JobTab;
  if (first === 'jobs' && parts.length <= 3 && /^\d{1,15}$/.test(second!) && JOB_TABS.includes(tab)) {
    return { page: 'job', job: Number(second), tab };
  }
  return { page: 'unknown', path };
}

/** Returns the path of a page. */
export function pathOf(route: Route): string {
  switch (route.page) {
    case 'jobs':
      return '/jobs';
    case 'job':
      return route.tab === 'frames' ? `/jobs/${route.job}` : `/jobs/${route.job}/${route.tab}`;
    case 'unknown':
      return route.path;
    default:
      return `/${route.page}`;
  }
}

/** Values of a URL, as text. Null and empty values are left out. */
export type Query = Readonly<Record<string, string>>;

export function parseQuery(search: string): Query {
  return Object.fromEntries(new URLSearchParams(search));
}

export function formatQuery(query: Query): string {
  // Commas and slashes are legal in a query and are more readable without escapes.
  const text = new URLSearchParams(query)
    .toString()
    .replaceAll('%2C', ',')
    .replaceAll('%2F', '/')
    .replaceAll('%3A', ':')
    .replaceAll('%3B', ';');
  return text ? `?${text}` : '';
}

/**
 * Largest length of a value in a query. URLs of more than a few kilobytes are rejected on their way to the
 * coordinator.
 */
const LONGEST_VALUE = 1500;

/**
 * Formats the end of a URL, from `?` on. Long values, such as thousands of jobs, go into its fragment, which is not
 * sent.
 */
export function formatAddress(query: Query): string {
  const isLong = ([, value]: [string, string]) => value.length > LONGEST_VALUE;
  const all = Object.entries(query);
  const [short, long] = [all.filter((it) => !isLong(it)), all.filter(isLong)];
  return formatQuery(Object.fromEntries(short)) + formatQuery(Object.fromEntries(long)).replace('?', '#');
}

/** Parses the values of a URL. */
export const parseAddress = ({ search, hash }: { search: string; hash: string }): Query => ({
  ...parseQuery(search),
  ...parseQuery(hash.replace('#', '?')),
});

/** Returns `query` with some values changed; null and the empty text remove a value. */
export function withValues(query: Query, values: Record<string, string | number | null | undefined>): Query {
  const next: Record<string, string> = { ...query };
  for (const [key, value] of Object.entries(values)) {
    if (value == null || value === '') delete next[key];
    else next[key] = String(value);
  }
  return next;
}

const MOST_NUMBERS = 1 << 20;

/** Parses numbers from a text like `1..4,7`; other parts are left out. */
export function parseNumbers(text: string | undefined): number[] {
  const numbers: number[] = [];
  for (const part of (text ?? '').split(',')) {
    const match = /^\s*(\d{1,10})(?:\.\.(\d{1,10}))?\s*$/.exec(part);
    if (!match) continue;
    const [first, last] = [Number(match[1]), Number(match[2] ?? match[1])];
    for (let n = first; n <= last && numbers.length < MOST_NUMBERS; n++) numbers.push(n);
  }
  return numbers;
}

export const formatNumbers = (numbers: Iterable<number>): string => ranges(numbers).replaceAll(' ', '');
