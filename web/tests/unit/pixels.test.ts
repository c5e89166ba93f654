import { describe, expect, test } from 'vitest';
import { decodeHalf, halves } from '../../src/lib/half';
import { decodePixels, MAGIC } from '../../src/lib/pixels';
import { encode } from './fixtures';

describe('half floats', () => {
  test.each([
    [0x0000, 0],
    [0x0001, 2 ** -24],
    [0x03ff, 1023 * 2 ** -24],
    [0x0400, 2 ** -14],
    [0x3c00, 1],
    [0x3555, 0.333251953125],
    [0xc000, -2],
    [0x7bff, 65504],
    [0x7c00, Infinity],
    [0xfc00, -Infinity],
  ])('%i is %f', (bits, number) => expect(decodeHalf(bits)).toBe(number));
  test('the table says the same for all 65,536, and no value is told twice', () => {
    const table = halves();
    const finite = new Set<number>();
    for (let bits = 0; bits < 65536; bits++) {
      // One assertion for all: 65,536 assertions would take a second.
      if (!Object.is(table[bits], decodeHalf(bits)))
        throw new Error(`${bits}: ${table[bits]}, not ${decodeHalf(bits)}`);
      if (Number.isFinite(table[bits]!)) finite.add(table[bits]!);
    }
    // Minus zero equals zero in a set.
    expect(finite.size).toBe(2 * 31 * 1024 - 1);
  });
});

describe('pixels', () => {
  const planes = { R: [0x3c00, 0x4000], G: [0, 0], B: [0, 0], Y: [0x3c00, 0x7c00], samples: [0x4400, 0x4800] };

  test('planes are found by name, values by place', () => {
    const pixels = decodePixels(encode(2, 1, planes));
    expect([pixels.width, pixels.height]).toEqual([2, 1]);
    expect(pixels.at('R', 1, 0)).toBe(2);
    expect(pixels.at('samples', 0, 0)).toBe(4);
    expect(pixels.at('Y', 1, 0)).toBe(Infinity);
    expect(pixels.at('error', 0, 0)).toBeNaN();
    expect(pixels.at('R', 2, 0)).toBeNaN();
    expect([...pixels.floats('samples')!]).toEqual([4, 8]);
  });

  test('an error that is not known is no number; negative values of other channels stay', () => {
    const pixels = decodePixels(encode(2, 1, { error: [0xbc00, 0x3c00], Y: [0xbc00, 0x8000] }));
    expect(pixels.at('error', 0, 0)).toBeNaN();
    expect(pixels.at('error', 1, 0)).toBe(1);
    expect(pixels.at('Y', 0, 0)).toBe(-1);
  });

  test('names of odd lengths leave planes at odd addresses: they are read all the same', () => {
    expect(decodePixels(encode(1, 1, { abc: [0x3c00] })).at('abc', 0, 0)).toBe(1);
  });

  test('what is cut off at any byte is refused', () => {
    const whole = encode(2, 1, planes);
    for (let length = 0; length < whole.byteLength; length++) {
      expect(() => decodePixels(whole.slice(0, length))).toThrow(/pixels/);
    }
  });

  test('other magic numbers, versions and sizes are refused in words', () => {
    expect(() => decodePixels(encode(1, 1, {}, 7))).toThrow('does not contain the pixels of a frame');
    expect(() => decodePixels(encode(1, 1, {}, MAGIC, 2))).toThrow('reload');
    expect(() => decodePixels(encode(1 << 16, 1 << 16, {}))).toThrow('too large');
  });
});
