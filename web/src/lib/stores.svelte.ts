/** The pages' shared state: the farm, what is looked at, what is selected, and how this browser likes it. */

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

/** The store of views: which page, with which settings. The address bar has the same, letter by letter. */
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

  /** Goes to a page; the way back is kept. */
  go(route: Route, query: Record<string, string | number | null> = {}) {
    if (this.timer !== undefined) this.write();
    this.query = withValues({}, query);
    this.route = route;
    history.pushState(null, '', pathOf(route) + formatAddress(this.query));
    scrollTo(0, 0);
  }

  /** The same job in another view; what is selected stays selected. */
  tab(tab: JobTab, values: Record<string, string | number | null> = {}) {
    if (this.route.page !== 'job') return;
    const kept = Object.fromEntries(Object.entries(this.query).filter(([key]) => SELECTION_KEYS.has(key)));
    this.go({ ...this.route, tab }, { ...kept, ...values });
  }

  /**
   * Changes settings of this page. The address follows a moment later: browsers take 200 changes of it in ten
   * seconds.
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

const SELECTION_KEYS = new Set(['jobs', 'frames', 'frame', 'task', 'pixel', 'lasso']);

export const views = new Views();

/** The one selection, shared by all views; kept in the address. */
class Selection {
  jobs = $derived(new Set(parseNumbers(views.query.jobs)));
  frames = $derived(new Set(parseNumbers(views.query.frames)));
  /** The frame that is looked at. */
  frame = $derived(/^\d+$/.test(views.query.frame ?? '') ? Number(views.query.frame) : null);
  task = $derived(views.query.task ?? null);
  pixel = $derived.by(() => {
    const match = /^(\d+),(\d+)$/.exec(views.query.pixel ?? '');
    return match ? { x: Number(match[1]), y: Number(match[2]) } : null;
  });

  /** A closed line around pixels; empty where there is none. */
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

/** The farm, live. */
class Farm {
  state = $state.raw<FarmState>(EMPTY);
  connection = $state.raw<Connection>({ state: 'connecting' });
  me = $state.raw<Me | null>(null);
  /** Whether a snapshot has come. */
  known = $derived(this.state.seq !== null);
  private readonly feed = new Subscription({
    farm: (state) => (this.state = state),
    connection: (connection) => {
      const before = this.connection.state;
      this.connection = connection;
      if (connection.state === 'denied') this.denied();
      // After a restart the coordinator may be another version, and ask other things.
      else if (connection.state === 'live' && before !== 'live') void this.identify();
    },
  });

  /** Asks who we are, and follows the feed. */
  start() {
    this.feed.start();
  }

  /** Connects anew after the user has signed in or out. */
  restart() {
    this.connection = { state: 'connecting' };
    this.state = EMPTY;
    this.feed.restart();
  }

  /** Connects again at once, where the connection is lost. */
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

/** How this browser likes it. */
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

/** Why the user may not do this, or null. */
export const may = (right: Right): string | null => refusal(farm.me, preferences.readOnly, right);

export interface Notice {
  id: number;
  kind: 'good' | 'bad';
  text: string;
}

/** Short messages about what the user did. */
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
  /** Runs what the user asked for, and tells of its failure. */
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

/** What is asked of the coordinator again and again; the latest answer stays until the next one. */
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

  /** Asks, at most once in the pause; a request while another is out is made after it. */
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

  /** Forgets the answer and what is under way. */
  stop() {
    this.abort?.abort();
    this.running = false;
    this.again = false;
  }
}
