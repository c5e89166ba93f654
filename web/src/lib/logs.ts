/** Explains why a task has no log. */

import type { Attempt } from './types';

/**
 * Returns the reason why a task has no log, derived from its ended attempts; `null`: the attempts are not known yet.
 */
export function noLog(attempts: readonly Attempt[] | null): string {
  if (!attempts) return 'Asking.';
  const has = (ending: string) => attempts.some((attempt) => attempt.ending === ending);
  if (attempts.length === 0) return 'No attempt has ended, and a log comes with the end.';
  if (has('failed'))
    return 'No log of the failed attempt is there: a job keeps a limited number of logs of failures, or the worker could not send it.';
  if (has('lost')) return 'No log is there: the worker was lost before it sent one.';
  if (!has('done')) return 'No log is there: the attempt was taken back before it ended.';
  return 'No log is kept: logs of tiles that went well are short-lived.';
}
