import { afterEach, expect, test, vi } from 'vitest';
import { api, ApiError, explain } from '../../src/lib/api';

afterEach(() => void vi.unstubAllGlobals());

test('a job of many frames is read window by window, each frame once', async () => {
  const total = 25_000;
  const asked: string[] = [];
  vi.stubGlobal('fetch', async (path: string) => {
    asked.push(path);
    const query = new URL(path, 'http://farm').searchParams;
    const [from, count] = [Number(query.get('from')), Number(query.get('count'))];
    const frames = Array.from({ length: Math.min(count, total - from) }, (_, i) => ({ frame: from + i + 1 }));
    return new Response(JSON.stringify({ frames, total }));
  });
  const frames = await api.frames(7);
  expect(frames.map((it) => it.frame)).toEqual(Array.from({ length: total }, (_, i) => i + 1));
  expect(asked.length).toBe(3);
});

test('a refusal has the words of the coordinator, and what helps', async () => {
  const error = { code: 'forbidden', message: 'this takes an operator', help: 'ask one' };
  vi.stubGlobal('fetch', async () => new Response(JSON.stringify({ error }), { status: 403 }));
  const refused = await api.control([1], 'pause').catch((it: unknown) => it);
  expect(refused).toBeInstanceOf(ApiError);
  expect((refused as ApiError).status).toBe(403);
  expect(explain(refused)).toBe('this takes an operator (ask one)');
});

test('a coordinator that is not there is said to be so', async () => {
  vi.stubGlobal('fetch', async () => Promise.reject(new TypeError('failed to fetch')));
  await expect(api.me()).rejects.toThrow('the coordinator does not answer');
});

test('more jobs than a request may have are steered in several requests, and what fails is told job by job', async () => {
  const asked: number[][] = [];
  let left = 2;
  vi.stubGlobal('fetch', async (_: string, init: RequestInit) => {
    const { jobs } = JSON.parse(init.body as string) as { jobs: number[] };
    if (left-- === 0) throw new TypeError('failed to fetch');
    asked.push(jobs);
    return new Response(JSON.stringify({ done: jobs.slice(1), refused: [{ job: jobs[0], code: 'x', message: 'no' }] }));
  });
  const numbers = Array.from({ length: 2500 }, (_, i) => i + 1);
  const { done, refused } = await api.control(numbers, 'pause');
  expect(asked.map((jobs) => jobs.length)).toEqual([1000, 1000]);
  expect([done.length, refused.length]).toEqual([1998, 502]);
  expect([...done, ...refused.map((it) => it.job!)].sort((a, b) => a - b)).toEqual(numbers);
  expect(refused.at(-1)!.message).toBe('the coordinator does not answer');
});

test('a change that was not delivered is not said to be repeated', async () => {
  vi.stubGlobal('fetch', async () => Promise.reject(new TypeError('failed to fetch')));
  const error = await api.control([1], 'pause').catch((it: unknown) => it);
  expect(explain(error)).toContain('does not send it again');
});

test('pixels come from a frame or from a file, and an unchanged tag gets none', async () => {
  const asked: string[] = [];
  vi.stubGlobal('fetch', async (path: string, init: { headers: Record<string, string> }) => {
    asked.push(`${path} ${init.headers['If-None-Match'] ?? ''}`.trim());
    return new Response(null, { status: init.headers['If-None-Match'] ? 304 : 204 });
  });
  expect(await api.pixels({ job: 7, frame: 3, what: 'maps' }, null)).toEqual({ pixels: null, etag: null });
  expect(await api.pixels({ file: 1 }, '"x"')).toBeUndefined();
  expect(asked).toEqual(['/api/v1/jobs/7/frames/3/maps', '/api/v1/files/1/maps "x"']);
});
