import { describe, expect, test } from 'vitest';
import {
  brushChip,
  chipAt,
  command,
  formatChips,
  formatRanges,
  formatWords,
  hasCategory,
  namesIn,
  parse,
  quote,
  rangesOf,
  TextError,
  toChips,
  withAlso,
  withChip,
  withJoin,
  withOtherQuantifier,
  withText,
  type BrushChip,
  type Ranges,
} from '../../src/lib/light/text';

const kinds = (text: string) => toChips(text).chips.map((chip) => (chip.negated ? `not ${chip.kind}` : chip.kind));

describe('conditions', () => {
  test.each([
    'radiance.g > 2 and bounce == 2 and (interaction == reflection or object == room.mirror)',
    'any(position.x >= 1 and position.x <= 2)',
    'not all(object == "the wall") or lights(occluder != door)',
    'ball then room then "any" and depth >= 3',
    'in box(-1,-1,0,1,1,1e-7) and not in lasso(1,2,3,4,5.5,6)',
    'light == lamp and light.radiance.r > 2 and light(light == lamp)',
    'not (depth >= 3 and depth <= 5)',
    '(depth >= 3 and depth <= 5 or depth >= 7 and depth <= 9) and end == escaped',
    'not not depth > 3',
  ])('%s is read, and written with the same meaning', (text) => {
    const again = formatChips(toChips(text));
    expect(formatChips(toChips(again))).toBe(again);
    if (!text.startsWith('not not')) expect(again).toBe(text);
  });

  test.each([
    ['depth >', 8, 'a number'],
    ['depth 3', 7, '=='],
    ['(depth == 3', 12, ')'],
    ['object == "a', 11, 'quotation'],
    ['depth == 3 end == escaped', 12, 'and'],
    ['in box(1,2,3)', 14, 'six numbers'],
    ['in lasso(1,2,3,4)', 18, 'three or more'],
    ['then then', 10, 'word'],
    ['depth == three', 10, 'number'],
    ['depth == 3 and and', 16, 'a name'],
  ])('%s has an error at column %d', (text, column, words) => {
    try {
      parse(text);
      expect.unreachable();
    } catch (error) {
      expect(error).toBeInstanceOf(TextError);
      expect((error as TextError).column).toBe(column);
      expect((error as TextError).message).toContain(words);
    }
  });

  test('names in a condition', () => {
    const names = namesIn(parse('any(object == a or not light == "b c") and d then e and end == escaped and depth > 3'));
    expect(names).toEqual(['a', 'b c', 'd', 'e']);
  });

  test('deep nesting is refused', () => {
    expect(() => parse('('.repeat(100) + 'depth == 1' + ')'.repeat(100))).toThrow('nested');
  });

  test('names are quoted as the command line does', () => {
    expect(['ball', 'room.wall', 'a b', 'any', 'in', '3d', 'ä-1'].map(quote)).toEqual([
      ...['ball', 'room.wall', '"a b"', '"any"', '"in"', '"3d"', 'ä-1'],
    ]);
  });
});

describe('chips', () => {
  test('a range is one chip, and a union of ranges is one', () => {
    expect(kinds('depth >= 3 and depth <= 5 and end == escaped')).toEqual(['brush', 'brush']);
    expect(kinds('(depth >= 1 and depth <= 2 or depth == 5) or not first.object == a')).toEqual(['brush', 'not brush']);
    expect(kinds('not depth >= 3 and depth <= 5')).toEqual(['not brush', 'brush']);
    expect(kinds('depth == 1 or depth >= 3 and depth <= 5')).toEqual(['brush']);
    expect(kinds('any(object == a and bounce == 0) and a then b and in box(0,0,0,1,1,1)')).toEqual([
      ...['group', 'term', 'term'],
    ]);
  });

  test('removed, negated, joined otherwise', () => {
    const all = toChips('depth == 1 or end == escaped and sample == 2');
    expect(formatChips(withChip(all, [1], () => null))).toBe('depth == 1 or sample == 2');
    expect(formatChips(withChip(all, [0], () => null))).toBe('end == escaped and sample == 2');
    expect(formatChips(withChip(all, [2], () => null))).toBe('depth == 1 or end == escaped');
    expect(formatChips(withChip(all, [1], (it) => ({ ...it, negated: true })))).toBe(
      'depth == 1 or not end == escaped and sample == 2',
    );
    expect(formatChips(withJoin(all, [1]))).toBe('depth == 1 and end == escaped and sample == 2');
    const range = toChips('depth >= 1 and depth <= 2');
    expect(formatChips(withChip(range, [0], (it) => ({ ...it, negated: true })))).toBe('not (depth >= 1 and depth <= 2)');
  });

  test('within groups, too', () => {
    const all = toChips('any(object == a and bounce == 0) and depth == 1');
    expect(chipAt(all, [0, 1])).toMatchObject({ kind: 'brush', field: 'bounce' });
    expect(formatChips(withChip(all, [0, 0], () => null))).toBe('any(bounce == 0) and depth == 1');
    expect(formatChips(withJoin(all, [0, 1]))).toBe('any(object == a or bounce == 0) and depth == 1');
    const one = toChips('any(object == a) and depth == 1');
    expect(formatChips(withChip(one, [0, 0], () => null))).toBe('depth == 1');
    expect(formatChips(withChip(one, [0], withOtherQuantifier))).toBe('all(object == a) and depth == 1');
  });

  test('a condition that is added holds for all of them', () => {
    expect(formatChips(withAlso(toChips('depth == 1 or depth == 9'), brushChip('end == escaped', false)))).toBe(
      '(depth == 1 or depth == 9) and end == escaped',
    );
    expect(withText('', 'a then b')).toBe('a then b');
    expect(withText('depth == 1', 'pixel.x == 2 and pixel.y == 3')).toBe('depth == 1 and pixel.x == 2 and pixel.y == 3');
    expect(withText('depth == 1', 'end == a or end == b')).toBe('depth == 1 and (end == a or end == b)');
    expect(withText('what is this', 'depth == 1')).toBe('(what is this) and depth == 1');
  });
});

const only = (text: string) => toChips(text).chips[0] as BrushChip;

describe('brushes', () => {
  test.each<[Ranges, string]>([
    [[[3, 5]], 'depth >= 3 and depth <= 5'],
    [[[3, 3]], 'depth == 3'],
    [[[-Infinity, 5]], 'depth <= 5'],
    [[[0.125, Infinity]], 'depth >= 0.125'],
    [
      [
        [1, 2],
        [-4e-7, 1.5e30],
      ],
      'depth >= 1 and depth <= 2 or depth >= -4e-7 and depth <= 1.5e+30',
    ],
  ])('%j is text and comes back', (ranges, text) => {
    expect(formatRanges('depth', ranges)).toBe(text);
    expect(rangesOf(brushChip(text, false))).toEqual(ranges);
    // And within a longer text.
    const chip = toChips(formatChips(withAlso(toChips('end == escaped'), brushChip(text, true)))).chips[1] as BrushChip;
    expect(chip.negated).toBe(true);
    expect(rangesOf(chip)).toEqual(ranges);
  });

  test('bounds are rounded outward, and whole numbers stay whole', () => {
    const [[low, high]] = rangesOf(only(formatRanges('first.x', [[-1.23456789, 2.3456789e-9]]))) as [[number, number]];
    expect([low, high]).toEqual([-1.23457, 2.34568e-9]);
    for (let i = 0; i < 2000; i++) {
      const [a, b] = [Math.random(), Math.random()].map((v) => Math.fround((v - 0.5) * 10 ** (i % 30 - 15)));
      const range: [number, number] = [Math.min(a!, b!), Math.max(a!, b!)];
      const [[from, to]] = rangesOf(brushChip(formatRanges('first.x', [range]), false)) as [[number, number]];
      expect(from).toBeLessThanOrEqual(range[0] + 2e-12 * Math.abs(range[0]));
      expect(to).toBeGreaterThanOrEqual(range[1] - 2e-12 * Math.abs(range[1]));
      expect(Math.abs(from - range[0])).toBeLessThanOrEqual(1.1e-5 * Math.abs(range[0]));
    }
    expect(formatRanges('depth', [[2.2, 5.9]], true)).toBe('depth >= 3 and depth <= 5');
    expect(formatRanges('depth', [[2.2, 2.4]], true)).toBe('depth == 2');
  });

  test('sets of names come back by what they match', () => {
    const every = ['room.wall', 'room.floor', 'lamp', 'a b'];
    const text = formatWords('first.object', ['room.wall', 'a b', null], every);
    expect(text).toBe(
      'first.object == room.wall or first.object == "a b" or not (first.object == room or first.object == lamp or first.object == "a b")',
    );
    const chip = brushChip(text, false);
    expect([null, ...every].map((name) => hasCategory(chip, name))).toEqual([true, true, false, false, true]);
    const room = only('first.object == room');
    expect(every.map((name) => hasCategory(room, name))).toEqual([true, true, false, false]);
    expect(hasCategory(only('first.object != room'), null)).toBe(true);
    expect(hasCategory(only('end == escaped'), 'escaped.x')).toBe(false);
  });

  test('other forms are no ranges', () => {
    expect(rangesOf(only('depth != 3'))).toBeNull();
    expect(rangesOf(only('(depth > 3 and (depth < 5 or depth == 9))'))).toBeNull();
    expect(rangesOf(only('end == escaped'))).toBeNull();
  });
});

test('the command is quoted for a shell', () => {
  expect(command(['a b.paths'], "first.object == \"it's\"")).toBe(
    `femc paths 'a b.paths' --where 'first.object == "it'\\''s"'`,
  );
  expect(command(['a.paths'], '')).toBe('femc paths a.paths');
});
