import { describe, expect, test } from 'vitest';
import { autoExposure, diverging, lookup, srgb, srgbByte, toneGain, viridis } from '../../src/lib/color';
import { develop, difference, paint, smooth, suitableScale, summarize } from '../../src/lib/picture';
import { decodePixels } from '../../src/lib/pixels';
import { place, spread, ticks, valueAt } from '../../src/lib/scale';
import { encode } from './fixtures';

describe('colors', () => {
  test('viridis begins in violet, ends in yellow, and grows lighter all the way', () => {
    expect(viridis(0)).toEqual([68, 1, 84]);
    expect(viridis(1)).toEqual([253, 231, 37]);
    const lightness = Array.from({ length: 101 }, (_, i) => viridis(i / 100)).map(
      ([r, g, b]) => 0.2126 * r + 0.7152 * g + 0.0722 * b,
    );
    expect(lightness.every((l, i) => i === 0 || l > lightness[i - 1]!)).toBe(true);
  });
  test('what is outside a scale has the color of its end, what is no number a color of its own', () => {
    expect(viridis(-3)).toEqual(viridis(0));
    expect(viridis(7)).toEqual(viridis(1));
    expect(viridis(NaN)).toEqual([255, 0, 255]);
    expect(diverging(0.5)).toEqual([247, 247, 247]);
  });
  test('a table of colors has them as a canvas does', () => {
    const table = lookup(viridis);
    expect(table[0]! >>> 0).toBe(0xff540144);
    expect(table[255]! >>> 0).toBe(0xff25e7fd);
  });
  test('the table of sRGB is within one step of the formula', () => {
    for (let i = 0; i <= 1000; i++) expect(Math.abs(srgbByte(i / 1000) - 255 * srgb(i / 1000))).toBeLessThanOrEqual(1);
    expect([srgbByte(NaN), srgbByte(-1), srgbByte(9)]).toEqual([0, 0, 255]);
  });
});

describe('the tone curve is that of the farm', () => {
  test('the automatic exposure is that of the engine for the same pixels', () => {
    // engine/film/src/tone.rs, `auto_exposure_follows_the_light_and_ignores_black_and_nan`: log-average 3,
    // exposure 0.06.
    expect(autoExposure([1, 9, 0, NaN])).toBeCloseTo(0.06, 5);
    expect(autoExposure([0, NaN])).toBe(1);
  });
  test('eight units are white', () => expect(8 * toneGain(8)).toBeCloseTo(1, 12));
  test('a picture has its bytes in the order of a canvas', () => {
    const pixels = decodePixels(encode(1, 1, { R: [0x4c00], G: [0], B: [0] }));
    const word = develop(pixels, 8)[0]!;
    expect(word >>> 24).toBe(255);
    expect(word & 0xff).toBe(255);
    expect((word >> 8) & 0xffff).toBe(0);
  });
  test('a file that knows only luminances has a gray picture', () => {
    const word = develop(decodePixels(encode(1, 1, { Y: [0x3800] })), 1)[0]!;
    expect(word >>> 24).toBe(255);
    expect(word & 255).toBeGreaterThan(100);
    expect([(word >> 8) & 255, (word >> 16) & 255]).toEqual([word & 255, word & 255]);
  });
});

describe('measures', () => {
  const a = decodePixels(encode(2, 1, { R: [0, 0], G: [0, 0], B: [0, 0], Y: [0x3c00, 0x4000] }));
  const b = decodePixels(encode(2, 1, { R: [0, 0], G: [0, 0], B: [0, 0], Y: [0x4000, 0x4000] }));
  test('a difference is the other frame less this one; films of two sizes have none', () => {
    expect([...difference(a, b)!]).toEqual([1, 0]);
    expect(difference(a, decodePixels(encode(1, 1, { Y: [0] })))).toBeNull();
  });
  test('maps of light statistics are linear where they are shares and counts, and pixels without a sample have no value', () => {
    const maps = decodePixels(encode(3, 1, { depth: [0x4000, 0x4400, 0xbc00], deviation: [0x3c00, 0x4900, 0xbc00] }));
    expect([...maps.floats('depth')!]).toEqual([2, 4, NaN]);
    expect(suitableScale('depth', maps.floats('depth')!)).toEqual({ low: 2, high: 4, logarithmic: false });
    expect(suitableScale('deviation', maps.floats('deviation')!)).toEqual({ low: 1, high: 10, logarithmic: true });
    expect(suitableScale('throughput', Float32Array.of(0, 0))?.low).toBe(0);
  });
  test('the scale of differences has its white at zero', () => {
    const scale = suitableScale('difference', Float32Array.of(-1, 0.5, 3))!;
    expect(scale.low).toBe(-scale.high);
    expect(place(scale, 0)).toBe(0.5);
  });
  test('smoothing keeps the sum in the middle, and lets no NaN spread', () => {
    const values = new Float32Array(21 * 21);
    values[10 * 21 + 10] = 1;
    const out = smooth(values, 21, 21, 1.5);
    expect(out.reduce((n, v) => n + v, 0)).toBeCloseTo(1, 5);
    expect(out[10 * 21 + 10]).toBeCloseTo(1 / (2 * Math.PI * 1.5 ** 2), 2);
    values[0] = NaN;
    const spoiled = smooth(values, 21, 21, 1.5);
    expect(Number.isNaN(spoiled[0])).toBe(true);
    expect(spoiled.filter((v) => Number.isNaN(v)).length).toBe(1);
    expect(smooth(values, 21, 21, 0)).toBe(values);
  });
  test('pixels without a value are gray', () => {
    const words = paint(Float32Array.of(NaN, 1, 10), { low: 1, high: 10, logarithmic: true }, 'viridis');
    expect([...words].map((word) => word >>> 0)).toEqual([0xff808080, 0xff540144, 0xff25e7fd]);
  });
  test('a summary leaves out what is not finite', () => {
    expect(summarize(Float32Array.of(1, 3, NaN, Infinity))).toEqual({ pixels: 2, mean: 2, low: 1, high: 3 });
    expect(summarize(Float32Array.of(NaN))).toBeNull();
  });
});

describe('scales', () => {
  test.each([
    { low: 2, high: 6, logarithmic: false },
    { low: 0.01, high: 500, logarithmic: true },
  ])('a value comes back from its place: %o', (scale) => {
    for (const t of [0, 0.3, 1]) expect(place(scale, valueAt(scale, t))).toBeCloseTo(t, 12);
  });
  test('ticks are round, rise, and lie within', () => {
    for (const [low, high, logarithmic] of [
      [0, 7.3, false],
      [-2, 2, false],
      [0.003, 900, true],
      [3, 4.5, true],
      [1e-6, 1e6, true],
    ] as const) {
      const all = ticks({ low, high, logarithmic });
      expect(all.length).toBeGreaterThanOrEqual(2);
      expect(all.length).toBeLessThanOrEqual(12);
      for (const [i, tick] of all.entries()) {
        expect(tick).toBeGreaterThanOrEqual(low - 1e-3 * Math.abs(low));
        expect(tick).toBeLessThanOrEqual(high + 1e-3 * Math.abs(high));
        if (i) expect(tick).toBeGreaterThan(all[i - 1]!);
      }
    }
  });
  test('single outliers do not decide a spread', () => {
    const values = [...Array.from({ length: 998 }, (_, i) => i), 1e9, NaN];
    expect(spread(values, 0.005)![1]).toBeLessThan(1000);
    expect(spread([NaN])).toBeNull();
  });
});
