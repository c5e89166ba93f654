import { describe, expect, test } from 'vitest';
import { densityScale } from '../../src/lib/light/density';
import { commonScale, DARK, legendColor, OVER_PICTURE, OVER_SETS, paintHot, paintOver } from '../../src/lib/light/overlay';

/** Red, green and blue of the word of a canvas. */
const rgb = (word: number) => [word & 255, (word >>> 8) & 255, (word >>> 16) & 255];
const BASE = 0xff102030;

describe('densities in colors', () => {
  const values = Float32Array.of(0, 1, 100);
  const scale = densityScale(values, true)!;

  test('where no path is, a hot body is dark and a picture stays; the most is the strongest color', () => {
    const hot = paintHot(values, scale);
    expect([hot[0], hot[2]]).toEqual([DARK, 0xffffffff]);
    expect(hot[1]! & 255).toBeGreaterThan(30);
    const base = new Uint32Array(3).fill(BASE);
    const over = paintOver([{ values, color: OVER_PICTURE }], scale, base, 1);
    expect(over[0]).toBe(BASE);
    expect(rgb(over[2]!)).toEqual([...OVER_PICTURE]);
    expect([...base]).toEqual([BASE, BASE, BASE]);
    const faint = paintOver([{ values, color: OVER_PICTURE }], scale, base, 0.1);
    expect(faint[1]).not.toBe(BASE);
    expect(rgb(faint[2]!)[1]).toBeCloseTo(0.1 * 229 + 0.9 * 0x20, 0);
  });

  test('A is red and B is blue; both together are between, and neither lies above the other', () => {
    const [a, b] = [Float32Array.of(5, 0, 5, 0), Float32Array.of(0, 5, 5, 0)].map((values, at) => ({ values, color: OVER_SETS[at]! }));
    const scale = commonScale([a!.values, b!.values], false)!;
    const base = new Uint32Array(4).fill(BASE);
    const both = paintOver([a!, b!], scale, base, 0.8);
    const [red, blue, mixed] = [...both].map(rgb);
    expect(red![0]).toBeGreaterThan(red![2]! + 100);
    expect(blue![2]).toBeGreaterThan(blue![0]! + 100);
    expect(Math.abs(mixed![0]! - mixed![2]!)).toBeLessThan(30);
    expect(both[3]).toBe(BASE);
    expect([...paintOver([b!, a!], scale, base, 0.8)]).toEqual([...both]);
    // The same strength as of one density, where the other has none.
    expect(both[0]).toBe(paintOver([a!], scale, base, 0.8)[0]);
  });

  test('densities that are compared have one scale', () => {
    const [few, many] = [Float32Array.of(1, 2), Float32Array.of(40, 400)];
    expect(commonScale([few, many], true)).toEqual({ low: 1, high: 400, logarithmic: true });
    expect(commonScale([few, many], false)).toEqual({ low: 0, high: 400, logarithmic: false });
    expect(commonScale([few, Float32Array.of(0, 1e6)], true)).toEqual({ low: 1000, high: 1e6, logarithmic: true });
    expect(commonScale([few, new Float32Array(2)], true)).toEqual(commonScale([few], true));
    expect(commonScale([new Float32Array(2)], true)).toBeNull();
    expect(commonScale([], true)).toBeNull();
  });

  test('a legend begins with the color of the least density and ends with that of the greatest', () => {
    const dark = new Uint32Array(3).fill(0xff1a1a1a);
    const over = paintOver([{ values, color: OVER_SETS[1] }], scale, dark, 1);
    const legend = legendColor(OVER_SETS[1]);
    for (const [t, at] of [[0, 1], [1, 2]] as const)
      legend(t).forEach((c, i) => expect(Math.abs(c - rgb(over[at]!)[i]!)).toBeLessThanOrEqual(1));
    expect(legendColor('hot')(1)).toEqual([255, 255, 255]);
  });

  test('equal densities have the strongest color', () => {
    const even = Float32Array.of(3, 3, 0);
    const one = { low: 3, high: 3, logarithmic: true };
    expect([...paintHot(even, one)]).toEqual([0xffffffff, 0xffffffff, DARK]);
  });
});
