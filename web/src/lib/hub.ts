/**
 * One feed for all pages of a browser. Over plain HTTP a browser has six connections to a coordinator, so a feed for
 * each page would leave none for the seventh.
 *
 * The hub runs in a shared worker ([`feed.worker.ts`]), where no page owns it; a browser without shared workers has one
 * in each page. It holds a connection while at least one page is visible. A page is a port: it says when it is visible,
 * hidden or gone, and gives a sign of life while it is visible, since the end of a page that crashed is not reported.
 */

import { EMPTY, Feed, type Connection, type Delta, type FarmState } from './feed';

/** From a page to the hub. */
export type PageMessage =
  /** The page is visible, and knows the farm up to `seq`. Repeated as a sign of life. */
  | { kind: 'visible'; seq: string | null }
  | { kind: 'hidden' }
  | { kind: 'gone' }
  /** Try to connect now. */
  | { kind: 'again' }
  /** Connect anew, since the user has signed in or out. */
  | { kind: 'restart' };

/** From the hub to a page. */
export type HubMessage =
  | { kind: 'alive' }
  | { kind: 'connection'; connection: Connection }
  | { kind: 'state'; state: FarmState }
  /** Changes of the state with the number `since`. */
  | { kind: 'delta'; since: string | null; delta: Delta };

/** Time between two signs of life of a visible page. */
export const SIGN_MS = 5_000;
/** A visible page that is silent for longer than this counts as gone; timers of some pages run late. */
export const SILENT_PAGE_MS = 90_000;
/** Time for which the feed outlives the last visible page: a change from one tab to another needs no new connection. */
export const GRACE_MS = 1_000;

/** The end of a channel; a `MessagePort`, for tests without a browser. */
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
    // A page that is new may have a cookie that the last refusal lacked.
    if (this.connection.state === 'denied') this.end();
    this.settle();
    if (this.state.seq !== null && this.state.seq !== seq) port.postMessage({ kind: 'state', state: this.state });
    port.postMessage({ kind: 'connection', connection: this.connection });
  }

  /** Starts or ends the feed, as the pages want it. */
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

  /** Drops pages that are silent. */
  private sweep() {
    const due = Date.now() - SILENT_PAGE_MS;
    for (const [port, page] of this.pages) if (page.isVisible && page.heard < due) this.pages.delete(port);
    this.settle();
  }
}
