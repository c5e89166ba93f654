/**
 * Scales of the axes of a plot: values to heights and back, bins and ticks. A height is 0 at the lower end of an axis and
 * 1 at the upper end, before it is flipped.
 */

import type { Axis } from './contract';

/** Number of bins of an attribute. */
export const BINS = 64;
/** Height of the place for records without a value (zero radiance, no position), and of the gap above it. */
const SLOT = 0.05;
const GAP = 0.025;

/** Scale of an axis with given data. */
export interface AxisScale {
  /** Text that changes whenever heights of values change. */
  key: string;
  isCategorical: boolean;
  /** Whether values are integers, each with the height of a cell. */
  isDiscrete: boolean;
  isLog: boolean;
  /** Range of values shown, without the slot. */
  low: number;
  high: number;
  /** Height where the range begins; above 0 if records without a value have a slot below. */
  base: number;
  /** Lower and upper height of each bin; equal for bins that are not shown. */
  from: Float32Array;
  to: Float32Array;
  /** Categories shown, from the top. */
  order: number[];
  /** Returns the height of a value; `part`, 0 to 1, is the place within its cell, category or slot. */
  place(value: number, part: number): number;
  /** Returns the value at a height; for categories the nearest category. */
  value(height: number): number;
  /** Returns the lower and the upper height of a closed range of values. */
  span(range: readonly [number, number]): [number, number];
  /** Returns the lower and the upper value of a bin. */
  bin(number: number): [number, number];
}

/** Returns whether an axis can be logarithmic. */
export const canBeLog = ({ scale }: Axis): boolean =>
  scale === 'radiance' || scale === 'throughput' || scale === 'count';

const clamp = (v: number, low = 0, high = 1): number => (v < low ? low : v > high ? high : v);

/** Returns the first and the last bin from `least` on that has a count in any set. */
function occupied(bins: readonly ArrayLike<number>[], least: number): [number, number] {
  let [first, last] = [BINS, -1];
  for (let k = least; k < BINS; k++) {
    if (!bins.some((counts) => (counts[k] ?? 0) > 0)) continue;
    first = Math.min(first, k);
    last = k;
  }
  return last < 0 ? [least, BINS - 1] : [first, last];
}

/**
 * Returns the scale of an axis.
 * - `bins`: counts of each set in the bins of the axis; bins beyond them are not shown
 */
export function axisScale(axis: Axis, log: boolean, bins: readonly ArrayLike<number>[]): AxisScale {
  return axis.categories ? categoryScale(axis.categories.length, bins) : numberScale(axis, log && canBeLog(axis), bins);
}

function numberScale(axis: Axis, log: boolean, bins: readonly ArrayLike<number>[]): AxisScale {
  const { scale, extent } = axis;
  const edges = axis.edges ?? [];
  const isDiscrete = scale === 'count' || scale === 'film';
  const hasEdges = edges.length === BINS;
  const [first, last] = scale === 'film' ? [0, BINS - 1] : occupied(bins, isDiscrete ? 0 : 1);
  const ratio = hasEdges ? edges[BINS - 1]! / edges[BINS - 2]! : 2;
  const edge = (k: number) => (k >= BINS ? edges[BINS - 1]! * ratio : k < 2 ? edges[2]! / ratio : edges[k]!);

  let bin: (k: number) => [number, number];
  let [low, high] = [extent?.[0] ?? 0, extent?.[1] ?? 1];
  if (hasEdges) {
    bin = (k) => (k === 0 ? [0, 0] : [log || k > 1 ? edge(k) : 0, edge(k + 1)]);
    // An axis has at least two octaves, so that a single value is not at both ends.
    low = log ? edge(first) : 0;
    high = edge(Math.min(last + 1 + (last - first < 2 ? 1 : 0), BINS));
  } else if (scale === 'count') {
    bin = (k) => [k, k + 1];
    [low, high] = [first, Math.max(last + 1, first + 2)];
  } else if (scale === 'film') {
    const width = high - low;
    bin = (k) => [low + (k * width) / BINS, low + ((k + 1) * width) / BINS];
  } else {
    if (!(high > low)) high = low + 1;
    const width = (high - low) / (BINS - 1);
    const start = low;
    bin = (k) => (k === 0 ? [NaN, NaN] : [start + (k - 1) * width, start + k * width]);
  }

  // Only continuous axes have records without a value or below the logarithm.
  const hasSlot = !isDiscrete && (!hasEdges || log) && bins.some((counts) => (counts[0] ?? 0) > 0);
  const base = hasSlot ? SLOT + GAP : 0;
  const map = !log ? (v: number) => v : isDiscrete ? Math.log1p : Math.log;
  const unmap = !log ? (u: number) => u : isDiscrete ? Math.expm1 : Math.exp;
  const [start, size] = [map(low), map(high) - map(low)];
  // Values beyond the axis, such as open ends, have no logarithm.
  const height = (v: number) => (v <= low ? base : v >= high ? 1 : base + (1 - base) * clamp((map(v) - start) / size));
  const isNone = (v: number) => !(hasEdges ? v > 0 : v >= -Infinity);

  const [from, to] = [new Float32Array(BINS), new Float32Array(BINS)];
  for (let k = 0; k < BINS; k++) {
    const [a, b] = bin(k);
    if (k === 0 && hasSlot) to[k] = SLOT;
    // Zero is part of a linear axis, at its lower end.
    else if (k === 0 && hasEdges) to[k] = log ? 0 : 1e-6;
    else if (b >= a) [from[k], to[k]] = [height(a), height(b)];
  }

  return {
    key: `${scale} ${log} ${low} ${high} ${base}`,
    isCategorical: false,
    isDiscrete,
    isLog: log,
    low,
    high,
    base,
    from,
    to,
    order: [],
    place(v, part) {
      if (isNone(v) || (hasEdges && log && v <= 0)) return hasSlot ? SLOT * (0.15 + 0.7 * part) : 0;
      return height(isDiscrete ? v + 0.15 + 0.7 * part : v);
    },
    value(at) {
      if (hasSlot && at < base - GAP / 2) return hasEdges ? 0 : NaN;
      return clamp(unmap(start + (size * (at - base)) / (1 - base)), low, high);
    },
    span([a, b]) {
      const lower = hasSlot && hasEdges && !(a > 0) ? 0 : height(a);
      const upper = hasSlot && hasEdges && !(b > 0) ? SLOT : height(isDiscrete ? b + 1 : b);
      return [lower, Math.max(lower, upper)];
    },
    bin,
  };
}

/** Returns a scale of categories: the largest at the top, the category 0 ("none") at the bottom, absent ones hidden. */
function categoryScale(count: number, bins: readonly ArrayLike<number>[]): AxisScale {
  const shares = new Float64Array(Math.min(count, BINS));
  for (const counts of bins) {
    let total = 0;
    for (let k = 0; k < shares.length; k++) total += counts[k] ?? 0;
    if (total > 0) for (let k = 0; k < shares.length; k++) shares[k]! += (counts[k] ?? 0) / total;
  }
  let order = Array.from(shares.keys()).filter((k) => shares[k]! > 0);
  if (order.length === 0) order = Array.from(shares.keys());
  order.sort((a, b) => Number(a === 0) - Number(b === 0) || shares[b]! - shares[a]! || a - b);

  // Heights grow with the root of the share; small categories keep a part that a pointer can hit.
  const roots = order.reduce((sum, k) => sum + Math.sqrt(shares[k]!), 0) || 1;
  const [from, to] = [new Float32Array(BINS), new Float32Array(BINS)];
  let top = 1;
  for (const k of order) {
    const size = 0.4 / order.length + 0.6 * (roots === 1 && shares[k] === 0 ? 1 / order.length : Math.sqrt(shares[k]!) / roots);
    [from[k], to[k]] = [Math.max(top - size, 0), top];
    top -= size;
  }

  const value = (at: number) => order.find((k) => at >= from[k]!) ?? order.at(-1) ?? 0;
  return {
    key: `words ${order.map((k) => `${k}:${from[k]!.toFixed(4)}`).join()}`,
    isCategorical: true,
    isDiscrete: true,
    isLog: false,
    low: 0,
    high: count - 1,
    base: 0,
    from,
    to,
    order,
    place: (v, part) => (from[v] ?? 0) + ((to[v] ?? 0) - (from[v] ?? 0)) * (0.12 + 0.76 * part),
    value,
    span: ([a]) => [from[a] ?? 0, to[a] ?? 0],
    bin: (k) => [k, k],
  };
}

/** Returns a number from 0 to 1 that spreads rows evenly over a cell (golden ratio). */
export const spread = (row: number): number => (row * 0.6180339887498949 + 0.5) % 1;

const placed = new WeakMap<Float32Array, { key: string; heights: Float32Array }>();

const NONE = new Float32Array();

/** Returns whether the heights of a column of values are known. */
export const hasHeights = (values: Float32Array, scale: AxisScale): boolean => placed.get(values)?.key === scale.key;

/** Returns the heights of a column of values; kept until the scale changes. */
export function heightsOf(values: Float32Array | undefined, scale: AxisScale): Float32Array {
  if (!values) return NONE;
  const known = placed.get(values);
  if (known?.key === scale.key) return known.heights;
  const heights = known?.heights.slice() ?? new Float32Array(values.length);
  for (let i = 0; i < values.length; i++) heights[i] = scale.place(values[i]!, spread(i));
  placed.set(values, { key: scale.key, heights });
  return heights;
}

/** Distance from an end of an axis within which a range is open. */
const END = 1e-6;

/** Returns whether zero has a slot below the range of a logarithmic axis. */
const hasZeroSlot = (scale: AxisScale): boolean => scale.base > 0 && scale.value(0) === 0;

/** Returns the last cell of a discrete axis. */
const lastCell = (scale: AxisScale): number => Math.max(scale.high - 1, scale.low);

/**
 * Returns the range of values that a part of an axis covers; on discrete axes, the cells. A part that reaches an end of the axis gives
 * a range that is open at this end, all of the axis gives all numbers.
 */
export function rangeBetween(scale: AxisScale, a: number, b: number): [number, number] {
  const [lower, upper] = [clamp(Math.min(a, b)), clamp(Math.max(a, b))];
  const [isLowOpen, isHighOpen] = [lower <= END, upper >= 1 - END];
  const [low, high] = [scale.value(lower), scale.value(upper)];
  if (scale.isDiscrete) {
    const last = lastCell(scale);
    const from = clamp(Math.floor(low + 1e-6), scale.low, last);
    const to = clamp(Math.ceil(high - 1e-6) - 1, from, last);
    return [isLowOpen ? -Infinity : from, isHighOpen ? Infinity : to];
  }
  if (isLowOpen && isHighOpen) return [-Infinity, Infinity];
  const finite = (v: number) => (Number.isNaN(v) ? scale.low : tidy(scale, v));
  const from = isLowOpen && !hasZeroSlot(scale) ? -Infinity : finite(low);
  return [from, isHighOpen ? Infinity : Math.max(from, finite(high))];
}

/** Returns the value of a handle at a height of a continuous axis: infinite at the ends of the axis. */
export function endAt(scale: AxisScale, height: number): number {
  if (height >= 1 - END) return Infinity;
  if (height <= END && !hasZeroSlot(scale)) return -Infinity;
  const value = scale.value(height);
  return Number.isNaN(value) ? scale.low : tidy(scale, value);
}

/** Returns a range with its ends in order; all numbers if it covers all of the axis. */
export function ordered(scale: AxisScale, a: number, b: number): [number, number] {
  const [low, high] = [Math.min(a, b), Math.max(a, b)];
  return high === Infinity && low === 0 && hasZeroSlot(scale) ? [-Infinity, high] : [low, high];
}

/** Returns a range with its lower end (0) or upper end (1) dragged to a height. */
export function withEnd(scale: AxisScale, range: readonly [number, number], end: 0 | 1, to: number): [number, number] {
  if (!scale.isDiscrete) return ordered(scale, range[1 - end]!, endAt(scale, to));
  const [low, high] = scale.span(range);
  const next = rangeBetween(scale, end === 0 ? high - 1e-4 : low + 1e-4, to);
  // The other end stays open until the dragged one passes it.
  if (end === 0 ? to < high : to > low) next[1 - end] = range[1 - end]!;
  return next;
}

/** Returns a range moved by a height, within the axis. */
export function withShift(scale: AxisScale, range: readonly [number, number], height: number): [number, number] {
  const [low, high] = scale.span(range);
  const by = clamp(height, -low, 1 - high);
  if (!scale.isDiscrete) return rangeBetween(scale, low + by, high + by);
  const last = lastCell(scale);
  const cells = Math.min(range[1], last) - Math.max(range[0], scale.low);
  const first = clamp(Math.round(scale.value(low + by)), scale.low, last - cells);
  return [first === scale.low ? -Infinity : first, first + cells === last ? Infinity : first + cells];
}

/** Returns a range with an end moved to an end of the axis, by the keys Home (lower end) and End. */
export function withEndAt(scale: AxisScale, range: readonly [number, number], end: 0 | 1, to: 'low' | 'high'): [number, number] {
  const next: [number, number] = [range[0], range[1]];
  const isOuter = (to === 'low') === (end === 0);
  if (isOuter && to === 'high') next[1] = Infinity;
  else if (isOuter) next[0] = hasZeroSlot(scale) ? 0 : -Infinity;
  // An end does not pass the other one.
  else if (Number.isFinite(next[1 - end]!)) next[end] = next[1 - end]!;
  else next[end] = to === 'low' ? scale.low : scale.isDiscrete ? lastCell(scale) : scale.high;
  return ordered(scale, ...next);
}

/** Returns a value with as many digits as a screen can show on the axis. */
export function tidy(scale: AxisScale, value: number): number {
  if (value === 0) return 0;
  if (scale.isLog) return Number(value.toPrecision(3));
  const digits = 3 - Math.ceil(Math.log10(Math.abs(scale.high - scale.low)));
  return Number(value.toFixed(clamp(digits, 0, 12)));
}

/** Returns the end of a range moved by a number of bins; on discrete axes, by cells. */
export function step(scale: AxisScale, value: number, by: number): number {
  // Open ends stay open, or move from the end of the axis.
  if (by > 0 ? value === Infinity : value === -Infinity) return value;
  if (scale.isDiscrete) return clamp(clamp(value, scale.low, lastCell(scale)) + by, scale.low, lastCell(scale));
  const bins = Array.from({ length: BINS }, (_, k) => k).filter((k) => scale.to[k]! > scale.from[k]!);
  const edges = [...new Set(bins.flatMap((k) => scale.bin(k).filter((v) => v === v)))].sort((a, b) => a - b);
  const within = edges.filter((v) => v === 0 || (v >= scale.low && v <= scale.high * 1.000001));
  let to = Number.isFinite(value) ? value : (value > 0 ? within.at(-1) : within[0]) ?? value;
  for (let n = 0; n < Math.abs(by); n++) {
    const tolerance = 0.004 * Math.abs(to);
    const next = by > 0 ? within.find((v) => v > to + tolerance) : within.findLast((v) => v < to - tolerance);
    if (next === undefined) break;
    to = next;
  }
  return tidy(scale, to);
}

const SUPERSCRIPTS = '⁰¹²³⁴⁵⁶⁷⁸⁹';

/**
 * Formats a value of an axis: `0.25`, `1200`, `12,000`, `10⁵`, `3.2·10⁻⁶`.
 * - `largest`: values from here on have a power of ten
 */
export function formatValue(value: number, largest = 99_999.5): string {
  if (Number.isNaN(value)) return 'none';
  if (!Number.isFinite(value)) return value > 0 ? '∞' : '−∞';
  const size = Math.abs(value);
  if (size !== 0 && (size >= largest || size < 0.00095)) {
    const [mantissa, power] = value.toExponential(2).split('e') as [string, string];
    const raised = [...String(Number(power))].map((c) => (c === '-' ? '⁻' : SUPERSCRIPTS[Number(c)])).join('');
    const front = String(Number(mantissa));
    return front === '1' ? `10${raised}` : `${front}·10${raised}`.replace('-', '−');
  }
  const text = size >= 1000 ? value.toFixed(0) : String(Number(value.toPrecision(3)));
  return (size >= 10_000 ? text.replace(/\B(?=(\d{3})+$)/g, ',') : text).replace('-', '−');
}

/** Mark on an axis. */
export interface Tick {
  height: number;
  text: string;
}

/**
 * Returns the ticks of an axis with numbers.
 * - `most`: greatest number of ticks that have room
 */
export function ticks(scale: AxisScale, axis: Axis, log: boolean, most: number): Tick[] {
  const marks: Tick[] = [];
  if (scale.isCategorical) return marks;
  const at = (value: number) => scale.place(value, 0.5);
  if (scale.base > 0) {
    const text = axis.edges ? '0' : 'none';
    marks.push({ height: SLOT / 2, text });
  }
  const room = Math.max(most - marks.length, 2);
  if (log && axis.edges) {
    const [low, high] = [Math.ceil(Math.log10(scale.low) - 1e-9), Math.floor(Math.log10(scale.high) + 1e-9)];
    const decades = high - low + 1;
    const parts = decades * 3 <= room ? [1, 2, 5] : [1];
    const every = Math.max(1, Math.ceil(decades / room));
    for (let power = low - 1; power <= high; power++) {
      if (((power % every) + every) % every !== 0) continue;
      for (const part of parts) {
        const value = Number(`${part}e${power}`);
        if (value >= scale.low * 0.999 && value <= scale.high * 1.001) marks.push({ height: at(value), text: formatValue(value, 9999.5) });
      }
    }
    return marks;
  }
  const last = scale.isDiscrete ? scale.high - 1 : scale.high;
  if (log) {
    // Counts: powers of two; 0 and 1 are apart.
    for (let value = Math.max(scale.low, 0), n = 0; value <= last && n < 64; value = value < 1 ? value + 1 : value * 2, n++)
      marks.push({ height: at(value), text: formatValue(value) });
    return marks.length > room ? marks.filter((_, i) => i % Math.ceil(marks.length / room) === 0) : marks;
  }
  const rough = (last - scale.low) / room;
  const power = 10 ** Math.floor(Math.log10(rough || 1));
  let size = power * ([1, 2, 5, 10].find((it) => it * power >= rough * 0.999) ?? 10);
  if (scale.isDiscrete) size = Math.max(1, Math.round(size));
  for (let n = Math.ceil(scale.low / size - 1e-9); n * size <= last + size * 1e-6; n++)
    marks.push({ height: at(n * size), text: formatValue(Number((n * size).toPrecision(9))) });
  return marks;
}
