/** The ended attempts of a job. They are read once, then extended as new ones end. */

import { api } from './api';
import { Attempts } from './attempts';
import { Resource } from './stores.svelte';
import type { Attempt } from './types';

/** Largest number of attempts that a page reads of a job. */
export const MOST_ATTEMPTS = 200_000;

/** Returns the attempts of a job, or of one of its tasks. */
export function attemptsOf(job: number, task: string | null = null): Resource<Attempt[]> {
  const read = new Attempts();
  return new Resource(async (signal) => {
    for (let more = true; more && read.size < MOST_ATTEMPTS;) {
      more = read.add(await api.attempts(job, read.cursor, task, signal));
    }
    return read.all();
  });
}
