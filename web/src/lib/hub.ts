/**
 * One feed for all pages of a browser. Over plain HTTP a browser opens at most six connections to a coordinator, so
 * one feed per page would leave none for the seventh page.
 *
 * The hub runs in a shared worker ([`feed.worker.ts`]), which no page owns. A browser without shared workers has one
 * hub in each page. The hub stays connected while at least one page is visible. A page is a port: it reports when it
 * is visible, hidden or gone. While visible, it also sends signs of life, because the browser does not report the end
 * of a crashed page.
 */

import { EMPTY, Feed, type Connection, type Delta, type FarmState } from './feed';

/** Message from a page to the hub. */
export type PageMessage =
  /** The page is visible and knows the farm up to `seq`. Repeated as a sign of life. */
  | { kind: 'visible'; seq: string | null }
  | { kind: 'hidden' }
  | { kind: 'gone' }
  /** Try to connect now. */
  | { kind: 'again' }
  /** Reconnect, because the user has signed in or out. */
  | { kind: 'restart' };

/** Message from the hub to a page. */
export type HubMessage =
  | { kind: 'alive' }
  | { kind: 'connection'; connection: Connection }
  | { kind: 'state'; state: FarmState }
  /** Changes of the state with the number `since`. */
  | { kind: 'delta'; since: string | null; delta: Delta };

/** Interval between signs of life of a visible page. */
export const SIGN_MS = 5_000;
/** Silence after which a visible page counts as gone. The timers of some pages run late. */
export const SILENT_PAGE_MS = 90_000;
/** Time for which the feed outlives the last visible page, so that switching tabs needs no new connection. */
export const GRACE_MS = 1_000;

/** One end of a channel: a `MessagePort`, or a substitute in tests without a browser. */
export interface Port {
  postMessage(message: HubMessage): void;
  onmessage: ((event: MessageEvent<PageMessage>) => void) | null;
  close(): void;
}

interface Page {
  isVisible: boolean;
  heard: number;
}

export class Hub {
  private readonly pages = new Map<Port, Page>();
  private state: FarmState = EMPTY;
  private connection: Connection = { state: 'connecting' };
  private feed: Feed | null = null;
  private grace: ReturnType<typeof setTimeout> | undefined;
  private sweeper: ReturnType<typeof setInterval> | undefined;

  constructor(private readonly request?: typeof fetch) {}

  /** Adds a page. */
  connect(port: Port) {
    this.pages.set(port, { isVisible: false, heard: Date.now() });
    port.onmessage = ({ data }) => this.on(port, data);
  }

  /** Ends the feed at once. */
  end() {
    clearTimeout(this.grace);
    this.grace = undefined;
    this.feed?.stop();
    this.feed = null;
  }

  private on(port: Port, message: PageMessage) {
    const page = this.pages.get(port);
    if (!page) return;
    page.heard = Date.now();
    switch (message.kind) {
      case 'visible':
        return this.show(port, page, message.seq);
      case 'hidden':
        page.isVisible = false;
        return this.settle();
      case 'gone':
        this.pages.delete(port);
        port.close();
        return this.settle();
      case 'again':
        return this.feed?.again();
      case 'restart':
        this.end();
        this.state = EMPTY;
        return this.settle();
    }
  }

  private show(port: Port, page: Page, seq: string | null) {
    if (page.isVisible) return port.postMessage({ kind: 'alive' });
    page.isVisible = true;
    // A new page may have a cookie that was missing at the last refusal.
    if (this.connection.state === 'denied') this.end();
    this.settle();
    if (this.state.seq !== null && this.state.seq !== seq) port.postMessage({ kind: 'state', state: this.state });
    port.postMessage({ kind: 'connection', connection: this.connection });
  }

  /** Starts or ends the feed, as the pages require. */
  private settle() {
    const isWanted = [...this.pages.values()].some((page) => page.isVisible);
    if (!isWanted) {
      clearInterval(this.sweeper);
      this.sweeper = undefined;
      if (this.feed) this.grace ??= setTimeout(() => this.end(), GRACE_MS);
      return;
    }
    clearTimeout(this.grace);
    this.grace = undefined;
    this.sweeper ??= setInterval(() => this.sweep(), SIGN_MS);
    if (!this.feed) this.start();
  }

  private start() {
    const feed: Feed = new Feed(
      {
        farm: (state, delta) => {
          if (this.feed !== feed) return;
          const since = this.state.seq;
          this.state = state;
          this.tell(delta ? { kind: 'delta', since, delta } : { kind: 'state', state });
        },
        connection: (connection) => {
          if (this.feed !== feed) return;
          this.connection = connection;
          this.tell({ kind: 'connection', connection });
        },
      },
      this.request,
      Date.now,
      this.state,
    );
    this.feed = feed;
    this.connection = { state: 'connecting' };
    this.tell({ kind: 'connection', connection: this.connection });
    void feed.run();
  }

  private tell(message: HubMessage) {
    for (const [port, page] of this.pages) if (page.isVisible) port.postMessage(message);
  }

  /** Drops silent pages. */
  private sweep() {
    const due = Date.now() - SILENT_PAGE_MS;
    for (const [port, page] of this.pages) if (page.isVisible && page.heard < due) this.pages.delete(port);
    this.settle();
  }
}
