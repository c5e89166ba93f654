/** Selection of made-up rows. */

import { isEmpty } from '../../../src/lib/light/plot/brush';
import type { Brush, PlotSet } from '../../../src/lib/light/plot/contract';

/** Returns whether a value is in a brush. */
function has(brush: Brush, value: number, isCategorical: boolean): boolean {
  const inside = isCategorical
    ? brush.categories.includes(value)
    : brush.ranges.some(([from, to]) => value >= from && value <= to);
  return inside !== brush.inverted;
}

/** Returns a mask of the rows that all brushes select; null without brushes. */
export function selectRows(
  set: Pick<PlotSet, 'values' | 'rows'>,
  brushes: readonly Brush[],
  isCategorical: (axis: number) => boolean,
): Uint8Array | null {
  const active = brushes.filter((it) => !isEmpty(it));
  if (active.length === 0) return null;
  const mask = new Uint8Array(set.rows).fill(1);
  for (const brush of active) {
    const values = set.values[brush.axis];
    if (!values) continue;
    const words = isCategorical(brush.axis);
    for (let i = 0; i < set.rows; i++) if (mask[i] && !has(brush, values[i]!, words)) mask[i] = 0;
  }
  return mask;
}
