/** Recorded light of one data set, and what is selected in it. */

import { ApiError, explain } from '../api';
import { light, TABLES, type Among, type Corners, type Schema, type SelectionHeader, type Source } from './api';
import type { Columns } from './columns';
import {
  brightestSelection,
  haveSameRows,
  perTable,
  rowsOf,
  selectedRows,
  type BrightestSelection,
  type Histograms,
  type PerTable,
  type Rows,
} from './data';
import type { TableName } from './plot/contract';

/** Time after which a newer request aborts a running one. */
const ABORT_TIMEOUT_MS = 700;
const RETRY_INTERVAL_MS = 3000;

/** Requests of one kind: one at a time, and the newest wins. */
export class Newest {
  private running: AbortController | null = null;
  private began = -Infinity;
  private next: ((signal: AbortSignal) => Promise<void>) | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private stopped = false;

  constructor(
    /** Least time between two starts. */
    private readonly pauseMs: number,
    private readonly onerror: (error: unknown) => void,
    /** Time after which a newer request aborts the running one. `Infinity`: never. */
    private readonly abortTimeoutMs = ABORT_TIMEOUT_MS,
  ) {}

  run(task: (signal: AbortSignal) => Promise<void>) {
    this.next = task;
    if (this.running && performance.now() - this.began > this.abortTimeoutMs) this.running.abort();
    this.start();
  }

  private start() {
    if (this.stopped || this.running || this.timer !== undefined || !this.next) return;
    const wait = this.began + this.pauseMs - performance.now();
    if (wait > 0) {
      this.timer = setTimeout(() => {
        this.timer = undefined;
        this.start();
      }, wait);
      return;
    }
    const task = this.next;
    const abort = new AbortController();
    this.next = null;
    this.running = abort;
    this.began = performance.now();
    void task(abort.signal)
      .catch((error: unknown) => {
        if (!abort.signal.aborted) this.onerror(error);
      })
      .finally(() => {
        this.running = null;
        this.start();
      });
  }

  /** Drops the request that waits and cancels the running one. */
  clear() {
    this.next = null;
    clearTimeout(this.timer);
    this.timer = undefined;
    this.running?.abort();
  }

  stop() {
    this.stopped = true;
    this.clear();
  }
}

/** Representatives that the page shows, and the box of the bins; null: the box of the data. */
export interface Wish {
  count: number;
  among: Among;
  box: Corners | null;
}

export interface SelectionAnswer {
  where: string;
  header: SelectionHeader & { tag: string; recorded: number };
  density: Density | null;
}

/** SelectionAnswer recorded paths of each pixel that has some. */
export interface Density {
  pixel: Uint32Array;
  count: Float32Array;
  light: Float32Array;
}

export interface PairCounts {
  counts: Float32Array;
  /** The answer that contained them, with its categories. */
  of: Histograms;
}

const densityOf = (answer: Columns<SelectionHeader>): Density | null =>
  answer.has('density.pixel')
    ? {
        pixel: answer.u32('density.pixel'),
        count: answer.f32('density.count'),
        light: answer.f32('density.light'),
      }
    : null;

/**
 * A data set and its selection. Answers stay on the screen until newer ones arrive. Rows and masks change together: both belong to
 * the same state of the data.
 */
export class DataSet {
  schema = $state.raw<Schema | null>(null);
  /** `none`: no data yet. */
  status = $state.raw<'loading' | 'none' | 'ready'>('loading');
  error = $state.raw<{ text: string; message: string; help: string | null; status: number } | null>(null);
  histograms = $state.raw<Histograms | null>(null);
  pairs = $state.raw<ReadonlyMap<string, PairCounts>>(new Map());
  rows = $state.raw<Rows | null>(null);
  /** 1 for selected rows; null: there is no selection. */
  selected = $state.raw<PerTable<Uint8Array> | null>(null);
  /** Last selection among the brightest paths; null if other paths are shown. */
  brightest = $state.raw<BrightestSelection | null>(null);
  selection = $state.raw<SelectionAnswer | null>(null);
  selectedHistograms = $state.raw<Histograms | null>(null);
  /** Fault of the condition. */
  refusal = $state.raw<string | null>(null);
  /** Whether an evaluation of the selection is running or waiting. */
  isBusy = $state(false);
  /** Milliseconds of the last evaluation. */
  evaluated = $state<number | null>(null);

  /** Whether the plots can be shown, or never will be. */
  isSettled = $derived(this.error !== null || this.status === 'none' || (this.rows !== null && this.histograms !== null));

  private etag: string | null = null;
  /** Whether a request has failed since the last description. */
  private isStale = false;
  private wish: Wish | null = null;
  private where = '';
  private wanted: PerTable<[number, number][]> = perTable(() => []);
  private freshRows: Rows | null = null;
  private freshBrightest: BrightestSelection | null = null;
  private masks: (PerTable<Uint8Array> & { tag: string; where: string }) | null = null;
  private retry: ReturnType<typeof setTimeout> | undefined;

  private readonly fail = (error: unknown) => {
    const status = error instanceof ApiError ? error.status : 0;
    const { message, help } = error instanceof ApiError ? error : { message: explain(error), help: null };
    this.error = { text: explain(error), message, help, status };
    this.isStale = true;
    // The next refresh loads everything again.
    this.etag = null;
    if (isTransient(status)) {
      clearTimeout(this.retry);
      this.retry = setTimeout(() => {
        this.etag = null;
        this.refresh();
      }, RETRY_INTERVAL_MS);
    }
  };
  private readonly refuse = (error: unknown) => {
    this.isBusy = false;
    if (error instanceof ApiError && error.status === 400) this.refusal = explain(error).replace(/^where: /, '');
    else this.fail(error);
  };
  private readonly schemas = new Newest(1000, this.fail, Infinity);
  private readonly counts = new Newest(0, this.fail);
  private readonly representatives = new Newest(0, this.fail);
  private readonly selections = new Newest(60, this.refuse);
  private readonly selectedCounts = new Newest(120, this.refuse);

  constructor(readonly source: Source) {}

  /** Asks whether there are new data, at most once a second. */
  refresh() {
    this.schemas.run(async (signal) => {
      const answer = await light.schema(this.source, this.etag, signal);
      if (!answer) return;
      this.error = null;
      this.etag = answer.etag;
      if (!answer.schema) {
        this.status = 'none';
        return;
      }
      const isNew = answer.schema.tag !== this.schema?.tag || this.isStale;
      this.isStale = false;
      this.schema = answer.schema;
      this.status = 'ready';
      if (isNew) this.reload();
    });
  }

  /** Sets the representatives and the box. Nothing is requested before this is set. */
  configure(wish: Wish) {
    const before = this.wish;
    this.wish = wish;
    if (JSON.stringify(before) === JSON.stringify(wish)) return;
    if (JSON.stringify(before?.box) !== JSON.stringify(wish.box)) {
      this.loadCounts();
      this.loadSelectedCounts();
    }
    this.loadRows();
  }

  /**
   * Sets the condition; empty: no selection.
   * - `isFinal`: false while a brush is dragged.
   */
  select(where: string, isFinal: boolean) {
    const isSame = where === this.where;
    this.where = where;
    if (!isSame) {
      this.refusal = null;
      // Without a schema, the error is the reason why nothing is shown.
      if (this.schema) this.error = null;
      this.evaluate();
    }
    const among = this.wish?.among;
    const isDue = among === 'selection' ? isFinal : among === 'brightest';
    if (isDue && this.rowsWhere !== where) this.loadRows();
  }

  /** Requests joint counts that are not known yet. */
  needPairs(table: TableName, pairs: [number, number][]) {
    this.wanted[table] = pairs;
    if (pairs.some(([a, b]) => !this.pairs.has(`${table}:${a}-${b}`))) this.loadCounts();
  }

  stop() {
    clearTimeout(this.retry);
    for (const it of [this.schemas, this.counts, this.representatives, this.selections, this.selectedCounts]) it.stop();
  }

  private reload() {
    this.loadCounts();
    this.loadRows();
    this.evaluate();
  }

  private loadCounts() {
    if (!this.schema || !this.wish) return;
    this.counts.run(async (signal) => {
      const { box } = this.wish!;
      const pairs = TABLES.flatMap((table) => this.wanted[table].map(([a, b]) => `${table}:${a}-${b}`));
      const isCurrent = (key: string) =>
        this.pairs.get(key)?.of.header.tag === this.schema?.tag && JSON.stringify(box) === this.pairsBox;
      const missing = pairs.filter((key) => !isCurrent(key));
      const answer = await light.histograms(this.source, { where: '', box, pairs: missing }, signal);
      if (!answer) return;
      // An answer that only adds pairs changes nothing else.
      const isSame = this.countsBox === JSON.stringify(box) && this.histograms?.header.tag === answer.header.tag;
      if (!isSame) this.histograms = answer;
      this.countsBox = JSON.stringify(box);
      if (!missing.length) return;
      const kept = JSON.stringify(box) === this.pairsBox ? this.pairs : new Map<string, PairCounts>();
      this.pairsBox = JSON.stringify(box);
      const next = new Map(kept);
      for (const key of missing) next.set(key, { counts: answer.f32(key.replace(':', '.')), of: answer });
      this.pairs = next;
      // The order of axes may have changed meanwhile.
      const late = TABLES.some((table) => this.wanted[table].some(([a, b]) => !next.has(`${table}:${a}-${b}`)));
      if (late) this.loadCounts();
    });
  }
  private pairsBox = '';
  private countsBox = '';

  private loadRows() {
    const wish = this.wish;
    if (!this.schema || !wish) return;
    this.representatives.run(async (signal) => {
      const [where, wish] = [this.where, this.wish!];
      const answer = await light.paths(this.source, { where, ...wish }, signal).catch((error: unknown) => {
        // A faulty condition is reported by its evaluation.
        if (error instanceof ApiError && error.status === 400 && this.wish!.among !== 'all' && where) return null;
        throw error;
      });
      if (!answer) return;
      const rows = rowsOf(this.schema!, answer);
      const known = this.freshRows ?? this.rows;
      this.freshRows = known && haveSameRows(known, rows) ? known : rows;
      this.freshBrightest = wish.among === 'brightest' ? brightestSelection(answer, where) : null;
      this.rowsWhere = where;
      this.commit();
    });
  }
  private rowsWhere = '';

  private evaluate() {
    const where = this.where;
    if (!where) {
      this.selections.clear();
      this.selectedCounts.clear();
      this.isBusy = false;
      this.masks = null;
      this.selection = null;
      this.selectedHistograms = null;
      this.commit();
      return;
    }
    if (!this.schema) return;
    this.isBusy = true;
    this.selections.run(async (signal) => {
      const began = performance.now();
      const answer = await light.selection(this.source, where, true, signal);
      if (!answer || !this.where) return;
      this.evaluated = performance.now() - began;
      this.masks = { ...perTable((table) => answer.u8(`${table}.mask`)), tag: answer.header.tag, where };
      this.selection = { where, header: answer.header, density: densityOf(answer) };
      this.refusal = null;
      this.isBusy = where !== this.where;
      this.commit();
    });
    this.loadSelectedCounts();
  }

  private loadSelectedCounts() {
    if (!this.schema || !this.wish || !this.where) return;
    this.selectedCounts.run(async (signal) => {
      const { where } = this;
      if (!where) return;
      const answer = await light.histograms(this.source, { where, box: this.wish!.box, pairs: [] }, signal);
      if (answer && this.where) this.selectedHistograms = answer;
    });
  }

  /**
   * Shows new rows and new masks once both belong to the same state of the data. The brightest paths come with their selection: most of
   * them are not among the recorded paths of the masks.
   */
  private commit() {
    const rows = this.freshRows ?? this.rows;
    if (!rows) return;
    const brightest = this.freshRows ? this.freshBrightest : this.brightest;
    if (this.where && brightest) {
      this.rows = rows;
      this.selected = brightest.rows;
    } else if (!this.where || !this.masks) {
      this.rows = rows;
      this.selected = null;
    } else if (this.masks.tag === rows.tag) {
      this.rows = rows;
      this.selected = perTable((table) => selectedRows(rows.numbers[table], this.masks![table]));
    } else {
      // The data grew between the two answers.
      if (!this.rows) this.rows = rows;
      this.etag = null;
      this.refresh();
      return;
    }
    this.brightest = brightest;
    this.freshRows = null;
    this.freshBrightest = null;
  }
}

/** Checks whether a request may succeed later without a change of the data: no answer, a fault of the server, or too many requests. */
export const isTransient = (status: number): boolean => status === 0 || status === 429 || status >= 500;
