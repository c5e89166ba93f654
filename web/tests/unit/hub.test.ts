import { afterEach, beforeEach, describe, expect, test, vi } from 'vitest';
import type { Connection, FarmState } from '../../src/lib/feed';
import { GRACE_MS, Hub, SILENT_PAGE_MS, type HubMessage, type PageMessage, type Port } from '../../src/lib/hub';
import { Subscription, type HubPort, type Link } from '../../src/lib/subscription';
import { job } from './fixtures';

/** A coordinator that keeps each connection open and counts them. */
class Coordinator {
  /** Last known change in each request. */
  asked: (string | null)[] = [];
  open = new Set<ReadableStreamDefaultController<Uint8Array>>();
  denies = false;
  readonly fetch = (async (_url: unknown, init?: RequestInit) => {
    this.asked.push(new Headers(init?.headers).get('Last-Event-ID'));
    if (this.denies) return new Response(JSON.stringify({ error: { code: 'unauthenticated', message: 'no token' } }), { status: 401 });
    let mine: ReadableStreamDefaultController<Uint8Array>;
    const body = new ReadableStream<Uint8Array>({
      start: (stream) => {
        mine = stream;
        this.open.add(stream);
      },
      cancel: () => void this.open.delete(mine),
    });
    init?.signal?.addEventListener('abort', () => this.open.delete(mine));
    return new Response(body, { status: 200 });
  }) as typeof fetch;

  send(event: 'snapshot' | 'delta', data: object & { seq: string }) {
    const text = `id: ${data.seq}\nevent: ${event}\ndata: ${JSON.stringify(data)}\n\n`;
    for (const stream of this.open) stream.enqueue(new TextEncoder().encode(text));
  }
}

/** A window with the parts that a subscription uses; `visibility` is the state of the tab. */
function tab(hub: Hub) {
  const listeners = new Map<string, (event: { persisted: boolean }) => void>();
  const told: { states: FarmState[]; connections: Connection[] } = { states: [], connections: [] };
  const document = { visibilityState: 'visible', addEventListener: (name: string, run: () => void) => listeners.set(name, run) };
  const within = <T>(run: () => T): T => {
    vi.stubGlobal('document', document);
    vi.stubGlobal('addEventListener', (name: string, listener: () => void) => listeners.set(name, listener));
    return run();
  };
  const open = (): Link => {
    const [page, port] = channel();
    hub.connect(port);
    return { port: page };
  };
  const subscription = new Subscription(
    { farm: (state) => told.states.push(state), connection: (connection) => told.connections.push(connection) },
    open,
  );
  within(() => subscription.start());
  const fire = (name: string, persisted = false) => within(() => listeners.get(name)!({ persisted }));
  return {
    subscription,
    told,
    jobs: () => [...(told.states.at(-1)?.jobs.keys() ?? [])],
    show(isVisible: boolean) {
      document.visibilityState = isVisible ? 'visible' : 'hidden';
      fire('visibilitychange');
    },
    hide: () => fire('pagehide'),
    back: () => fire('pageshow', true),
  };
}

function channel(): [HubPort, Port] {
  let isOpen = true;
  const page: HubPort = {
    onmessage: null,
    postMessage: (data) => isOpen && port.onmessage?.({ data } as MessageEvent<PageMessage>),
    close: () => void (isOpen = false),
  };
  const port: Port = {
    onmessage: null,
    postMessage: (data) => isOpen && page.onmessage?.({ data } as MessageEvent<HubMessage>),
    close: () => void (isOpen = false),
  };
  return [page, port];
}

const snapshot = (seq: string, ...jobs: number[]) => ({
  seq,
  jobs: jobs.map((number) => job(number)),
  workers: [],
  offline: [],
  warnings: [],
});

describe('one feed for all pages of a browser', () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => {
    vi.unstubAllGlobals();
    vi.useRealTimers();
  });

  test('seven pages share a connection and all get its events', async () => {
    const coordinator = new Coordinator();
    const hub = new Hub(coordinator.fetch);
    const tabs = Array.from({ length: 6 }, () => tab(hub));
    await vi.advanceTimersByTimeAsync(0);
    coordinator.send('snapshot', snapshot('7-1', 1));
    await vi.advanceTimersByTimeAsync(0);
    tabs.push(tab(hub));
    expect(tabs.at(-1)!.jobs()).toEqual([1]);
    coordinator.send('delta', { seq: '7-2', jobs: [job(2)] } as never);
    await vi.advanceTimersByTimeAsync(0);
    for (const it of tabs) {
      expect(it.jobs()).toEqual([1, 2]);
      expect(it.told.connections.at(-1)).toEqual({ state: 'live' });
    }
    expect([coordinator.asked.length, coordinator.open.size]).toEqual([1, 1]);
  });

  test('the feed survives the page that opened it, and ends with the last one', async () => {
    const coordinator = new Coordinator();
    const hub = new Hub(coordinator.fetch);
    const [first, second] = [tab(hub), tab(hub)];
    await vi.advanceTimersByTimeAsync(0);
    coordinator.send('snapshot', snapshot('7-1', 1));
    await vi.advanceTimersByTimeAsync(0);
    first.hide();
    await vi.advanceTimersByTimeAsync(5 * GRACE_MS);
    coordinator.send('delta', { seq: '7-2', jobs: [job(2)] } as never);
    await vi.advanceTimersByTimeAsync(0);
    expect(second.jobs()).toEqual([1, 2]);
    expect(first.jobs()).toEqual([1]);
    expect(coordinator.asked.length).toBe(1);
    second.hide();
    await vi.advanceTimersByTimeAsync(GRACE_MS);
    expect(coordinator.open.size).toBe(0);
  });

  test('hidden pages hold no connection; a visible one gets what was missed', async () => {
    const coordinator = new Coordinator();
    const hub = new Hub(coordinator.fetch);
    const [a, b] = [tab(hub), tab(hub)];
    await vi.advanceTimersByTimeAsync(0);
    coordinator.send('snapshot', snapshot('7-1', 1));
    await vi.advanceTimersByTimeAsync(0);
    a.show(false);
    await vi.advanceTimersByTimeAsync(10 * GRACE_MS);
    expect(coordinator.open.size).toBe(1);
    b.show(false);
    await vi.advanceTimersByTimeAsync(GRACE_MS);
    expect(coordinator.open.size).toBe(0);
    a.show(true);
    await vi.advanceTimersByTimeAsync(0);
    expect(coordinator.asked).toEqual([null, '7-1']);
    coordinator.send('delta', { seq: '7-9', jobs: [job(9)], gone_jobs: [1] } as never);
    await vi.advanceTimersByTimeAsync(0);
    expect(a.jobs()).toEqual([9]);
    expect(b.jobs()).toEqual([1]);
    b.show(true);
    expect(b.jobs()).toEqual([9]);
    expect(coordinator.asked.length).toBe(2);
  });

  test('a change from one tab to another keeps the connection', async () => {
    const coordinator = new Coordinator();
    const hub = new Hub(coordinator.fetch);
    const [a, b] = [tab(hub), tab(hub)];
    b.show(false);
    await vi.advanceTimersByTimeAsync(GRACE_MS * 3);
    a.show(false);
    await vi.advanceTimersByTimeAsync(GRACE_MS / 2);
    b.show(true);
    await vi.advanceTimersByTimeAsync(GRACE_MS * 3);
    expect([coordinator.asked.length, coordinator.open.size]).toEqual([1, 1]);
  });

  test('a page that comes back from the cache of pages follows again', async () => {
    const coordinator = new Coordinator();
    const hub = new Hub(coordinator.fetch);
    const page = tab(hub);
    await vi.advanceTimersByTimeAsync(0);
    coordinator.send('snapshot', snapshot('7-1', 1));
    await vi.advanceTimersByTimeAsync(0);
    page.hide();
    await vi.advanceTimersByTimeAsync(GRACE_MS);
    expect(coordinator.open.size).toBe(0);
    page.back();
    await vi.advanceTimersByTimeAsync(0);
    expect(coordinator.asked).toEqual([null, '7-1']);
    coordinator.send('delta', { seq: '7-2', jobs: [job(2)] } as never);
    await vi.advanceTimersByTimeAsync(0);
    expect(page.jobs()).toEqual([1, 2]);
  });

  test('a page that crashes keeps the feed for a while and not for good', async () => {
    const coordinator = new Coordinator();
    const hub = new Hub(coordinator.fetch);
    const [page, port] = channel();
    hub.connect(port);
    page.postMessage({ kind: 'visible', seq: null });
    await vi.advanceTimersByTimeAsync(SILENT_PAGE_MS / 2);
    expect(coordinator.asked.length).toBeGreaterThan(0);
    await vi.advanceTimersByTimeAsync(SILENT_PAGE_MS);
    const before = coordinator.asked.length;
    expect(coordinator.open.size).toBe(0);
    await vi.advanceTimersByTimeAsync(10 * SILENT_PAGE_MS);
    expect(coordinator.asked.length).toBe(before);
  });

  test('a page that is alive stays, however long nothing changes', async () => {
    const coordinator = new Coordinator();
    const page = tab(new Hub(coordinator.fetch));
    const beat = setInterval(() => coordinator.send('delta', { seq: '7-1' } as never), 10_000);
    await vi.advanceTimersByTimeAsync(5 * SILENT_PAGE_MS);
    clearInterval(beat);
    expect(coordinator.asked.length).toBe(1);
    expect(page.told.connections.at(-1)).toEqual({ state: 'live' });
  });

  test('who is denied may sign in, and all pages connect anew with a snapshot', async () => {
    const coordinator = new Coordinator();
    coordinator.denies = true;
    const hub = new Hub(coordinator.fetch);
    const [a, b] = [tab(hub), tab(hub)];
    await vi.advanceTimersByTimeAsync(60_000);
    expect(a.told.connections.at(-1)).toEqual({ state: 'denied', why: 'no token' });
    expect(b.told.connections.at(-1)).toEqual({ state: 'denied', why: 'no token' });
    const before = coordinator.asked.length;
    expect(before).toBeLessThan(4);
    coordinator.denies = false;
    a.subscription.restart();
    await vi.advanceTimersByTimeAsync(0);
    coordinator.send('snapshot', snapshot('7-1', 1));
    await vi.advanceTimersByTimeAsync(0);
    expect([a.jobs(), b.jobs()]).toEqual([[1], [1]]);
    expect(coordinator.asked.slice(before)).toEqual([null]);
    // For another user, no request refers to what the first one saw.
    b.subscription.restart();
    await vi.advanceTimersByTimeAsync(0);
    expect(coordinator.asked.at(-1)).toBe(null);
    expect(coordinator.open.size).toBe(1);
  });
});
