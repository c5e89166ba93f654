/** Values under the pointer: those of a bar of an axis, and the line nearest to a place between two axes. */

import { percent, quantity } from '../../format';
import { barsOf, MIN_BAR_HEIGHT, shareIn, type Bar } from './bars';
import { unitOf, valueText, type Column } from './column';
import type { PlotSet } from './contract';
import { heightAt, lengthOf, yOf, type Layout } from './layout';
import { nearestLine, type Nearest } from './nearest';
import { formatValue, heightsOf } from './scale';

/** Greatest distance of the nearest line, in pixels. */
const REACH = 7;
const NONE = new Float32Array();

/** Texts of the bar under the pointer. */
export interface Tip {
  x: number;
  y: number;
  head: string;
  rows: { name: string; text: string; kind: SetKind }[];
}

/** Color of a set: `a`, `b`, or none if there is only one. */
export type SetKind = 'a' | 'b' | '';
export const setKind = (number: number, sets: readonly PlotSet[]): SetKind =>
  sets.length < 2 ? '' : number === 0 ? 'a' : 'b';

/** Returns the name of a set, with the records that its bins count. */
const setName = (number: number, sets: readonly PlotSet[]) =>
  (sets.length > 1 ? `${['A', 'B'][number]}, ` : '') + sets[number]!.basis;

const distance = ({ from, to }: Bar, at: number) => (at < from ? from - at : at > to ? at - to : 0);

/** Returns the texts of the bar under the pointer; null if the pointer is not at an axis. */
export function tipAt(columns: readonly Column[], sets: readonly PlotSet[], layout: Layout, x: number, y: number): Tip | null {
  const column = columns[Math.round((x - layout.left) / layout.spacing)];
  if (!column || Math.abs(x - column.x) > (column.scale.isCategorical ? 18 : 14)) return null;
  const height = heightAt(layout, y, column.flipped);
  const bars = barsOf(column, MIN_BAR_HEIGHT / lengthOf(layout));
  const bar = bars.reduce((a, b) => (distance(b, height) < distance(a, height) ? b : a), bars[0]!);
  if (!bar) return null;
  const rows = sets.flatMap((set, number) => rowsOf(bar, column.index, set, setName(number, sets), setKind(number, sets)));
  return { x: column.x, y, head: headOf(column, bar, height), rows };
}

function headOf({ scale, axis }: Column, bar: Bar, height: number): string {
  if (axis.categories) return valueText(axis, bar.bins[0]!);
  if (scale.base > 0 && bar.bins[0] === 0) return axis.edges ? '0' : 'no position';
  const [first, last] = [scale.bin(bar.bins[0]!), scale.bin(bar.bins.at(-1)!)];
  if (axis.scale === 'count' && last[1] - first[0] === 1) return `${first[0]}`;
  return `${formatValue(scale.value(height))}${unitOf(axis)}  (${formatValue(first[0])} … ${formatValue(last[1])})`;
}

function rowsOf(bar: Bar, index: number, set: PlotSet, name: string, kind: SetKind): Tip['rows'] {
  const share = shareIn(bar, set.bins[index], set.total);
  const rows: Tip['rows'] = [{ name, text: `${quantity(share * set.total)} (${percent(share)})`, kind }];
  if (set.selectedBins) {
    const chosen = shareIn(bar, set.selectedBins[index], set.selectedTotal);
    // With different bases, the quotient of the shares is an estimate.
    const part = share > 0 ? Math.min(chosen / share, 1) : 0;
    rows.push({
      name: set.basis === 'recorded' ? 'selected' : 'selected, recorded',
      text: `${quantity(chosen * set.selectedTotal)} (${percent(part)})`,
      kind: '',
    });
  }
  return rows;
}

/** Returns the line nearest to the pointer between two axes; null if none is near. */
export function lineAt(columns: readonly Column[], sets: readonly PlotSet[], layout: Layout, x: number, y: number): Nearest | null {
  const at = (x - layout.left) / layout.spacing;
  const place = Math.floor(at);
  const [a, b] = [columns[place], columns[place + 1]];
  if (!a || !b) return null;
  const between = sets.map((it) => ({
    left: heightsOf(it.values[a.index], a.scale),
    right: heightsOf(it.values[b.index], b.scale),
    selected: it.selected,
    rows: it.rows,
  }));
  const length = lengthOf(layout);
  return nearestLine(between, at - place, (layout.bottom - y) / length, [a.flipped, b.flipped], REACH / length);
}

/** Point of a line on an axis, and its value. */
export interface LinePoint {
  index: number;
  x: number;
  y: number;
  text: string;
}

/** Returns the points of a line on all axes. */
export function pointsOf({ set, row }: Nearest, columns: readonly Column[], sets: readonly PlotSet[], layout: Layout): LinePoint[] | null {
  const values = sets[set]?.values;
  if (!values) return null;
  return columns.map(({ index, axis, scale, x, flipped }) => {
    const own = values[index] ?? NONE;
    const y = yOf(layout, heightsOf(own, scale)[row] ?? 0, flipped);
    return { index, x, y, text: valueText(axis, own[row] ?? NaN) };
  });
}
