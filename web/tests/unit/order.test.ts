import { describe, expect, test } from 'vitest';
import { jobError } from '../../src/lib/format';
import { slowest } from '../../src/lib/frames';
import { direction, nextOrder, parseOrder, sortedBy } from '../../src/lib/order';
import type { Frame } from '../../src/lib/types';
import { job } from './fixtures';

const frame = (number: number, processor_seconds: number | null, seconds: number): Frame => ({
  frame: number,
  state: 'done',
  stage: null,
  tiles_done: 0,
  tiles: 0,
  running: 0,
  samples: 0,
  relative_error: null,
  seconds,
  processor_seconds,
  has_image: true,
  outputs: [],
});

describe('orders', () => {
  const keys = ['name', 'cpu'];
  test('stand in the address', () => {
    expect(parseOrder('-cpu', keys)).toEqual({ key: 'cpu', descending: true });
    expect(parseOrder('name', keys)).toEqual({ key: 'name', descending: false });
    for (const text of [undefined, null, '', 'age', '-']) expect(parseOrder(text, keys)).toBeNull();
  });
  test('of numbers begin with the greatest, those of words with the first, and end after the second', () => {
    const walk = (key: string, number: boolean) => {
      const seen: (string | null)[] = [];
      for (let text: string | null = null, i = 0; i < 3; i++) {
        text = nextOrder(parseOrder(text, keys), key, number);
        seen.push(text);
      }
      return seen;
    };
    expect(walk('cpu', true)).toEqual(['-cpu', 'cpu', null]);
    expect(walk('name', false)).toEqual(['name', '-name', null]);
    expect(nextOrder({ key: 'name', descending: true }, 'cpu', true)).toBe('-cpu');
    expect(direction({ key: 'cpu', descending: true }, 'cpu')).toBe('descending');
    expect(direction({ key: 'cpu', descending: true }, 'name')).toBe('none');
  });
  test('leave what has no value at the end', () => {
    const all = [3, null, 1, 2, undefined];
    expect(sortedBy(all, (it) => it, false)).toEqual([1, 2, 3, null, undefined]);
    expect(sortedBy(all, (it) => it, true)).toEqual([3, 2, 1, null, undefined]);
    expect(sortedBy(['b', 'a'], (it) => it, false)).toEqual(['a', 'b']);
  });
});

test('the slowest frame is that of the most processor time, not that which waited longest', () => {
  expect(slowest([frame(1, 2, 60), frame(2, 8, 9), frame(3, null, 99)])?.frame).toBe(2);
  expect(slowest([])).toBeNull();
});

test('the error of a job names its worst frame, the target and why it is above', () => {
  const worst = { frames: 4, relative_error: 0.071, worst_frame: 3, error_target: 0.05 };
  expect(jobError(job(1, { ...worst, above_target: 'rendering' }))).toBe(
    '7.1 % in frame 3, above the target of 5.0 %: still rendering',
  );
  expect(jobError(job(1, { ...worst, relative_error: 0.04 }))).toBe('4.0 % in frame 3, within the target of 5.0 %');
  expect(jobError(job(1, { ...worst, error_target: null }))).toBe('7.1 % in frame 3');
  expect(jobError(job(1, { ...worst, frames: 1, above_target: 'unknown' }))).toBe('7.1 %, above the target of 5.0 %');
});
