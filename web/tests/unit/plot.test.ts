import { describe, expect, test } from 'vitest';
import { barsOf, shareIn, sharesIn } from '../../src/lib/light/plot/bars';
import { brushOf, isEmpty, joined, toggled, withBrush } from '../../src/lib/light/plot/brush';
import type { Axis, AxisView, Brush, ScaleName } from '../../src/lib/light/plot/contract';
import { addLines, encode, StripCounts, type StripLines } from '../../src/lib/light/plot/counts';
import { addDensity, COLUMNS, ROWS } from '../../src/lib/light/plot/density';
import { nearestLine } from '../../src/lib/light/plot/nearest';
import { changed, moved, pairs } from '../../src/lib/light/plot/order';
import { LIGHT, ratio, ratioColor } from '../../src/lib/light/plot/ratio';
import { axisScale, formatValue, heightsOf, ordered, rangeBetween, step, ticks, withEnd, withEndAt, withShift } from '../../src/lib/light/plot/scale';

const RADIANCE = Array.from({ length: 64 }, (_, k) => (k < 2 ? 0 : 2 ** ((k - 22) / 2)));
const axis = (scale: ScaleName, more: Partial<Axis> = {}): Axis => ({
  index: 0,
  name: 'axis',
  scale,
  edges: scale === 'radiance' ? RADIANCE : null,
  extent: null,
  categories: null,
  ...more,
});
const bins = (counts: Record<number, number>) => {
  const list = new Float64Array(64);
  for (const [k, n] of Object.entries(counts)) list[Number(k)] = n;
  return list;
};

describe('scales', () => {
  test('a logarithmic axis has the bins with records, and a place for zero', () => {
    const scale = axisScale(axis('radiance'), true, [bins({ 0: 5, 20: 1, 30: 2 })]);
    expect(scale.low).toBeCloseTo(0.5);
    expect(scale.high).toBeCloseTo(2 ** 4.5);
    expect(scale.place(0, 0.5)).toBeLessThan(scale.base);
    expect(scale.place(0.5, 0.5)).toBeCloseTo(scale.base);
    expect(scale.place(1e-9, 0.5)).toBeCloseTo(scale.base);
    for (const v of [0.6, 1, 7, 20]) expect(scale.value(scale.place(v, 0.5))).toBeCloseTo(v, 6);
    expect(scale.value(0.01)).toBe(0);
    expect(scale.span([0, 0])[1]).toBeLessThan(scale.base);
    expect(scale.span([0, 1])[0]).toBe(0);
  });

  test('bins of a logarithmic axis are equally high and adjoin', () => {
    const scale = axisScale(axis('radiance'), true, [bins({ 20: 1, 39: 1 })]);
    expect(scale.base).toBe(0);
    for (let k = 20; k < 40; k++) {
      expect(scale.to[k]! - scale.from[k]!).toBeCloseTo(1 / 20, 5);
      expect(scale.from[k]).toBeCloseTo((k - 20) / 20, 5);
    }
    expect(scale.to[19]).toBe(scale.from[19]);
  });

  test('a linear axis of radiance begins at zero', () => {
    const scale = axisScale(axis('radiance'), false, [bins({ 0: 3, 24: 1, 26: 1 })]);
    expect(scale.place(0, 0.5)).toBe(0);
    expect(scale.place(scale.high / 2, 0.5)).toBeCloseTo(0.5);
  });

  test('numbers have cells, and ranges of them whole cells', () => {
    const scale = axisScale(axis('count'), false, [bins({ 1: 1, 4: 1 })]);
    expect([scale.low, scale.high]).toEqual([1, 5]);
    expect(scale.place(1, 0.5)).toBeCloseTo(1 / 8);
    expect(scale.span([2, 3])).toEqual([0.25, 0.75]);
    expect(rangeBetween(scale, 0.3, 0.7)).toEqual([2, 3]);
    expect(rangeBetween(scale, 0.7, 0.3)).toEqual([2, 3]);
    expect(rangeBetween(scale, 0, 1)).toEqual([-Infinity, Infinity]);
    expect(rangeBetween(scale, 0.3, 0.3)).toEqual([2, 2]);
    const log = axisScale(axis('count'), true, [bins({ 0: 1, 62: 1 })]);
    expect(rangeBetween(log, ...log.span([3, 9]))).toEqual([3, 9]);
    expect(log.place(1, 0.5) - log.place(0, 0.5)).toBeGreaterThan(log.place(9, 0.5) - log.place(8, 0.5));
  });

  test('positions that are absent have a place of their own', () => {
    const box = axis('world', { extent: [-2, 2] });
    const scale = axisScale(box, false, [bins({ 0: 1, 8: 1 })]);
    expect(scale.place(NaN, 0.5)).toBeLessThan(scale.base);
    expect(scale.place(-2, 0.5)).toBeCloseTo(scale.base);
    expect(scale.value(0)).toBeNaN();
    expect(rangeBetween(scale, 0, 1)).toEqual([-Infinity, Infinity]);
    expect(rangeBetween(scale, 0, 0.5)[0]).toBe(-Infinity);
    expect(axisScale(box, false, [bins({ 8: 1 })]).base).toBe(0);
  });

  test('categories are sorted by share, none is last, absent ones are hidden', () => {
    const words = axis('class', { categories: ['none', 'a', 'b', 'c'] });
    const scale = axisScale(words, false, [bins({ 0: 50, 1: 1, 2: 10 })]);
    expect(scale.order).toEqual([2, 1, 0]);
    expect(scale.to[2]).toBe(1);
    expect(scale.from[0]).toBeCloseTo(0);
    for (const k of scale.order) expect(scale.value(scale.place(k, 0.5))).toBe(k);
    expect(scale.to[3]).toBe(0);
    // Both sets count equally, whatever their sizes.
    expect(axisScale(words, false, [bins({ 1: 1000, 2: 10 }), bins({ 2: 3 })]).order).toEqual([2, 1]);
  });

  test('keys move an end by bins, within the axis', () => {
    const scale = axisScale(axis('radiance'), true, [bins({ 20: 1, 24: 1 })]);
    expect(step(scale, 1, 1)).toBeCloseTo(1.41);
    expect(step(scale, 1.41, -1)).toBe(1);
    expect(step(scale, 1, 50)).toBeCloseTo(scale.high, 1);
    expect(step(axisScale(axis('count'), false, [bins({ 0: 1, 5: 1 })]), 4, 5)).toBe(5);
  });

  test('a range that reaches an end of the axis is open there', () => {
    const log = axisScale(axis('radiance'), true, [bins({ 20: 1, 39: 1 })]);
    expect(rangeBetween(log, 0.5, 1)).toEqual([expect.closeTo(16), Infinity]);
    expect(rangeBetween(log, 0.5, 0)).toEqual([-Infinity, expect.closeTo(16)]);
    expect(rangeBetween(log, 0, 0)).toEqual([-Infinity, 0.5]);
    expect(rangeBetween(log, 1, 1)).toEqual([512, Infinity]);
    const slot = axisScale(axis('radiance'), true, [bins({ 0: 1, 20: 1, 39: 1 })]);
    expect(rangeBetween(slot, 0, 0.01)).toEqual([0, 0]);
    expect(rangeBetween(slot, 0, 1)).toEqual([-Infinity, Infinity]);
    expect(ordered(slot, Infinity, 0)).toEqual([-Infinity, Infinity]);
    const count = axisScale(axis('count'), false, [bins({ 1: 1, 4: 1 })]);
    expect(rangeBetween(count, 0.3, 1)).toEqual([2, Infinity]);
    expect([rangeBetween(count, 0, 0), rangeBetween(count, 1, 1)]).toEqual([[-Infinity, 1], [4, Infinity]]);
  });

  test('open ranges are dragged by their handles, moved, and changed by keys', () => {
    const log = axisScale(axis('radiance'), true, [bins({ 20: 1, 39: 1 })]);
    expect(withEnd(log, [16, 32], 1, 1)).toEqual([16, Infinity]);
    expect(withEnd(log, [16, 32], 0, 0)).toEqual([-Infinity, 32]);
    expect(withEnd(log, [16, Infinity], 0, 0)).toEqual([-Infinity, Infinity]);
    expect(withShift(log, [16, 32], 1)).toEqual([expect.closeTo(256, -1), Infinity]);
    const count = axisScale(axis('count'), false, [bins({ 1: 1, 8: 1 })]);
    expect(withEnd(count, [3, Infinity], 0, 0.5)).toEqual([5, Infinity]);
    expect(withEnd(count, [-Infinity, 3], 1, 0.75)).toEqual([-Infinity, 6]);
    expect(withEnd(count, [3, 5], 0, 0.95)).toEqual([5, 8]);
    expect(withShift(count, [7, Infinity], -0.25)).toEqual([5, 6]);
    expect(withShift(count, [5, 6], 0.25)).toEqual([7, Infinity]);
    expect(withShift(count, [5, 6], -1)).toEqual([-Infinity, 2]);
    expect(withEndAt(count, [3, 5], 1, 'high')).toEqual([3, Infinity]);
    expect(withEndAt(count, [3, 5], 0, 'low')).toEqual([-Infinity, 5]);
    expect(withEndAt(count, [3, 5], 0, 'high')).toEqual([5, 5]);
    expect(withEndAt(count, [3, Infinity], 0, 'high')).toEqual([8, Infinity]);
    const slot = axisScale(axis('radiance'), true, [bins({ 0: 1, 20: 1, 39: 1 })]);
    expect(withEndAt(slot, [1, 5], 0, 'low')).toEqual([0, 5]);
    expect(withEndAt(slot, [1, Infinity], 0, 'low')).toEqual([-Infinity, Infinity]);
    expect([step(count, Infinity, -1), step(count, Infinity, 1), step(count, -Infinity, 1)]).toEqual([7, Infinity, 2]);
    expect(step(log, Infinity, -1)).toBeCloseTo(362);
    expect(formatValue(-Infinity)).toBe('−∞');
  });

  test('values beyond an axis are at its ends', () => {
    for (const it of [axis('radiance'), axis('count')]) {
      const scale = axisScale(it, true, [bins({ 20: 1, 39: 1 })]);
      expect(scale.span([-Infinity, Infinity])).toEqual([0, 1]);
      expect(scale.span([-5, -1])).toEqual([0, 0]);
    }
    const linear = axisScale(axis('world', { extent: [-2, 2] }), false, [bins({ 0: 1, 8: 1 })]);
    expect(linear.span([-Infinity, Infinity])).toEqual([linear.base, 1]);
  });

  test('ticks are round numbers within the axis', () => {
    const log = axisScale(axis('radiance'), true, [bins({ 0: 1, 10: 1, 50: 1 })]);
    expect(ticks(log, axis('radiance'), true, 8).map((it) => it.text)).toEqual(['0', '0.1', '1', '10', '100', '1000', '10⁴']);
    const film = axis('film', { extent: [0, 960] });
    expect(ticks(axisScale(film, false, [bins({})]), film, false, 6).map((it) => it.text)).toEqual(['0', '200', '400', '600', '800']);
    const few = axisScale(axis('count'), false, [bins({ 1: 1, 4: 1 })]);
    expect(ticks(few, axis('count'), false, 9).map((it) => it.text)).toEqual(['1', '2', '3', '4']);
  });

  test('formats', () => {
    expect([0, 0.25, 1234.4, 12_345, 1e5, -2, 3.2e-6, 2.5e7, NaN].map((v) => formatValue(v))).toEqual(
      ['0', '0.25', '1234', '12,345', '10⁵', '−2', '3.2·10⁻⁶', '2.5·10⁷', 'none'],
    );
  });

  test('heights are kept until the scale changes', () => {
    const values = Float32Array.of(1, 2);
    const one = axisScale(axis('radiance'), true, [bins({ 20: 1, 39: 1 })]);
    expect(heightsOf(values, one)).toBe(heightsOf(values, axisScale(axis('radiance'), true, [bins({ 20: 9, 39: 1 })])));
    expect(heightsOf(values, axisScale(axis('radiance'), false, [bins({ 20: 1, 39: 1 })]))).not.toBe(heightsOf(values, one));
  });
});

describe('brushes', () => {
  const brush = (more: Partial<Brush>): Brush => ({ axis: 0, ranges: [], categories: [], inverted: false, ...more });

  test('overlapping ranges are joined', () => {
    expect(joined([[5, 6], [3, 1], [2, 4]])).toEqual([[1, 4], [5, 6]]);
    expect(joined([[1, 4], [5, 6]], true)).toEqual([[1, 6]]);
  });

  test('brushes replace one another by axis, and vanish when they are empty', () => {
    const all = withBrush([], brush({ ranges: [[1, 2]] }));
    expect(withBrush(all, brush({ axis: 1, categories: [2] })).length).toBe(2);
    expect(withBrush(all, brush({}))).toEqual([]);
    expect(isEmpty(brushOf(all, 7))).toBe(true);
    expect(toggled(brush({ categories: [1, 3] }), 2).categories).toEqual([1, 2, 3]);
    expect(toggled(brush({ categories: [1, 3] }), 3).categories).toEqual([1]);
  });
});

describe('order', () => {
  const views: AxisView[] = [0, 1, 2, 3].map((index) => ({ index, hidden: index === 1, log: false, flipped: false }));
  const order = (list: AxisView[]) => list.map((it) => it.index);

  test('axes move among the shown ones', () => {
    expect(order(moved(views, 0, 1))).toEqual([2, 1, 0, 3]);
    expect(order(moved(views, 3, 0))).toEqual([3, 1, 0, 2]);
    expect(order(moved(views, 3, 99))).toEqual([0, 1, 2, 3]);
    expect(order(moved(views, 1, 0))).toEqual([0, 1, 2, 3]);
  });

  test('pairs are neighbors on the screen', () => {
    expect(pairs(views)).toEqual([[0, 2], [2, 3]]);
    expect(pairs(changed(views, 1, { hidden: false })).length).toBe(3);
  });
});

test('colors go from red over gray to blue, and nothing is gray', () => {
  expect(ratioColor(1, 0)).toEqual(LIGHT.a);
  expect(ratioColor(0, 3)).toEqual(LIGHT.b);
  expect(ratioColor(2, 2)).toEqual(LIGHT.equal);
  expect(ratioColor(0, 0)).toEqual(LIGHT.equal);
  expect(ratio(3, 1)).toBe(0.5);
});

test('bars are high enough, and have the share of all their bins', () => {
  const scale = axisScale(axis('radiance'), false, [bins({ 0: 1, 2: 1, 60: 2 })]);
  const bars = barsOf({ scale }, 0.02);
  expect(bars.slice(0, -1).every((it) => it.to - it.from >= 0.02)).toBe(true);
  const total = bars.reduce((sum, bar) => sum + shareIn(bar, bins({ 0: 1, 2: 1, 60: 2 }), 4), 0);
  expect(total).toBeCloseTo(1);
});

test('shares of the selection are of the recorded records, those of the bins may be of all samples', () => {
  const scale = axisScale(axis('count'), false, [bins({ 1: 600, 2: 400 })]);
  const bars = barsOf({ scale }, 0.02);
  const set = {
    ...{ values: [], rows: 0, selected: null, pair: () => null, basis: 'all samples' as const },
    ...{ bins: [bins({ 1: 600, 2: 400 })], total: 1000, selectedBins: [bins({ 1: 30, 2: 10 })], selectedTotal: 100 },
  };
  expect(sharesIn(bars, set, 0, 'all')).toEqual([0.6, 0.4]);
  expect(sharesIn(bars, set, 0, 'selected')).toEqual([0.3, 0.1]);
  expect(sharesIn(bars, { ...set, selectedBins: null }, 0, 'selected')).toEqual([0, 0]);
});

describe('density', () => {
  const even = { from: Float32Array.from({ length: 64 }, (_, k) => k / 64), to: Float32Array.from({ length: 64 }, (_, k) => (k + 1) / 64), flipped: false };

  test('independent axes have an even density, of one on average', () => {
    const target = new Float32Array(COLUMNS * ROWS);
    // Each bin of the left axis leads to the bin of the same number.
    const counts = new Float32Array(64 * 64);
    for (let k = 0; k < 64; k++) counts[65 * k] = 3;
    addDensity(counts, even, even, target);
    expect(Math.min(...target)).toBeCloseTo(1);
    expect(Math.max(...target)).toBeCloseTo(1);
  });

  test('a flipped axis turns the lines around; each column has all of them', () => {
    const target = new Float32Array(COLUMNS * ROWS);
    const counts = new Float32Array(64 * 64);
    counts[0] = 5;
    addDensity(counts, even, { ...even, flipped: true }, target);
    const column = (x: number) => Array.from({ length: ROWS }, (_, y) => target[y * COLUMNS + x]!);
    for (const x of [0, 20, 63]) expect(column(x).reduce((a, b) => a + b, 0) / ROWS).toBeCloseTo(1, 4);
    expect(column(0).findLastIndex((v) => v > 0)).toBeLessThan(8);
    expect(column(63).findIndex((v) => v > 0)).toBeGreaterThan(ROWS - 8);
  });
});

describe('counts of lines', () => {
  const shape = { columns: 10, rows: 40, base: 0, length: 40 };
  const random = (n: number, seed: number) => Float32Array.from({ length: n }, (_, i) => ((i * 7919 + seed * 104729) % 1000) / 1000);
  const lines = { left: random(200, 1), right: random(200, 2), leftFlipped: false, rightFlipped: false, rows: 200 };
  const count = (mask: Uint8Array | null) => {
    const counts = new StripCounts();
    finish(counts, lines, mask);
    return counts.bytes;
  };
  /** Does all pieces of a count; returns their number. */
  const finish = (counts: StripCounts, of: StripLines, mask: Uint8Array | null, most?: number) => {
    for (let n = 1; ; n++) if (!counts.advance('', shape, of, mask, most)) return n;
  };

  test('a level line has one pixel in each column, a steep one all pixels between its ends', () => {
    const steps = new Int32Array(10 * 42);
    const one = { ...lines, rows: 1, left: Float32Array.of(0.5), right: Float32Array.of(0.5) };
    addLines(steps, shape, one, null, new Uint8Array(1));
    const bytes = new Uint8Array(400);
    encode(steps, shape, bytes);
    expect(bytes.filter((v) => v > 0).length).toBe(10);
    expect(bytes.slice(190, 200).every((v) => v === 4)).toBe(true);
    for (const [left, right] of [[0, 1], [1, 0]] as const) {
      const counts = new StripCounts();
      finish(counts, { ...one, left: Float32Array.of(left), right: Float32Array.of(right) }, null);
      expect(counts.bytes.filter((v) => v > 0).length).toBeGreaterThanOrEqual(38);
      expect(Math.max(...counts.bytes)).toBe(4);
    }
  });

  test('a changed selection has the counts of a new one', () => {
    const counts = new StripCounts();
    const masks = [0, 1, 2, 3].map((k) => Uint8Array.from({ length: 200 }, (_, i) => Number((i * 31 + k * 5) % 97 < 40 + 3 * k)));
    for (const mask of [...masks, masks[0]!]) {
      finish(counts, lines, mask);
      expect(counts.bytes).toEqual(count(mask));
    }
    finish(counts, lines, null);
    expect(counts.bytes).toEqual(count(null));
  });

  test('pieces add up, and a selection that changes between them has the counts of a new one', () => {
    const counts = new StripCounts();
    expect(finish(counts, lines, null, 30)).toBe(7);
    expect(counts.bytes).toEqual(count(null));
    expect(finish(counts, lines, null, 30)).toBe(1);
    const masks = [3, 5].map((k) => Uint8Array.from({ length: 200 }, (_, i) => Number(i % k === 0)));
    expect(counts.advance('', shape, lines, masks[0]!, 30)).toBe(true);
    expect(counts.advance('', shape, lines, masks[1]!, 10)).toBe(true);
    finish(counts, lines, masks[1]!, 10);
    expect(counts.bytes).toEqual(count(masks[1]!));
  });

  test('a pixel that all of very many lines cross is not empty', () => {
    const rows = 70_000;
    const level = { ...lines, rows, left: new Float32Array(rows).fill(0.5), right: new Float32Array(rows).fill(0.5) };
    const counts = new StripCounts();
    finish(counts, level, null);
    expect([...counts.bytes.slice(190, 200)]).toEqual(Array(10).fill(255));
  });
});

test('the nearest line is found within reach, among the selected ones', () => {
  const set = { left: Float32Array.of(0, 1), right: Float32Array.of(0, 0), selected: null, rows: 2 };
  expect(nearestLine([set], 0.5, 0.45, [false, false], 0.1)).toEqual({ set: 0, row: 1 });
  expect(nearestLine([set], 0.5, 0.25, [false, false], 0.1)).toBeNull();
  expect(nearestLine([{ ...set, selected: Uint8Array.of(1, 0) }], 0.5, 0.45, [false, false], 0.1)).toBeNull();
  expect(nearestLine([set], 0, 0.98, [true, false], 0.1)).toEqual({ set: 0, row: 0 });
});
