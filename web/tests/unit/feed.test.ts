import { afterEach, beforeEach, describe, expect, test, vi } from 'vitest';
import {
  EventParser,
  Feed,
  fromSnapshot,
  join,
  SILENCE_MS,
  type Connection,
  type FarmState,
} from '../../src/lib/feed';
import { job, offline, worker } from './fixtures';

describe('joining', () => {
  const begin = fromSnapshot({ seq: '7-1', jobs: [job(1), job(2)], workers: [worker(1)], offline: [], warnings: ['low on room'] });

  test('a delta adds, changes and removes, and leaves the state before it alone', () => {
    const after = join(begin, {
      seq: '7-2',
      jobs: [job(2, { state: 'done' }), job(3)],
      gone_jobs: [1],
      warnings: null,
    });
    expect([...after.jobs.keys()]).toEqual([2, 3]);
    expect(after.jobs.get(2)?.state).toBe('done');
    expect(after.seq).toBe('7-2');
    expect(after.warnings).toEqual(['low on room']);
    expect([...begin.jobs.keys()]).toEqual([1, 2]);
    expect(begin.jobs.get(2)?.state).toBe('running');
  });

  test('what has no change is the same object, so that nothing is drawn again for it', () => {
    const after = join(begin, { seq: '7-2', workers: [worker(2)] });
    expect(after.jobs).toBe(begin.jobs);
    expect(after.workers).not.toBe(begin.workers);
    expect(join(begin, { seq: '7-3', warnings: [] }).warnings).toEqual([]);
  });

  test('a job that comes and goes in one joined delta is gone', () => {
    expect(join(begin, { seq: '7-9', jobs: [job(5)], gone_jobs: [5] }).jobs.has(5)).toBe(false);
  });
});

describe('workers that are offline', () => {
  const begin = fromSnapshot({ seq: '7-1', jobs: [], workers: [], offline: [offline('a', 5)], warnings: [] });

  test('they are as told last, also where a delta says nothing of them', () => {
    expect(join(begin, { seq: '7-2', offline: null }).offline).toBe(begin.offline);
    expect(join(begin, { seq: '7-2', workers: [worker(3, 'a')], offline: [] }).offline).toEqual([]);
    const after = join(begin, { seq: '7-2', offline: [offline('b', 9), offline('a', 5)] });
    expect(after.offline.map((it) => [it.name, it.last_contact])).toEqual([
      ['b', 9],
      ['a', 5],
    ]);
  });
});

describe('parsing', () => {
  test('events come whole whatever the pieces', () => {
    const text =
      ': alive\n\nid: 7-1\nevent: snapshot\ndata: {"a":1,\ndata: "b":2}\n\nid: 7-2\r\nevent: delta\r\ndata:x\r\n\r\n';
    const whole = new EventParser().push(text);
    expect(whole).toEqual([
      { id: '7-1', event: 'snapshot', data: '{"a":1,\n"b":2}' },
      { id: '7-2', event: 'delta', data: 'x' },
    ]);
    for (let cut = 1; cut < text.length; cut++) {
      const parser = new EventParser();
      expect([...parser.push(text.slice(0, cut)), ...parser.push(text.slice(cut))]).toEqual(whole);
    }
  });

  test('an event that has not ended is not told', () => {
    expect(new EventParser().push('event: delta\ndata: half\n')).toEqual([]);
  });
});

/** A coordinator whose connections each send one text, then end or stay open. */
class Coordinator {
  asked: (string | null)[] = [];
  constructor(private readonly answers: (Response | 'refuse')[]) {}
  readonly fetch = (async (_url: unknown, init?: RequestInit) => {
    this.asked.push(new Headers(init?.headers).get('Last-Event-ID'));
    const answer = this.answers.shift();
    if (!answer) return new Promise<never>(() => {});
    if (answer === 'refuse') throw new TypeError('connection refused');
    return answer;
  }) as typeof fetch;
}

const events = (...list: [string, object][]) =>
  list
    .map(([event, data]) => `id: ${(data as { seq: string }).seq}\nevent: ${event}\ndata: ${JSON.stringify(data)}\n\n`)
    .join('');
const open = (text: string) =>
  new Response(new ReadableStream({ start: (stream) => stream.enqueue(new TextEncoder().encode(text)) }), {
    status: 200,
  });

describe('following', () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  function follow(coordinator: Coordinator) {
    const told: { states: FarmState[]; connections: Connection[] } = { states: [], connections: [] };
    const feed = new Feed(
      { farm: (state) => told.states.push(state), connection: (connection) => told.connections.push(connection) },
      coordinator.fetch,
    );
    const ended = feed.run();
    return { feed, told, ended };
  }

  test('after a lost connection it goes on where it was, and after a restart it takes the new snapshot', async () => {
    const coordinator = new Coordinator([
      new Response(
        events(
          ['snapshot', { seq: '7-1', jobs: [job(1)], workers: [], offline: [], warnings: [] }],
          ['delta', { seq: '7-2', jobs: [job(2)] }],
        ),
      ),
      'refuse',
      open(events(['snapshot', { seq: '8-1', jobs: [job(9)], workers: [], offline: [], warnings: [] }])),
    ]);
    const { feed, told } = follow(coordinator);
    await vi.advanceTimersByTimeAsync(0);
    expect(told.states.map((state) => [...state.jobs.keys()])).toEqual([[1], [1, 2]]);
    expect(told.connections.map((it) => it.state)).toEqual(['live', 'lost']);
    await vi.advanceTimersByTimeAsync(5_000);
    expect(coordinator.asked).toEqual([null, '7-2', '7-2']);
    expect([...told.states.at(-1)!.jobs.keys()]).toEqual([9]);
    expect(told.connections.map((it) => it.state)).toEqual(['live', 'lost', 'lost', 'live']);
    const [first, second] = told.connections.filter((it) => it.state === 'lost');
    expect(second?.since).toBe(first?.since);
    feed.stop();
  });

  test('a connection without a sign of life is given up', async () => {
    const coordinator = new Coordinator([
      open(events(['snapshot', { seq: '7-1', jobs: [], workers: [], offline: [], warnings: [] }])),
      'refuse',
    ]);
    const { feed, told } = follow(coordinator);
    await vi.advanceTimersByTimeAsync(SILENCE_MS - 1);
    expect(told.connections.at(-1)?.state).toBe('live');
    await vi.advanceTimersByTimeAsync(1_000);
    expect(told.connections.at(-1)?.state).toBe('lost');
    feed.stop();
  });

  test('who is refused is told so once, and does not ask again', async () => {
    const denied = new Response(JSON.stringify({ error: { code: 'unauthenticated', message: 'show a token' } }), {
      status: 401,
    });
    const coordinator = new Coordinator([denied, 'refuse']);
    const { told, ended } = follow(coordinator);
    await ended;
    await vi.advanceTimersByTimeAsync(60_000);
    expect(told.connections).toEqual([{ state: 'denied', why: 'show a token' }]);
    expect(coordinator.asked.length).toBe(1);
  });

  test('the waits grow to five seconds and no further', async () => {
    const coordinator = new Coordinator(Array.from({ length: 40 }, () => 'refuse' as const));
    const { feed } = follow(coordinator);
    await vi.advanceTimersByTimeAsync(60_000);
    expect(coordinator.asked.length).toBeGreaterThan(12);
    expect(coordinator.asked.length).toBeLessThan(18);
    feed.stop();
  });
});
