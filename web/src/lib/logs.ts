/** Explains why a task has no log. */

import type { Attempt } from './types';

/**
 * Returns the reason why a task has no log, derived from its ended attempts; `null`: the attempts are not known yet.
 */
export function noLog(attempts: readonly Attempt[] | null): string {
  if (!attempts) return 'Loading.';
  const has = (ending: string) => attempts.some((attempt) => attempt.ending === ending);
  if (attempts.length === 0) return 'No attempt has ended yet. A log is written when an attempt ends.';
  if (has('failed'))
    return 'The log of the failed attempt is missing: a job keeps a limited number of failure logs, or the worker could not send it.';
  if (has('lost')) return 'No log: the worker was lost before it sent one.';
  if (!has('done')) return 'No log: the lease was revoked before the attempt ended.';
  return 'No log: logs of successful tiles are short-lived.';
}
