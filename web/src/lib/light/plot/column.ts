/** Axes of a plot with everything that the screen shows of them. */

import { brushOf } from './brush';
import type { Axis, AxisView, Brush, PlotSet } from './contract';
import { xOf, yOf, type Layout } from './layout';
import { axisScale, formatValue, type AxisScale } from './scale';

/** An axis on the screen. */
export interface Column extends AxisView {
  axis: Axis;
  scale: AxisScale;
  x: number;
  brush: Brush;
}

const NO_BINS = new Float64Array();

interface KnownScale {
  axis: Axis;
  log: boolean;
  bins: readonly Float64Array[];
  scale: AxisScale;
}

/** Scales of the axes. They change with the data and the settings of an axis, not with its place or its brush. */
export class Scales {
  private readonly known = new Map<number, KnownScale>();

  /** Returns the scale of an axis. A scale with equal heights is the same object. */
  scaleOf(axis: Axis, log: boolean, sets: readonly PlotSet[]): AxisScale {
    const bins = sets.map((set) => set.bins[axis.index] ?? NO_BINS);
    const known = this.known.get(axis.index);
    const isSame = known?.axis === axis && known.log === log && known.bins.length === bins.length;
    if (isSame && known.bins.every((list, i) => list === bins[i])) return known.scale;
    const made = axisScale(axis, log, bins);
    const scale = known?.scale.key === made.key && known.axis.edges === axis.edges ? known.scale : made;
    this.known.set(axis.index, { axis, log, bins, scale });
    return scale;
  }
}

/** Columns of a plot. A column that does not change stays the same object, so that its elements are left alone. */
export class Columns {
  private known = new Map<number, { column: Column; text: string }>();

  /** Returns the columns of the shown axes, in the order of `shown`. */
  columnsOf(
    shown: readonly { view: AxisView; axis: Axis; scale: AxisScale }[],
    layout: Layout,
    brushes: readonly Brush[],
  ): Column[] {
    const next = new Map<number, { column: Column; text: string }>();
    const columns = shown.map(({ view, axis, scale }, place): Column => {
      const [x, brush] = [xOf(layout, place), brushOf(brushes, view.index)];
      const ranges = brush.ranges.map(([low, high]) => `${low}:${high}`);
      const text = `${x} ${view.log} ${view.flipped} ${brush.inverted} ${ranges} | ${brush.categories}`;
      const known = this.known.get(view.index);
      const isSame = known?.text === text && known.column.axis === axis && known.column.scale === scale;
      const column = isSame ? known.column : { ...view, axis, scale, x, brush };
      next.set(view.index, { column, text });
      return column;
    });
    this.known = next;
    return columns;
  }
}

const UNITS: Record<string, string> = { film: ' px', world: ' m', radiance: ' cd/m²', throughput: '', count: '' };

/** Returns the unit of an axis, with a space before it; empty if it has none. */
export const unitOf = (axis: Axis): string => UNITS[axis.scale] ?? '';

/** Returns the text of a value of an axis. */
export const valueText = (axis: Axis, value: number): string =>
  axis.categories ? (axis.categories[value] ?? 'none') : formatValue(value);

/** Returns the parts of a name: `radiance` and `r`. */
export function nameParts(name: string): [string, string] {
  const at = name.lastIndexOf('.');
  return at < 0 ? ['', name] : [name.slice(0, at), name.slice(at + 1)];
}

/** Returns a text that has room in `width` pixels. Of names such as `room.wall`, the last part remains. */
export function cut(text: string, width: number): string {
  const most = Math.max(3, Math.floor((width - 6) / 5.9));
  if (text.length <= most) return text;
  const last = text.slice(text.lastIndexOf('.') + 1);
  return last.length < text.length && last.length < most ? `…${last}` : `${text.slice(0, most - 1)}…`;
}

/** Part of an axis, in pixels. */
export interface Span {
  top: number;
  size: number;
  /** Number of the range or category in its brush. */
  range: number;
}

/** Returns the parts of an axis that its brush selects or, if it is inverted, leaves out. */
export function spansOf({ scale, brush, flipped }: Column, layout: Layout): Span[] {
  const list = scale.isCategorical ? brush.categories.map((it): [number, number] => [it, it]) : brush.ranges;
  return list.map((range, number) => {
    const [a, b] = scale.span(range).map((at) => yOf(layout, at, flipped));
    const [top, end] = [Math.min(a!, b!), Math.max(a!, b!)];
    return { top, size: Math.max(end - top, 2), range: number };
  });
}

/** Least distance of the labels of categories, in pixels. */
const MIN_LABEL_DISTANCE = 14;

export interface Label {
  text: string;
  y: number;
  category: number;
}

/** Returns the labels of categories that have room: those of the largest first, none over another. */
export function labelsOf({ scale, axis, flipped }: Column, layout: Layout): Label[] {
  const placed: Label[] = [];
  const bySize = scale.order.toSorted((a, b) => scale.to[b]! - scale.from[b]! - (scale.to[a]! - scale.from[a]!));
  for (const category of bySize) {
    const y = yOf(layout, (scale.from[category]! + scale.to[category]!) / 2, flipped);
    if (placed.every((it) => Math.abs(it.y - y) >= MIN_LABEL_DISTANCE)) placed.push({ text: valueText(axis, category), y, category });
  }
  return placed;
}
