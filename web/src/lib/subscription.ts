/** A page's subscription to the feed. It follows the farm while the page is visible. */

import { EMPTY, join, type FarmState, type Watcher } from './feed';
import { Hub, SIGN_MS, type HubMessage, type PageMessage, type Port } from './hub';

/** Silence after which a hub counts as crashed. A new worker is then started. */
const SILENT_HUB_MS = 20_000;

/** The page's end of a channel to a hub. */
export interface HubPort {
  postMessage(message: PageMessage): void;
  onmessage: ((event: MessageEvent<HubMessage>) => void) | null;
  close(): void;
}

export interface Link {
  port: HubPort;
  /** Ends a hub that belongs to this page alone, at once: a page in the browser's page cache receives no messages. */
  end?: () => void;
}

/** Opens a channel to the hub of the shared worker, or to a hub in this page if the browser has no shared workers. */
export function connect(): Link {
  if (typeof SharedWorker === 'function') {
    const worker = new SharedWorker(new URL('./feed.worker.ts', import.meta.url), { type: 'module', name: 'femc feed' });
    return { port: worker.port as unknown as HubPort };
  }
  const hub = new Hub();
  const { port1, port2 } = new MessageChannel();
  hub.connect(port2 as unknown as Port);
  return { port: port1 as unknown as HubPort, end: () => hub.end() };
}

export class Subscription {
  private state: FarmState = EMPTY;
  private link: Link | null = null;
  private heard = 0;
  private timer: ReturnType<typeof setInterval> | undefined;

  constructor(
    private readonly watcher: Watcher,
    private readonly open: () => Link = connect,
  ) {}

  /** Starts following the farm while the page is visible. */
  start() {
    addEventListener('pagehide', () => this.leave());
    addEventListener('pageshow', (event) => event.persisted && this.look());
    document.addEventListener('visibilitychange', () => this.look());
    this.look();
  }

  /** Reconnects at once if the connection is lost. */
  again() {
    this.send({ kind: 'again' });
  }

  /** Reconnects, because the user has signed in or out. */
  restart() {
    this.state = EMPTY;
    this.send({ kind: 'restart' });
  }

  private look() {
    if (document.visibilityState === 'hidden') {
      clearInterval(this.timer);
      this.timer = undefined;
      this.send({ kind: 'hidden' });
      this.link?.end?.();
      return;
    }
    if (!this.link) this.enter();
    this.heard = Date.now();
    this.send({ kind: 'visible', seq: this.state.seq });
    this.timer ??= setInterval(() => this.sign(), SIGN_MS);
  }

  private enter() {
    const link = this.open();
    link.port.onmessage = ({ data }) => this.link === link && this.on(data);
    this.link = link;
  }

  private leave() {
    clearInterval(this.timer);
    this.timer = undefined;
    this.send({ kind: 'gone' });
    this.link?.end?.();
    this.link?.port.close();
    this.link = null;
  }

  private sign() {
    if (Date.now() - this.heard > SILENT_HUB_MS) {
      this.leave();
      this.look();
    } else this.send({ kind: 'visible', seq: this.state.seq });
  }

  private send(message: PageMessage) {
    this.link?.port.postMessage(message);
  }

  private on(message: HubMessage) {
    this.heard = Date.now();
    switch (message.kind) {
      case 'alive':
        return;
      case 'connection':
        return this.watcher.connection(message.connection);
      case 'state':
        this.state = message.state;
        return this.watcher.farm(this.state, null);
      case 'delta':
        // This page does not have the state that the change is based on. The whole state is on its way.
        if (message.since !== this.state.seq) return;
        this.state = join(this.state, message.delta);
        return this.watcher.farm(this.state, message.delta);
    }
  }
}
