/** State shared by the pages: the farm, the current view, the selection, and the browser's preferences. */

import { api, ApiError, explain } from './api';
import { EMPTY, type Connection, type FarmState } from './feed';
import { formatLasso, parseLasso, simplify, type Point } from './lasso';
import { refusal, type Right } from './rights';
import {
  formatAddress,
  formatNumbers,
  parseAddress,
  parseNumbers,
  parsePath,
  pathOf,
  withValues,
  type JobTab,
  type Query,
  type Route,
} from './route';
import { Subscription } from './subscription';
import type { Me } from './types';

/** Current view: the page and its settings. The address bar always shows the same. */
class Views {
  route = $state.raw<Route>({ page: 'jobs' });
  query = $state.raw<Query>({});
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor() {
    this.read();
    addEventListener('popstate', () => this.read());
    addEventListener('pagehide', () => this.timer !== undefined && this.write());
  }

  private read() {
    clearTimeout(this.timer);
    this.timer = undefined;
    this.route = parsePath(location.pathname);
    this.query = parseAddress(location);
  }

  /** Goes to a page and keeps the way back. */
  go(route: Route, query: Record<string, string | number | null> = {}) {
    if (this.timer !== undefined) this.write();
    this.query = withValues({}, query);
    this.route = route;
    history.pushState(null, '', pathOf(route) + formatAddress(this.query));
    scrollTo(0, 0);
  }

  /** Switches to another tab of the same job and keeps the selection. */
  tab(tab: JobTab, values: Record<string, string | number | null> = {}) {
    if (this.route.page !== 'job') return;
    const kept = Object.fromEntries(Object.entries(this.query).filter(([key]) => SELECTION_KEYS.has(key)));
    this.go({ ...this.route, tab }, { ...kept, ...values });
  }

  /**
   * Changes settings of this page. The address bar follows a moment later, because browsers limit its changes to 200
   * in ten seconds.
   */
  set(values: Record<string, string | number | null | undefined>) {
    this.query = withValues(this.query, values);
    this.timer ??= setTimeout(() => this.write(), 80);
  }

  private write() {
    clearTimeout(this.timer);
    this.timer = undefined;
    history.replaceState(null, '', pathOf(this.route) + formatAddress(this.query));
  }
}

const SELECTION_KEYS = new Set(['jobs', 'frames', 'frame', 'task', 'pixel', 'lasso', 'where']);

export const views = new Views();

/** Selection shared by all views; kept in the URL. */
class Selection {
  jobs = $derived(new Set(parseNumbers(views.query.jobs)));
  frames = $derived(new Set(parseNumbers(views.query.frames)));
  /** Current frame. */
  frame = $derived(/^\d+$/.test(views.query.frame ?? '') ? Number(views.query.frame) : null);
  task = $derived(views.query.task ?? null);
  pixel = $derived.by(() => {
    const match = /^(\d+),(\d+)$/.exec(views.query.pixel ?? '');
    return match ? { x: Number(match[1]), y: Number(match[2]) } : null;
  });

  /** Closed line around pixels; empty if there is none. */
  lasso = $derived(parseLasso(views.query.lasso));

  setJobs(jobs: Iterable<number>) {
    views.set({ jobs: formatNumbers(jobs) });
  }
  setFrames(frames: Iterable<number>) {
    views.set({ frames: formatNumbers(frames) });
  }
  setFrame(frame: number | null) {
    views.set({ frame });
  }
  setTask(task: string | null) {
    views.set({ task });
  }
  setPixel(pixel: { x: number; y: number } | null) {
    views.set({ pixel: pixel && `${pixel.x},${pixel.y}` });
  }
  setLasso(points: readonly Point[]) {
    views.set({ lasso: points.length >= 3 ? formatLasso(simplify(points)) : null });
  }
}

export const selection = new Selection();

/** Live state of the farm. */
class Farm {
  state = $state.raw<FarmState>(EMPTY);
  connection = $state.raw<Connection>({ state: 'connecting' });
  me = $state.raw<Me | null>(null);
  /** Whether a snapshot has arrived. */
  known = $derived(this.state.seq !== null);
  private readonly feed = new Subscription({
    farm: (state) => (this.state = state),
    connection: (connection) => {
      const before = this.connection.state;
      this.connection = connection;
      if (connection.state === 'denied') this.denied();
      // After a restart, the coordinator may have another version and other login rules.
      else if (connection.state === 'live' && before !== 'live') void this.identify();
    },
  });

  /** Starts following the feed. The user's identity is requested when the feed is live. */
  start() {
    this.feed.start();
  }

  /** Reconnects after the user has signed in or out. */
  restart() {
    this.connection = { state: 'connecting' };
    this.state = EMPTY;
    this.feed.restart();
  }

  /** Reconnects at once if the connection is lost. */
  again() {
    this.feed.again();
  }

  private denied() {
    this.me = null;
    this.state = EMPTY;
    if (views.route.page !== 'login') {
      const from = location.pathname + location.search + location.hash;
      views.go({ page: 'login' }, { from: from === '/' ? null : from });
    }
  }

  private async identify() {
    try {
      this.me = await api.me();
    } catch (error) {
      if (error instanceof ApiError && error.status === 401) this.denied();
      else if (this.connection.state === 'live') setTimeout(() => void this.identify(), 2000);
    }
  }
}

export const farm = new Farm();

/** Preferences of this browser. */
class Preferences {
  theme = $state<'auto' | 'light' | 'dark'>('auto');
  readOnly = $state(false);
  /** Whether the page is dark now. */
  isDark = $state(false);
  private readonly dark = matchMedia('(prefers-color-scheme: dark)');

  constructor() {
    const theme = localStorage.getItem('femc.theme');
    if (theme === 'light' || theme === 'dark') this.theme = theme;
    this.readOnly = localStorage.getItem('femc.read-only') === 'yes';
    this.dark.addEventListener('change', () => this.apply());
    this.apply();
  }

  setTheme(theme: 'auto' | 'light' | 'dark') {
    this.theme = theme;
    localStorage.setItem('femc.theme', theme);
    this.apply();
  }

  setReadOnly(readOnly: boolean) {
    this.readOnly = readOnly;
    localStorage.setItem('femc.read-only', readOnly ? 'yes' : 'no');
  }

  private apply() {
    this.isDark = this.theme === 'auto' ? this.dark.matches : this.theme === 'dark';
    document.documentElement.dataset.theme = this.isDark ? 'dark' : 'light';
  }
}

export const preferences = new Preferences();

/** Returns the reason why the user may not do this, or null. */
export const may = (right: Right): string | null => refusal(farm.me, preferences.readOnly, right);

export interface Notice {
  id: number;
  kind: 'good' | 'bad';
  text: string;
}

/** Short messages about the user's actions. */
class Notices {
  list = $state.raw<readonly Notice[]>([]);
  private next = 0;

  add(kind: Notice['kind'], text: string) {
    const id = this.next++;
    this.list = [...this.list, { id, kind, text }].slice(-4);
    setTimeout(() => this.drop(id), kind === 'good' ? 4000 : 12000);
  }
  drop(id: number) {
    this.list = this.list.filter((notice) => notice.id !== id);
  }
  /** Runs a user's action and reports its failure. */
  async attempt<T>(what: () => Promise<T>): Promise<T | null> {
    try {
      return await what();
    } catch (error) {
      this.add('bad', explain(error));
      return null;
    }
  }
}

export const notices = new Notices();

/** A repeated request to the coordinator. The latest answer stays until the next one. */
export class Resource<T> {
  value = $state.raw<T | null>(null);
  error = $state.raw<string | null>(null);
  private running = false;
  private again = false;
  private abort: AbortController | null = null;

  constructor(
    private readonly ask: (signal: AbortSignal) => Promise<T | undefined>,
    private readonly pauseMs = 1000,
  ) {}

  /** Sends the request, at most once per pause. If another one is running, it is sent after that one. */
  refresh() {
    if (this.running) {
      this.again = true;
      return;
    }
    this.running = true;
    this.abort = new AbortController();
    const { signal } = this.abort;
    void this.ask(signal)
      .then((value) => {
        if (signal.aborted) return;
        if (value !== undefined) this.value = value;
        this.error = null;
      })
      .catch((error: unknown) => {
        if (!signal.aborted) this.error = explain(error);
      })
      .finally(() => {
        if (signal.aborted) return;
        setTimeout(() => {
          if (signal.aborted) return;
          this.running = false;
          if (this.again) {
            this.again = false;
            this.refresh();
          }
        }, this.pauseMs);
      });
  }

  /** Drops the answer and cancels the running request. */
  stop() {
    this.abort?.abort();
    this.running = false;
    this.again = false;
  }
}
