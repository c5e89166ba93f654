/** Requests for the recorded light of frames or files. */

import { ApiError, failure } from '../api';
import { formatNumbers, parseNumbers } from '../route';
import { decodeColumns, type Columns } from './columns';
import { GrowingAnswers, withKeptRows, type GrowingHeader } from './delta';
import type { ScaleName, TableName } from './plot/contract';

export { NONE } from './columns';
export const TABLES: readonly TableName[] = ['paths', 'intersections', 'lights'];
/** Largest number of frames that the coordinator unites. */
export const MOST_FRAMES = 64;
/** Number of fine bins of an axis. */
export const BINS = 64;

/** A data set: the recorded light of frames of a job, or of a file. */
export type Source = { job: number; frames: readonly number[] } | { file: number };

export type Corners = readonly [readonly [number, number, number], readonly [number, number, number]];

export interface SchemaAxis {
  name: string;
  scale: ScaleName;
  /** Name in conditions. */
  field: string;
  /** Words of a class axis. */
  words?: string[];
}

export interface Schema {
  /** Identifies the data: answers with equal tags agree. */
  tag: string;
  version: number;
  growing: boolean;
  frames: number[];
  film: [number, number];
  box: Corners;
  /** Number of all samples. */
  samples: number;
  bad_samples: number;
  /** Share of the samples that are recorded. */
  share: number;
  recorded: number;
  full_histograms: boolean;
  counts: Record<TableName, number>;
  tables: Record<TableName, SchemaAxis[]>;
  names: string[];
  kinds: string[];
  words: Record<string, string[]>;
  radiance_edges: number[];
  throughput_edges: number[];
}

export type Among = 'all' | 'selection' | 'brightest';

export interface PathsHeader extends GrowingHeader {
  /** Number of selected paths, with `among=brightest` and a condition. */
  selected?: number;
  set: number;
  candidates: number;
  d: number | null;
  dj: number | null;
  effective_size: number | null;
}

export interface HistogramsHeader {
  counted: 'recorded' | 'all samples';
  /** Name indices of each name axis, by falling share. */
  categories: Record<string, number[]>;
}

export interface SelectionHeader {
  /** The condition in canonical form. */
  text: string;
  counts: Record<TableName, number>;
  totals: Record<TableName, number>;
  light_share: number | null;
  samples: number;
  /** Reason why there is no density. */
  density_fault?: string | null;
}

export interface VoxelsHeader {
  cube: Corners;
  level: number;
}

/** An estimate from recorded paths; `standard_error` is null if too few paths tell it. */
export interface Estimate {
  value: number;
  standard_error: number | null;
}

/** Light of some records. */
export interface LightAmount {
  /** Number of recorded paths that have such records. */
  paths: number;
  /** Part of the mean luminance of the picture, cd/m². */
  light: Estimate;
  /** Number of lights for lamps, otherwise of intersections. */
  records: number;
  /** Mean number of these records of a recorded path. */
  per_path: Estimate;
  /** Mean energy of the intersections, cd/m²; null: there are none. */
  energy: Estimate | null;
}

export interface SummaryRow extends LightAmount {
  name: string;
  /** Condition that selects the records of the row; null: there is none. */
  where: string | null;
}

export type SummaryGroup = 'object' | 'bounce' | 'lamp';
export const GROUPS: readonly SummaryGroup[] = ['object', 'bounce', 'lamp'];

/** Light of the selected records in numbers. */
export interface Summary {
  tag: string;
  text: string | null;
  samples: number;
  recorded: number;
  share: number;
  total: LightAmount;
  groups: Record<SummaryGroup, SummaryRow[]>;
  /** Number of rows that the answer leaves out. */
  left_out: Record<SummaryGroup, number>;
}

/** Errors of picture A against picture B. */
export interface PictureComparison {
  /** `luminance`: files without images are compared by the mean luminance of their samples. */
  compared: 'color' | 'luminance';
  films: [[number, number], [number, number]];
  /** Reason why there are no errors. */
  fault: string | null;
  mean?: [number, number];
  mean_ratio?: number;
  mse?: number;
  relmse?: number;
  /** Null for equal pictures. */
  psnr?: number | null;
  ssim?: number;
  flip?: number;
  worst_pixel?: { x: number; y: number };
  excluded?: { a: number; b: number; pixels: number };
}

export interface ServedFile {
  file: number;
  name: string;
  bytes: number;
}

/** Checks whether a job records light (`--stats`). */
export const recordsStatistics = (spec: { settings: string }): boolean => /"statistics"\s*:\s*true/.test(spec.settings);

/** Version of the attributes that this page knows. */
export const SCHEMA_VERSION = 1;

/** Formats a data set for the address: frames of a job as `7/1..3`, a file as `0`. */
export const formatSource = (source: Source): string =>
  'file' in source ? String(source.file) : `${source.job}/${formatNumbers(source.frames)}`;

/** Parses a data set from the address; null if there is none. */
export function parseSource(text: string | undefined): Source | null {
  const file = /^(\d{1,6})$/.exec(text ?? '');
  if (file) return { file: Number(file[1]) };
  const job = /^(\d{1,15})\/(.+)$/.exec(text ?? '');
  const frames = parseNumbers(job?.[2]).slice(0, MOST_FRAMES);
  return job && frames.length ? { job: Number(job[1]), frames } : null;
}

type Values = Record<string, string | number | null | undefined>;

function address(source: Source, call: string, values: Values): string {
  const of = 'file' in source ? `files/${source.file}` : `jobs/${source.job}`;
  const query = new URLSearchParams();
  if ('frames' in source) query.set('frames', formatNumbers(source.frames));
  for (const [key, value] of Object.entries(values)) if (value != null && value !== '') query.set(key, String(value));
  const text = query.toString();
  return `/api/v1/${of}/light/${call}${text ? `?${text}` : ''}`;
}

async function ask(path: string, init: RequestInit): Promise<Response> {
  const answer = await fetch(path, { credentials: 'same-origin', ...init }).catch((error: unknown) => {
    if (init.signal?.aborted) throw error;
    throw new ApiError(0, 'unreachable', 'the server does not answer', 'the page retries automatically');
  });
  if (!answer.ok && answer.status !== 304) throw await failure(answer);
  return answer;
}

/** Answers with an unchanged ETag come from the browser's cache. */
async function columns<H>(source: Source, call: string, values: Values, signal?: AbortSignal): Promise<Columns<H> | null> {
  const answer = await ask(address(source, call, values), { signal: signal ?? null, cache: 'no-cache' });
  return answer.status === 204 ? null : decodeColumns<H>(await answer.arrayBuffer());
}

/** Latest rows of growing data. */
const growing = new GrowingAnswers<PathsHeader>();

export const formatBox = (box: Corners | null): string | null => box && box.flat().join(',');

export interface SchemaAnswer {
  /** Null until there are data. */
  schema: Schema | null;
  etag: string | null;
}

/** Surfaces of a frame, or its finite-element solution. */
export type Model = 'geometry' | 'solution' | 'targets';

export const light = {
  async files(signal?: AbortSignal): Promise<ServedFile[]> {
    const answer = await ask('/api/v1/files', { signal: signal ?? null, cache: 'no-cache' });
    return ((await answer.json()) as { files: ServedFile[] }).files;
  },

  /** Returns the description of a data set; `undefined` if `etag` still matches. */
  async schema(source: Source, etag: string | null, signal?: AbortSignal): Promise<SchemaAnswer | undefined> {
    const headers: Record<string, string> = etag ? { 'If-None-Match': etag } : {};
    const answer = await ask(address(source, 'schema', {}), { signal: signal ?? null, cache: 'no-store', headers });
    if (answer.status === 304) return undefined;
    if (answer.status === 204) return { schema: null, etag: null };
    const schema = (await answer.json()) as Schema;
    if (schema.version !== SCHEMA_VERSION) {
      const text = `the recorded light has version ${schema.version} of its attributes, this page reads version ${SCHEMA_VERSION}`;
      throw new ApiError(0, 'version', text, 'reload the page, or update femc');
    }
    return { schema, etag: answer.headers.get('ETag') };
  },

  /**
   * Returns representative paths with their intersections and lights. The brightest paths are not filtered by a condition: the answer has
   * columns of what the condition selects. While data grow, only the new rows are requested.
   */
  async paths(
    source: Source,
    { where, box, count, among }: { where: string; box: Corners | null; count: number; among: Among },
    signal?: AbortSignal,
  ): Promise<Columns<PathsHeader> | null> {
    const earlier = growing.get(formatSource(source));
    const path = address(source, 'paths', {
      count,
      among: among === 'brightest' ? 'brightest' : null,
      where: among === 'all' ? null : where,
      box: formatBox(box),
      since: earlier?.tag,
    });
    // The browser's cache cannot unite answers. It keeps those about finished data.
    const init: RequestInit = earlier
      ? { cache: 'no-store', headers: { 'If-None-Match': `"${earlier.tag}"` } }
      : { cache: 'no-cache' };
    const answer = await ask(path, { ...init, signal: signal ?? null });
    if (answer.status === 204) return null;
    if (answer.status === 304 && earlier) return earlier.columns;
    const tag = answer.headers.get('ETag')?.replace(/^W\/|"/g, '');
    const received = decodeColumns<PathsHeader>(await answer.arrayBuffer());
    // If the rows do not fit together, the next answer is a full one.
    growing.set(formatSource(source), null);
    const columns = withKeptRows(earlier, received);
    if (columns.header.growing && tag) growing.set(formatSource(source), { tag, columns });
    return columns;
  },

  /** Returns the counts of all axes, and the joint counts of pairs of axes (`paths:0-3`). */
  histograms: (
    source: Source,
    { where, box, pairs }: { where: string; box: Corners | null; pairs: readonly string[] },
    signal?: AbortSignal,
  ) => columns<HistogramsHeader>(source, 'histograms', { where, box: formatBox(box), pairs: pairs.join(',') }, signal),

  /** Returns the mean energy of voxels that have selected intersections; of one bounce, or of all (null). */
  voxels: (
    source: Source,
    { where, box, level, bounce }: { where: string; box: Corners | null; level: number; bounce: number | null },
    signal?: AbortSignal,
  ) => columns<VoxelsHeader>(source, 'voxels', { where, box: formatBox(box), level, bounce }, signal),

  /** Returns the light of the selected records in numbers; null: there are no data yet. */
  async summary(source: Source, where: string, signal?: AbortSignal): Promise<Summary | null> {
    const answer = await ask(address(source, 'summary', { where }), { signal: signal ?? null, cache: 'no-cache' });
    return answer.status === 204 ? null : ((await answer.json()) as Summary);
  },

  /** Compares the pictures of the first frames of two data sets; null: one of them is not finished. */
  async compare(a: Source, b: Source, signal?: AbortSignal): Promise<PictureComparison | null> {
    const key = (it: Source) => ('file' in it ? String(it.file) : `${it.job}/${it.frames[0]}`);
    const query = new URLSearchParams({ a: key(a), b: key(b) });
    const answer = await ask(`/api/v1/compare?${query}`, { signal: signal ?? null, cache: 'no-cache' });
    return answer.status === 204 ? null : ((await answer.json()) as PictureComparison);
  },

  /** Returns a model of the scene as binary glTF, or targets as JSON; `null`: not made yet, `undefined`: there is none. */
  async model(source: Source, model: Model, signal?: AbortSignal): Promise<ArrayBuffer | null | undefined> {
    const path = 'file' in source ? `files/${source.file}/${model}` : `jobs/${source.job}/${model}?frame=${source.frames[0]}`;
    const answer = await fetch(`/api/v1/${path}`, { credentials: 'same-origin', signal: signal ?? null, cache: 'no-cache' });
    if (answer.status === 404) return undefined;
    if (!answer.ok) throw await failure(answer);
    return answer.status === 204 ? null : answer.arrayBuffer();
  },

  /** Evaluates a condition over all recorded paths. */
  selection: (source: Source, where: string, density: boolean, signal?: AbortSignal) =>
    columns<SelectionHeader>(source, 'selection', { where, density: density ? 1 : null }, signal),
};
