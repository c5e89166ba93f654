import { expect, test } from 'vitest';
import { formatLasso, inside, parseLasso, simplify } from '../../src/lib/lasso';
import { histogram, summarize } from '../../src/lib/picture';

const square = [
  { x: 1, y: 1 },
  { x: 4, y: 1 },
  { x: 4, y: 3 },
  { x: 1, y: 3 },
];

test('a square has the pixels whose middles it holds, whatever its direction', () => {
  const due = [6, 7, 8, 11, 12, 13];
  expect([...inside(square, 5, 5)]).toEqual(due);
  expect([...inside(square.toReversed(), 5, 5)]).toEqual(due);
});

test('what lies beyond the film is left out', () => {
  const all = [
    { x: 0, y: 0 },
    { x: 99, y: 0 },
    { x: 99, y: 99 },
    { x: 0, y: 99 },
  ];
  expect(inside(all, 3, 2).length).toBe(6);
});

test('a lasso comes back from its address; less than a triangle is none', () => {
  expect(parseLasso(formatLasso(square))).toEqual(square);
  expect(parseLasso('1,2;3,4')).toEqual([]);
  expect(parseLasso('x;-1,2;;')).toEqual([]);
  expect(parseLasso(undefined)).toEqual([]);
});

test('a circle of a thousand points keeps its area with 48', () => {
  const circle = Array.from({ length: 1000 }, (_, i) => ({
    x: 100 + 80 * Math.cos((i * Math.PI) / 500),
    y: 100 + 80 * Math.sin((i * Math.PI) / 500),
  }));
  const few = simplify(circle);
  expect(few.length).toBeLessThanOrEqual(48);
  const [before, after] = [inside(circle, 200, 200).length, inside(few, 200, 200).length];
  expect(Math.abs(after - before) / before).toBeLessThan(0.02);
});

test('a summary and a histogram of chosen pixels have these and no other', () => {
  const values = Float32Array.of(1, 10, 100, NaN, 1000);
  expect(summarize(values, Uint32Array.of(1, 3, 4))).toEqual({ pixels: 2, mean: 505, low: 10, high: 1000 });
  const bins = histogram(values, { low: 1, high: 1000, logarithmic: true }, 3, Uint32Array.of(0, 1, 2, 3))!;
  expect(bins.counts).toEqual([1, 1, 1]);
  expect(bins.middles[0]).toBeCloseTo(Math.sqrt(10), 6);
});
