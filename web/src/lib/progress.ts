/** Progress of a job. */

import type { Job } from './types';

export const hasEnded = (job: Job): boolean =>
  job.state === 'done' || job.state === 'failed' || job.state === 'cancelled';

/** Returns the finished fraction, 0..1: finished frames and, for frames in progress, the tiles of their rounds. */
export function fraction(job: Job): number {
  if (job.state === 'done') return 1;
  let inWork = 0;
  for (const frame of job.active) {
    if (frame.frame === 0) continue;
    const round = Math.max(frame.round, 1) - 1;
    const rounds = Math.max(frame.rounds, 1);
    inWork += Math.min((round + frame.tiles_done / Math.max(frame.tiles, 1)) / rounds, 1);
  }
  const open = Math.max(job.frames - job.frames_done, 0);
  return Math.min((job.frames_done + Math.min(inWork, open)) / Math.max(job.frames, 1), 1);
}

/** Estimates the seconds left at the speed so far; null if unknown. */
export function secondsLeft(job: Job): number | null {
  const done = fraction(job);
  if (job.state !== 'running' || job.workers === 0 || done < 0.005) return null;
  return (job.seconds * (1 - done)) / done;
}
