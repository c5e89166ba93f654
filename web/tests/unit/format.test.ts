import { expect, test } from 'vitest';
import { bytes, frameError, percent, quantity, ranges, seconds, shortError, value } from '../../src/lib/format';

test.each([
  [0.421, '0.42 s'],
  [12.34, '12.3 s'],
  [200, '3 min 20 s'],
  [7500, '2 h 5 min'],
  [3 * 86400 + 4 * 3600, '3 d 4 h'],
  [null, '–'],
  [NaN, '–'],
  [-1, '–'],
])('%s seconds are %s', (s, text) => expect(seconds(s)).toBe(text));

test.each([
  [999, '999'],
  [9999, '9999'],
  [12_345, '12.3 k'],
  [4_560_000, '4.56 M'],
  [7.89e9, '7.89 G'],
  [null, '–'],
])('%s is %s', (n, text) => expect(quantity(n)).toBe(text));

test.each([
  [999, '999 B'],
  [12_600, '12.3 KiB'],
  [4_781_506, '4.56 MiB'],
  [8.5e9, '7.92 GiB'],
])('%s bytes are %s', (n, text) => expect(bytes(n)).toBe(text));

test.each([
  [0.071, '7.1 %'],
  [1, '100 %'],
  [0, '0 %'],
  [0.0004, '0.04 %'],
  [0.9996, '100 %'],
  [null, '–'],
])('%s is %s', (n, text) => expect(percent(n)).toBe(text));

test.each([
  [0.071, 0, 4, '7.1 %', '7.1 %'],
  [0.071, 2, 4, '7.1 %', '7.1 %, 2 of 4 blocks met no light'],
  [null, 4, 4, 'unlit', 'no sample met light'],
  [0, 4, 4, 'unlit', 'no sample met light'],
  [null, null, null, '–', '–'],
])('an error of %s with %s of %s blocks unlit', (relative_error, unlit_blocks, blocks, short, long) => {
  expect([shortError, frameError].map((say) => say({ relative_error, unlit_blocks, blocks }))).toEqual([short, long]);
});

test.each([
  [0, '0'],
  [0.01234, '0.01234'],
  [12.34567, '12.35'],
  [1200, '1200'],
  [2, '2'],
  [1.234e7, '1.234e+7'],
  [NaN, 'not a number'],
  [Infinity, '∞'],
])('the value %s is %s', (x, text) => expect(value(x)).toBe(text));

test('frames are told in ranges', () => expect(ranges([3, 1, 2, 8, 9])).toBe('1..3, 8, 9'));
