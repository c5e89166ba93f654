/** Brushes: sets of ranges or categories on axes. All functions return new objects. */

import type { Brush } from './contract';

type Range = [number, number];

/** Returns the brush of an axis; a new one without ranges if there is none. */
export const brushOf = (brushes: readonly Brush[], axis: number): Brush =>
  brushes.find((it) => it.axis === axis) ?? { axis, ranges: [], categories: [], inverted: false };

/** Returns whether a brush selects anything but everything. */
export const isEmpty = (brush: Brush): boolean => brush.ranges.length === 0 && brush.categories.length === 0;

/** Returns the brushes with the one of an axis replaced, or without it if it is empty. */
export function withBrush(brushes: readonly Brush[], brush: Brush): Brush[] {
  const at = brushes.findIndex((it) => it.axis === brush.axis);
  if (isEmpty(brush)) return brushes.filter((it) => it.axis !== brush.axis);
  return at < 0 ? [...brushes, brush] : brushes.map((it, i) => (i === at ? brush : it));
}

/** Returns ranges in rising order, with the overlapping ones joined; on discrete axes, adjoining ones too. */
export function joined(ranges: readonly (readonly [number, number])[], isDiscrete = false): Range[] {
  const sorted = ranges.map(([a, b]): Range => [Math.min(a, b), Math.max(a, b)]).sort((a, b) => a[0] - b[0]);
  const result: Range[] = [];
  for (const range of sorted) {
    const last = result.at(-1);
    if (last && range[0] <= last[1] + (isDiscrete ? 1 : 0)) last[1] = Math.max(last[1], range[1]);
    else result.push(range);
  }
  return result;
}

/** Returns a brush with a category added or taken away. */
export function toggled(brush: Brush, category: number): Brush {
  const { categories } = brush;
  const without = categories.filter((it) => it !== category);
  return {
    ...brush,
    categories: without.length < categories.length ? without : [...categories, category].sort((a, b) => a - b),
  };
}
