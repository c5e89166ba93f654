/** The attempts of a job that have ended: read once, and then as they come. */

import { api } from './api';
import { Attempts } from './attempts';
import { Resource } from './stores.svelte';
import type { Attempt } from './types';

/** Most attempts that a page reads of a job. */
export const MOST_ATTEMPTS = 200_000;

/** A job's attempts, for all views of it. */
export function attemptsOf(job: number): Resource<Attempt[]> {
  const read = new Attempts();
  return new Resource(async (signal) => {
    let count = 0;
    for (let more = true; more && count < MOST_ATTEMPTS;) {
      more = read.add(await api.attempts(job, read.cursor, signal));
      count = read.size;
    }
    return read.all();
  });
}
