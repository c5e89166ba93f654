/** Measures of frames, for coloring, charts and sorting. */

import { percent, seconds } from './format';
import type { Frame } from './types';

export interface Measure {
  key: string;
  title: string;
  hint: string;
  of: (frame: Frame) => number | null;
  format: (value: number | null) => string;
}

/** Times of a frame. The first one depends on the frame alone, not on the farm's other work. */
export const TIMES: readonly Measure[] = [
  {
    key: 'processor',
    title: 'processor',
    hint: "Processor time of all attempts at the frame's tasks",
    of: (frame) => frame.processor_seconds ?? null,
    format: seconds,
  },
  {
    key: 'wall',
    title: 'at workers',
    hint: "Time that workers spent on the frame's tasks, summed over all attempts",
    of: (frame) => frame.wall_seconds ?? null,
    format: seconds,
  },
  {
    key: 'waiting',
    title: 'waiting',
    hint: 'Time without a running attempt, from the first lease to the end of the last one: workers did other tasks, also of other jobs',
    of: (frame) => frame.waiting_seconds ?? null,
    format: seconds,
  },
  {
    key: 'seconds',
    title: 'first to last',
    hint: 'Time from the first lease to the last result, including waiting',
    of: (frame) => frame.seconds,
    format: seconds,
  },
];

/** All measures. */
export const MEASURES: readonly Measure[] = [
  ...TIMES,
  {
    key: 'error',
    title: 'error',
    hint: "Relative error of the frame's worst block",
    of: (frame) => frame.relative_error,
    format: percent,
  },
];

/** Returns the frame whose attempts took the most processor time. */
export function slowest(frames: readonly Frame[]): Frame | null {
  let most: Frame | null = null;
  for (const frame of frames) {
    if (frame.processor_seconds != null && frame.processor_seconds > (most?.processor_seconds ?? 0)) most = frame;
  }
  return most;
}
