import { afterEach, beforeEach, expect, test, vi } from 'vitest';
import type { Task } from '../../src/lib/types';
import { TaskWindows, WINDOW } from '../../src/lib/windows.svelte';

const TOTAL = 100_000;
const task = (index: number): Task => ({
  task: `1/1.0/render.0/${index}`,
  frame: 1,
  stage: 'render',
  index,
  state: 'waiting',
  number: 0,
  round: 0,
  workers: [],
  attempts: 0,
  seconds: null,
  failure: null,
});

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

function server() {
  const asked: number[] = [];
  const ask = async (_job: number, from: number, count: number) => {
    asked.push(from);
    return { total: TOTAL, tasks: Array.from({ length: Math.min(count, TOTAL - from) }, (_, i) => task(from + i)) };
  };
  return { asked, windows: new TaskWindows(1, {}, ask) };
}

test('only what is in sight is asked for, and a fling asks for nothing on its way', async () => {
  const { asked, windows } = server();
  windows.show(0, 40);
  await vi.advanceTimersByTimeAsync(100);
  for (let first = 0; first < 90_000; first += 1_000) windows.show(first, first + 40);
  windows.show(90_480, 90_520);
  await vi.advanceTimersByTimeAsync(100);
  expect(asked).toEqual([0, 90_000, 90_500]);
  expect(windows.total).toBe(TOTAL);
  expect(windows.at(90_519)?.index).toBe(90_519);
  expect(windows.at(50_000)).toBeUndefined();
});

test('after a change of the job what is in sight is asked for again, once a second at most', async () => {
  const { asked, windows } = server();
  windows.show(0, 40);
  await vi.advanceTimersByTimeAsync(100);
  for (let i = 0; i < 10; i++) {
    windows.changed();
    await vi.advanceTimersByTimeAsync(200);
  }
  expect(asked.length).toBeLessThanOrEqual(3);
  expect(new Set(asked)).toEqual(new Set([0]));
});

test('memory is bounded: old windows go', async () => {
  const { windows } = server();
  for (let first = 0; first < TOTAL; first += WINDOW) {
    windows.show(first, first + 40);
    await vi.advanceTimersByTimeAsync(100);
  }
  const kept = Array.from({ length: TOTAL / WINDOW }, (_, i) => windows.at(i * WINDOW)).filter(Boolean).length;
  expect(kept).toBe(40);
  expect(windows.at(TOTAL - 1)?.index).toBe(TOTAL - 1);
});
