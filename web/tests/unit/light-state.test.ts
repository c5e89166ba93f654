import { afterEach, beforeEach, describe, expect, test, vi } from 'vitest';
import { DataSet, Newest } from '../../src/lib/light/state.svelte';
import { encodeColumns } from './columns';

beforeEach(() => void vi.useFakeTimers());
afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

describe('requests', () => {
  test('one at a time, and only the newest waits', async () => {
    const done: number[] = [];
    const requests = new Newest(60, () => {});
    const ask = (n: number) =>
      requests.run(async () => {
        await new Promise((resolve) => setTimeout(resolve, 100));
        done.push(n);
      });
    for (let n = 0; n < 10; n++) {
      ask(n);
      await vi.advanceTimersByTimeAsync(25);
    }
    await vi.advanceTimersByTimeAsync(500);
    expect(done[0]).toBe(0);
    expect(done.at(-1)).toBe(9);
    expect(done.length).toBeLessThan(6);
  });

  test('a request without a time limit is never aborted', async () => {
    const requests = new Newest(0, () => {}, Infinity);
    const done: string[] = [];
    const ask = (name: string) =>
      requests.run(async (signal) => {
        await new Promise((resolve) => setTimeout(resolve, 5000));
        done.push(name + (signal.aborted ? ' aborted' : ''));
      });
    ask('old');
    await vi.advanceTimersByTimeAsync(2000);
    ask('new');
    await vi.advanceTimersByTimeAsync(9000);
    expect(done).toEqual(['old', 'new']);
  });

  test('an old request gives way, and errors are reported', async () => {
    const errors: unknown[] = [];
    const requests = new Newest(0, (error) => errors.push(error));
    const aborted = vi.fn();
    requests.run((signal) => new Promise((_, reject) => signal.addEventListener('abort', () => (aborted(), reject(signal.reason)))));
    await vi.advanceTimersByTimeAsync(1000);
    requests.run(() => Promise.reject(new Error('no')));
    await vi.advanceTimersByTimeAsync(10);
    expect(aborted).toHaveBeenCalledOnce();
    expect(errors).toEqual([new Error('no')]);
    requests.stop();
    requests.run(() => Promise.reject(new Error('late')));
    await vi.advanceTimersByTimeAsync(10);
    expect(errors.length).toBe(1);
  });
});

/** A server whose data grow: `tag` is their state, and selections have `maskTag`. */
class Server {
  tag = 'a';
  maskTag: string | null = null;
  fault: number | null = null;
  /** Calls that fail; null: all. */
  faulty: string | null = null;
  /** Whether the brightest paths come with their selection. */
  marks = true;
  readonly calls: string[] = [];

  answer = (path: string, init?: RequestInit): Promise<Response> => {
    const url = new URL(path, 'http://farm');
    const call = url.pathname.split('/').at(-1)!;
    this.calls.push(call + url.search);
    if (this.fault && (this.faulty === null || this.faulty === call)) {
      const error = { error: { code: 'x', message: 'where: column 3: what', help: null } };
      return Promise.resolve(new Response(JSON.stringify(error), { status: this.fault }));
    }
    const etag = `"${this.tag}"`;
    if (call === 'schema') {
      if ((init?.headers as Record<string, string>)?.['If-None-Match'] === etag) {
        return Promise.resolve(new Response(null, { status: 304 }));
      }
      const axes = [{ name: 'depth', scale: 'count', field: 'depth' }];
      const schema = { tag: this.tag, version: 1, box: [[0, 0, 0], [1, 1, 1]], tables: { paths: axes, intersections: [], lights: [] } };
      return Promise.resolve(new Response(JSON.stringify(schema), { headers: { ETag: etag } }));
    }
    const tag = call === 'selection' ? (this.maskTag ?? this.tag) : this.tag;
    const one = (name: string, type: 'u8' | 'u32' | 'f32' | 'f64', values: number[]) => [name, type, values] as const;
    const columns = {
      paths: [
        one('paths.depth', 'f32', [1, 2]),
        ...['paths.number', 'paths.frame', 'paths.sample'].map((name) => one(name, 'u32', [0, 1])),
        ...['intersections.number', 'lights.number', 'intersections.path', 'intersections.parent', 'lights.path', 'lights.intersection'].map((name) => one(name, 'u32', [])),
        ...(this.marks && url.searchParams.get('among') === 'brightest' && url.searchParams.get('where')
          ? [one('paths.selected', 'u8', [1, 1]), one('intersections.selected', 'u8', []), one('lights.selected', 'u8', [])]
          : []),
      ],
      selection: ['paths', 'intersections', 'lights'].map((table) => one(`${table}.mask`, 'u8', [2])),
      histograms: [
        one('paths.0', 'f64', []),
        ...(url.searchParams.get('pairs') ?? '').split(',').filter(Boolean).map((key) => one(key.replace(':', '.'), 'f32', [1])),
      ],
    }[call]!;
    return Promise.resolve(new Response(encodeColumns({ tag, recorded: 2 }, columns.map((it) => [...it]))));
  };
}

async function begin() {
  const server = new Server();
  vi.stubGlobal('fetch', server.answer);
  const data = new DataSet({ job: 1, frames: [1, 2] });
  data.configure({ count: 500, among: 'all', box: null });
  data.refresh();
  await vi.advanceTimersByTimeAsync(10);
  return { server, data };
}

describe('a data set', () => {
  test('loads, selects, and asks for pairs once', async () => {
    const { server, data } = await begin();
    expect(data.status).toBe('ready');
    expect(data.rows?.values.paths[0]).toEqual(Float32Array.of(1, 2));
    expect(data.selected).toBeNull();
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(300);
    expect([...data.selected!.paths]).toEqual([0, 1]);
    expect(data.selection?.where).toBe('depth == 2');
    for (let i = 0; i < 2; i++) {
      data.needPairs('paths', [[0, 0]]);
      await vi.advanceTimersByTimeAsync(100);
    }
    expect(server.calls.filter((call) => call.includes('pairs=')).length).toBe(1);
    expect(data.pairs.get('paths:0-0')?.counts).toEqual(Float32Array.of(1));
    data.select('', true);
    expect([data.selected, data.selection]).toEqual([null, null]);
  });

  test('unchanged data are not loaded again; new data are, and the selection stays', async () => {
    const { server, data } = await begin();
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(1500);
    const before = server.calls.length;
    data.refresh();
    await vi.advanceTimersByTimeAsync(1500);
    expect(server.calls.length).toBe(before + 1);
    server.tag = 'b';
    data.refresh();
    await vi.advanceTimersByTimeAsync(1500);
    expect(data.rows?.tag).toBe('b');
    expect([...data.selected!.paths]).toEqual([0, 1]);
  });

  test('rows and masks of different states are not mixed', async () => {
    const { server, data } = await begin();
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(1500);
    server.tag = 'b';
    server.maskTag = 'c';
    data.refresh();
    await vi.advanceTimersByTimeAsync(200);
    expect(data.rows?.tag).toBe('a');
    server.tag = 'c';
    await vi.advanceTimersByTimeAsync(3000);
    expect(data.rows?.tag).toBe('c');
    expect(data.selected).not.toBeNull();
  });

  test('a faulty condition is refused, and the last result stays', async () => {
    const { server, data } = await begin();
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(300);
    server.fault = 400;
    data.select('depth == x', true);
    await vi.advanceTimersByTimeAsync(300);
    expect(data.refusal).toBe('column 3: what');
    expect(data.selection?.where).toBe('depth == 2');
    expect(data.error).toBeNull();
  });

  test('the brightest paths come with their selection, and are asked again when it changes', async () => {
    const { server, data } = await begin();
    data.configure({ count: 500, among: 'brightest', box: null });
    await vi.advanceTimersByTimeAsync(300);
    const rows = data.rows;
    expect(data.brightest).toBeNull();
    data.select('depth == 2', false);
    await vi.advanceTimersByTimeAsync(300);
    // The masks contain only the second path.
    expect([...data.selected!.paths]).toEqual([1, 1]);
    expect(data.brightest).toMatchObject({ where: 'depth == 2', count: 2 });
    expect(data.rows).toBe(rows);
    expect(server.calls.filter((call) => call.startsWith('paths?')).at(-1)).toContain('where=depth+');
    data.select('', true);
    await vi.advanceTimersByTimeAsync(300);
    expect([data.selected, data.brightest]).toEqual([null, null]);
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(300);
    expect([...data.selected!.paths]).toEqual([1, 1]);
    data.configure({ count: 500, among: 'all', box: null });
    await vi.advanceTimersByTimeAsync(300);
    expect([...data.selected!.paths]).toEqual([0, 1]);
  });

  test('without these columns, masks select among the brightest', async () => {
    const { server, data } = await begin();
    server.marks = false;
    data.configure({ count: 500, among: 'brightest', box: null });
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(300);
    expect([...data.selected!.paths]).toEqual([0, 1]);
    expect(data.brightest).toBeNull();
  });

  test('errors do not stick', async () => {
    const { server, data } = await begin();
    // A damaged file is not retried, but the next refresh asks again.
    [server.fault, server.faulty] = [422, 'histograms'];
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(500);
    expect(data.error).toMatchObject({ status: 422, help: null });
    data.select('depth == 3', true);
    expect(data.error).toBeNull();
    await vi.advanceTimersByTimeAsync(5000);
    expect(data.error?.status).toBe(422);
    const before = server.calls.length;
    await vi.advanceTimersByTimeAsync(8000);
    expect(server.calls.length).toBe(before);
    server.fault = null;
    data.refresh();
    await vi.advanceTimersByTimeAsync(500);
    expect(data.error).toBeNull();
    expect(data.selectedHistograms).not.toBeNull();
    // Too many requests are retried.
    server.fault = 429;
    data.select('depth == 4', true);
    await vi.advanceTimersByTimeAsync(500);
    expect(data.error?.status).toBe(429);
    server.fault = null;
    await vi.advanceTimersByTimeAsync(8000);
    expect(data.error).toBeNull();
    expect(data.selection?.where).toBe('depth == 4');
  });

  test('after a fault of the server everything is asked again', async () => {
    const { server, data } = await begin();
    server.fault = 503;
    data.select('depth == 2', true);
    await vi.advanceTimersByTimeAsync(500);
    expect(data.error?.status).toBe(503);
    server.fault = null;
    await vi.advanceTimersByTimeAsync(8000);
    expect(data.error).toBeNull();
    expect([...data.selected!.paths]).toEqual([0, 1]);
    data.stop();
    const before = server.calls.length;
    await vi.advanceTimersByTimeAsync(8000);
    expect(server.calls.length).toBe(before);
  });
});
