import { describe, expect, test } from 'vitest';
import { interval95, student95 } from '../../src/lib/student';

describe('intervals of pixels', () => {
  // Table from engine/film/src/convergence.rs.
  test.each([
    [1, 12.706],
    [2, 4.303],
    [3, 3.182],
    [4, 2.776],
    [6, 2.447],
    [9, 2.262],
    [30, 2.042],
    [1e9, 1.96],
  ])('the quantile for %d degrees of freedom is %d', (freedom, quantile) =>
    expect(Math.abs(student95(freedom) / quantile - 1)).toBeLessThan(0.01),
  );
  test('without a degree of freedom there is no interval', () => {
    expect(student95(0)).toBeNaN();
    expect(student95(NaN)).toBeNaN();
  });
  test('an interval is about the luminance and ends at black', () => {
    const [low, high] = interval95(10, 0.1, 9);
    expect(low).toBeCloseTo(10 - 2.262, 1);
    expect(high).toBeCloseTo(10 + 2.262, 1);
    expect(interval95(10, 1, 4)[0]).toBe(0);
  });
});
