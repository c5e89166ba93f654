/** Order of the axes of a plot. */

import type { AxisView } from './contract';

/** Returns the axes that are shown, in their order on the screen. */
export const shownViews = (views: readonly AxisView[]): AxisView[] => views.filter((it) => !it.hidden);

/** Returns the views with a shown axis moved to place `to` among the shown ones. Hidden axes keep their places. */
export function moved(views: readonly AxisView[], index: number, to: number): AxisView[] {
  const shown = shownViews(views);
  const from = shown.findIndex((it) => it.index === index);
  if (from < 0) return [...views];
  const [view] = shown.splice(from, 1);
  shown.splice(Math.min(Math.max(to, 0), shown.length), 0, view!);
  let next = 0;
  return views.map((it) => (it.hidden ? it : shown[next++]!));
}

/** Returns the views with settings of an axis changed. */
export const changed = (views: readonly AxisView[], index: number, to: Partial<AxisView>): AxisView[] =>
  views.map((it) => (it.index === index ? { ...it, ...to } : it));

/** Returns the pairs of neighbors on the screen. */
export function pairs(views: readonly AxisView[]): [number, number][] {
  const shown = shownViews(views);
  return shown.slice(1).map((it, i) => [shown[i]!.index, it.index]);
}
