/** Density of all lines between two neighboring axes, from their joint histogram. */

import { BINS } from './scale';

/** Resolution of the density between two axes. */
export const COLUMNS = 64;
export const ROWS = 128;

/** Heights of the bins of an axis. */
export interface BinSpans {
  from: Float32Array;
  to: Float32Array;
  flipped: boolean;
}

/**
 * Adds the density of lines to `target`, in multiples of an even density: `ROWS` rows from the bottom up, of `COLUMNS` pixels
 * each.
 * - `counts`: joint counts; row: bin of the left axis, column: bin of the right axis
 * - `stride`, `offset`: numbers of `target` a pixel, and the one written
 */
export function addDensity(
  counts: ArrayLike<number>,
  left: BinSpans,
  right: BinSpans,
  target: Float32Array,
  stride = 1,
  offset = 0,
): void {
  let total = 0;
  for (let i = 0; i < BINS * BINS; i++) total += counts[i]!;
  if (!(total > 0)) return;
  for (let i = 0; i < BINS; i++) {
    const [l0, l1] = ends(left, i);
    for (let j = 0; j < BINS; j++) {
      const share = counts[BINS * i + j]! / total;
      if (!(share > 0)) continue;
      const [r0, r1] = ends(right, j);
      for (let column = 0; column < COLUMNS; column++) {
        const t = (column + 0.5) / COLUMNS;
        let low = (l0 + (r0 - l0) * t) * ROWS;
        let high = (l1 + (r1 - l1) * t) * ROWS;
        if (high - low < 1) {
          // Thinner than a row: as if it were one row high.
          const middle = Math.min(Math.max((low + high) / 2, 0.5), ROWS - 0.5);
          [low, high] = [middle - 0.5, middle + 0.5];
        }
        const density = (share * ROWS) / (high - low);
        const last = Math.min(Math.ceil(high), ROWS);
        for (let row = Math.max(Math.floor(low), 0); row < last; row++) {
          const part = Math.min(high, row + 1) - Math.max(low, row);
          target[(row * COLUMNS + column) * stride + offset]! += density * part;
        }
      }
    }
  }
}

function ends({ from, to, flipped }: BinSpans, bin: number): [number, number] {
  return flipped ? [1 - to[bin]!, 1 - from[bin]!] : [from[bin]!, to[bin]!];
}
