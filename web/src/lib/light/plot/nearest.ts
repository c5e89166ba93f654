/** Line nearest to the pointer. */

/** Heights of the lines of a set at two neighboring axes. */
export interface Between {
  left: Float32Array;
  right: Float32Array;
  /** 1 for lines that may be found; null: all. */
  selected: Uint8Array | null;
  rows: number;
}

export interface Nearest {
  set: number;
  row: number;
}

/**
 * Returns the line nearest to a point between two axes.
 * - `t`: place between the axes, 0 to 1
 * - `y`: height on the screen, 0 to 1
 * - `reach`: greatest distance
 */
export function nearestLine(
  sets: readonly Between[],
  t: number,
  y: number,
  [leftFlipped, rightFlipped]: readonly [boolean, boolean],
  reach: number,
): Nearest | null {
  let found: Nearest | null = null;
  let least = reach;
  sets.forEach(({ left, right, selected, rows }, set) => {
    for (let row = 0; row < rows; row++) {
      if (selected && !selected[row]) continue;
      const [a, b] = [left[row]!, right[row]!];
      const at = (leftFlipped ? 1 - a : a) * (1 - t) + (rightFlipped ? 1 - b : b) * t;
      const distance = Math.abs(at - y);
      if (distance < least) [least, found] = [distance, { set, row }];
    }
  });
  return found;
}
