/** Recorded light as the plots show it: axes, values, bins, and what is selected. */

import { BINS, NONE, TABLES, type Corners, type Schema, type SchemaAxis } from './api';
import { hasBit, type Columns } from './columns';
import type { Axis, AxisView, Brush, TableName } from './plot/contract';
import {
  brushChip,
  formatRanges,
  formatWords,
  hasCategory,
  rangesOf,
  toChips,
  withAlso,
  withChip,
  type BrushChip,
  type Chip,
  type ChipPath,
  type Chips,
  type Quantifier,
} from './text';

export type PerTable<T> = Record<TableName, T>;

export const perTable = <T>(make: (table: TableName) => T): PerTable<T> => ({
  paths: make('paths'),
  intersections: make('intersections'),
  lights: make('lights'),
});

/** Bins of names in histograms that have names of their own: all but "none" and "others". */
const MOST_NAMES = BINS - 2;

/** Categories of a name axis. With two data sets, both have the categories of the first, and then their own. */
export interface Categories {
  /** Names, in the order shown, without "none". */
  names: string[];
  /** Whether there is a last category for all other names. */
  hasOthers: boolean;
}

/** Answer of the server with counts: single axes, pairs and the names of categories. */
export type Histograms = Columns<{ counted: string; categories: Record<string, number[]> }>;

export interface SchemaAndHistograms {
  schema: Schema;
  histograms: Histograms;
}

/** Returns the categories of all name axes, by `table.axis`. */
export function categoriesOf(sets: readonly SchemaAndHistograms[]): Map<string, Categories> {
  const out = new Map<string, Categories>();
  const first = sets[0];
  if (!first) return out;
  for (const table of TABLES) {
    first.schema.tables[table].forEach((axis, index) => {
      if (axis.scale !== 'name') return;
      const key = `${table}.${axis.name}`;
      const all = sets.flatMap(({ schema, histograms }) =>
        (histograms.header.categories[key] ?? []).map((name) => schema.names[name] ?? `name ${name}`),
      );
      const names = [...new Set(all)].slice(0, MOST_NAMES);
      const rest = new Set(all).size > names.length;
      const hasOthers = rest || sets.some(({ histograms }) => histograms.f64(`${table}.${index}`)[BINS - 1]! > 0);
      out.set(key, { names, hasOthers });
    });
  }
  return out;
}

/** Number of the category for all other names; 0 if there is none. */
const othersOf = ({ names, hasOthers }: Categories) => (hasOthers ? names.length + 1 : 0);

/** Axes of a table, as the plot shows them. */
export function axesOf(schema: Schema, table: TableName, categories: ReadonlyMap<string, Categories>, box: Corners): Axis[] {
  return schema.tables[table].map((axis, index) => ({
    index,
    name: axis.name,
    scale: axis.scale,
    edges:
      axis.scale === 'radiance' ? schema.radiance_edges : axis.scale === 'throughput' ? schema.throughput_edges : null,
    extent: extentOf(axis, schema, box),
    categories: textsOf(axis, categories.get(`${table}.${axis.name}`)),
  }));
}

function extentOf(axis: SchemaAxis, schema: Schema, box: Corners): [number, number] | null {
  const place = 'xyz'.indexOf(axis.name.at(-1)!);
  if (axis.scale === 'film') return [0, schema.film[place]!];
  return axis.scale === 'world' ? [box[0][place]!, box[1][place]!] : null;
}

function textsOf(axis: SchemaAxis, categories: Categories | undefined): string[] | null {
  if (axis.scale === 'class') return ['none', ...(axis.words ?? [])];
  if (axis.scale !== 'name') return null;
  return ['none', ...(categories?.names ?? []), ...(categories?.hasOthers ? ['others'] : [])];
}

/** Returns the category of each name of a data set, by value of the axis (0: none). */
function categoryTable(schema: Schema, categories: Categories): Float32Array {
  const numbers = new Map(categories.names.map((name, i) => [name, i + 1]));
  const others = othersOf(categories);
  return Float32Array.from([0, ...schema.names.map((name) => numbers.get(name) ?? others)]);
}

/** Returns the bin shown for each bin of a name axis. */
export function binTable({ schema, histograms }: SchemaAndHistograms, key: string, categories: Categories): Uint8Array {
  const numbers = new Map(categories.names.map((name, i) => [name, i + 1]));
  const others = othersOf(categories);
  const table = new Uint8Array(BINS).fill(others);
  table[0] = 0;
  (histograms.header.categories[key] ?? []).forEach((name, k) => {
    if (k < MOST_NAMES) table[k + 1] = numbers.get(schema.names[name] ?? `name ${name}`) ?? others;
  });
  return table;
}

/** Rows of the representative records. */
export interface Rows {
  tag: string;
  /** Columns by table and axis; name axes have the values of the data set. */
  values: PerTable<Float32Array[]>;
  /** Numbers of the records: bits in masks. */
  numbers: PerTable<Uint32Array>;
  links: Links;
  frame: Uint32Array;
  sample: Uint32Array;
  set: number;
  candidates: number;
  d: number | null;
  dj: number | null;
  effectiveSize: number | null;
}

/** Row numbers by which records refer to each other. */
export interface Links {
  intersectionPath: Uint32Array;
  /** Intersection before; `NONE`: the camera. */
  intersectionParent: Uint32Array;
  lightPath: Uint32Array;
  /** Intersection of the light. */
  lightIntersection: Uint32Array;
}

/** Selected records among the brightest paths. */
export interface BrightestSelection {
  where: string;
  /** 1 for selected rows. */
  rows: PerTable<Uint8Array>;
  /** Number of selected paths. */
  count: number;
}

type PathsAnswer = Columns<{
  selected?: number;
  set: number;
  candidates: number;
  d: number | null;
  dj: number | null;
  effective_size: number | null;
}>;

export function rowsOf(schema: Schema, answer: PathsAnswer): Rows {
  const { tag, set, candidates, d, dj, effective_size } = answer.header;
  return {
    tag,
    values: perTable((table) => schema.tables[table].map((axis) => answer.f32(`${table}.${axis.name}`))),
    numbers: perTable((table) => answer.u32(`${table}.number`)),
    links: {
      intersectionPath: answer.u32('intersections.path'),
      intersectionParent: answer.u32('intersections.parent'),
      lightPath: answer.u32('lights.path'),
      lightIntersection: answer.u32('lights.intersection'),
    },
    frame: answer.u32('paths.frame'),
    sample: answer.u32('paths.sample'),
    set,
    candidates,
    d: d ?? null,
    dj: dj ?? null,
    effectiveSize: effective_size ?? null,
  };
}

/** Returns the selection among the brightest paths; null if the answer has none. */
export function brightestSelection(answer: PathsAnswer, where: string): BrightestSelection | null {
  if (!TABLES.every((table) => answer.has(`${table}.selected`))) return null;
  const rows = perTable((table) => answer.u8(`${table}.selected`));
  return { where, rows, count: answer.header.selected ?? rows.paths.reduce((sum, is) => sum + is, 0) };
}

const isEqual = (a: Float32Array | Uint32Array, b: Float32Array | Uint32Array) =>
  a.length === b.length && a.every((value, i) => Object.is(value, b[i]));

/** Checks whether two answers have the same rows, so that plots need not change. Intersections and lights follow from the paths. */
export const haveSameRows = (a: Rows, b: Rows): boolean =>
  a.tag === b.tag &&
  a.set === b.set &&
  isEqual(a.frame, b.frame) &&
  isEqual(a.sample, b.sample) &&
  TABLES.every((table) => isEqual(a.numbers[table], b.numbers[table])) &&
  a.values.paths.every((values, i) => isEqual(values, b.values.paths[i]!));

/** Returns the rows' values for the plot: names become categories. */
export function plotValues(
  schema: Schema,
  table: TableName,
  rows: Rows,
  categories: ReadonlyMap<string, Categories>,
): Float32Array[] {
  return schema.tables[table].map((axis, index) => {
    const values = rows.values[table][index]!;
    const known = axis.scale === 'name' ? categories.get(`${table}.${axis.name}`) : undefined;
    if (!known) return values;
    const table_ = categoryTable(schema, known);
    return values.map((value) => table_[value] ?? 0);
  });
}

/** Returns counts for the plot: the bins of names become categories. */
export function plotBins(set: SchemaAndHistograms, of: Histograms, table: TableName, categories: ReadonlyMap<string, Categories>): Float64Array[] {
  return set.schema.tables[table].map((axis, index) => {
    const bins = of.f64(`${table}.${index}`);
    const key = `${table}.${axis.name}`;
    const known = axis.scale === 'name' ? categories.get(key) : undefined;
    if (!known) return bins;
    const target = binTable({ schema: set.schema, histograms: of }, key, known);
    const out = new Float64Array(BINS);
    bins.forEach((count, bin) => (out[target[bin]!]! += count));
    return out;
  });
}

/** Returns the number of records in the bins of an axis. */
export const countIn = (bins: ArrayLike<number> | undefined): number | undefined =>
  bins && Array.from(bins).reduce((sum, count) => sum + count, 0);

/** Returns joint counts for the plot. */
export function plotPair(
  set: SchemaAndHistograms,
  counts: Float32Array,
  table: TableName,
  [a, b]: readonly [number, number],
  categories: ReadonlyMap<string, Categories>,
): Float32Array {
  const tableOf = (index: number) => {
    const axis = set.schema.tables[table][index]!;
    const key = `${table}.${axis.name}`;
    const known = axis.scale === 'name' ? categories.get(key) : undefined;
    return known ? binTable(set, key, known) : null;
  };
  const [rows, columns] = [tableOf(a), tableOf(b)];
  if (!rows && !columns) return counts;
  const out = new Float32Array(BINS * BINS);
  for (let i = 0; i < counts.length; i++) {
    if (counts[i] === 0) continue;
    const [r, c] = [i >>> 6, i & 63];
    out[((rows ? rows[r]! : r) << 6) | (columns ? columns[c]! : c)]! += counts[i]!;
  }
  return out;
}

/** Returns 1 for each record whose number is set in the mask. */
export function selectedRows(numbers: Uint32Array, mask: Uint8Array): Uint8Array {
  const out = new Uint8Array(numbers.length);
  for (let i = 0; i < out.length; i++) out[i] = numbers[i] !== NONE && hasBit(mask, numbers[i]!) ? 1 : 0;
  return out;
}

/** Returns the smallest box that contains both. */
export const unite = (a: Corners, b: Corners): Corners => {
  const each = (f: (x: number, y: number) => number, i: 0 | 1) =>
    a[i].map((v, axis) => f(v, b[i][axis]!)) as unknown as [number, number, number];
  return [each(Math.min, 0), each(Math.max, 1)];
};

/** Returns the reason why two data sets cannot be shown together, or null. */
export function mismatch(a: Schema, b: Schema): string | null {
  for (const table of TABLES) {
    const names = (schema: Schema) => schema.tables[table].map((axis) => `${axis.name} (${axis.scale})`);
    const [x, y] = [names(a), names(b)];
    const odd = x.find((name) => !y.includes(name)) ?? y.find((name) => !x.includes(name));
    if (odd || x.length !== y.length) return `their ${table} have different attributes: ${odd ?? `${x.length} and ${y.length}`}`;
    const [u, v] = [a, b].map((it) => JSON.stringify(it.tables[table].map((axis) => axis.words ?? null)));
    if (u !== v) return `their ${table} have different words`;
  }
  return null;
}

// ---- Brushes of plots, in the text of the selection

const WRAPPERS: PerTable<readonly (Quantifier | null)[]> = {
  paths: [null],
  intersections: ['any', 'all'],
  lights: ['light', 'lights'],
};

interface BrushPosition {
  path: ChipPath;
  chip: BrushChip;
  /** Whether `not` stands before the group around it. */
  outside: boolean;
}

/** Returns the brush chips that concern the axes of a table, by field; the first of each field. */
function brushChips(chips: Chips, table: TableName, fields: ReadonlySet<string>): Map<string, BrushPosition> {
  const out = new Map<string, BrushPosition>();
  const walk = (all: Chips, at: ChipPath, isWithin: boolean, outside: boolean) =>
    all.chips.forEach((chip, i) => {
      const path = [...at, i];
      if (chip.kind === 'brush') {
        if (isWithin && fields.has(chip.field) && !out.has(chip.field)) out.set(chip.field, { path, chip, outside });
      } else if (chip.kind === 'group') {
        const [word] = [chip.word];
        const isRight = word === null ? isWithin : WRAPPERS[table].includes(word);
        if (isRight) walk(chip.inner, path, true, outside !== chip.negated);
      }
    });
  walk(chips, [], table === 'paths', false);
  return out;
}

/** Returns the brushes that a plot shows for the selection. */
export function brushesOf(chips: Chips, table: TableName, fields: readonly SchemaAxis[], axes: readonly Axis[]): Brush[] {
  const found = brushChips(chips, table, new Set(fields.map((axis) => axis.field)));
  const out: Brush[] = [];
  fields.forEach(({ field }, index) => {
    const at = found.get(field);
    const axis = axes[index];
    if (!at || !axis) return;
    const inverted = at.chip.negated !== at.outside;
    if (axis.categories) {
      const last = axis.categories.length - 1;
      const isOthers = (k: number) => axis.scale === 'name' && k === last && axis.categories![k] === 'others';
      const numbers = axis.categories.map((_, k) => k);
      const categories = numbers.filter((k) => !isOthers(k) && hasCategory(at.chip, k === 0 ? null : axis.categories![k]!));
      out.push({ axis: index, ranges: [], categories, inverted });
    } else {
      const ranges = rangesOf(at.chip);
      if (ranges) out.push({ axis: index, ranges, categories: [], inverted });
    }
  });
  return out;
}

/** Returns names that an axis may have, by their kind. */
export function namesOf(schema: Schema, axis: SchemaAxis): string[] {
  // Media scatter light like materials and emit it like lights.
  const kinds = /object|occluder/.test(axis.field)
    ? ['object']
    : /material/.test(axis.field)
      ? ['material', 'medium']
      : ['light', 'lamp', 'medium'];
  const names = schema.names.filter((_, i) => kinds.includes((schema.kinds[i] ?? '').toLowerCase()));
  return names.length ? names : schema.names;
}

/** Largest number of names that stand for "others" or "none" in a condition. */
const MOST_CONDITION_NAMES = 200;

/** Reason why a brush has no condition. */
export class BrushError extends Error {}

/** Returns the text of a brush without its inversion; null if it contains nothing, or everything. */
export function brushText(brush: Brush, field: SchemaAxis, axis: Axis, schema: Schema): string | null {
  if (!axis.categories) {
    const isWhole = axis.scale === 'count' || axis.scale === 'film';
    return formatRanges(field.field, brush.ranges, isWhole) || null;
  }
  const every = axis.scale === 'class' ? (field.words ?? []) : namesOf(schema, field);
  const listed = new Set(axis.categories);
  const texts = brush.categories.flatMap((k): (string | null)[] => {
    if (k === 0) return [null];
    const text = axis.categories![k];
    if (axis.scale === 'name' && text === 'others' && k === axis.categories!.length - 1) {
      const others = every.filter((name) => !listed.has(name));
      if (others.length > MOST_CONDITION_NAMES) {
        const text = `“others” of ${axis.name} stands for ${others.length} names, and a condition has at most ${MOST_CONDITION_NAMES}`;
        throw new BrushError(`${text}: select the categories that you do not want, and invert the brush.`);
      }
      return others;
    }
    return text === undefined ? [] : [text];
  });
  return texts.length ? formatWords(field.field, texts, every) : null;
}

/** Returns the text of the selection with the brushes of a plot. Other terms, and brushes that did not change, keep their text. */
export function withBrushes(
  chips: Chips,
  table: TableName,
  brushes: readonly Brush[],
  schema: Schema,
  axes: readonly Axis[],
): Chips {
  const fields = schema.tables[table];
  const before = brushesOf(chips, table, fields, axes);
  let all = chips;
  const find = (field: string) => brushChips(all, table, new Set([field])).get(field);
  fields.forEach((field, index) => {
    const [old, next] = [before.find((it) => it.axis === index), brushes.find((it) => it.axis === index)];
    if (JSON.stringify(old) === JSON.stringify(next)) return;
    const text = next ? brushText(next, field, axes[index]!, schema) : null;
    const at = old && find(field.field);
    if (text === null || !next) {
      if (at) all = withChip(all, at.path, () => null);
    } else if (at) all = withChip(all, at.path, () => brushChip(text, next.inverted !== at.outside));
    else all = withBrush(all, table, brushChip(text, next.inverted));
  });
  return all;
}

/** Adds a brush: into the group of the table's other brushes, because one record must be in all of them. */
function withBrush(all: Chips, table: TableName, brush: BrushChip): Chips {
  if (table === 'paths') return withAlso(all, brush);
  const words = WRAPPERS[table];
  const group = all.chips.findIndex((chip) => chip.kind === 'group' && !chip.negated && chip.word && words.includes(chip.word));
  if (group < 0) {
    const inner = { chips: [brush], joins: [] };
    return withAlso(all, { kind: 'group', negated: false, word: words[0]!, inner });
  }
  return withChip(all, [group], (chip): Chip => (chip.kind === 'group' ? { ...chip, inner: withAlso(chip.inner, brush) } : chip));
}

/** Returns chips, or null if the page cannot read the text. */
export function chipsOrNull(text: string): Chips | null {
  try {
    return toChips(text);
  } catch {
    return null;
  }
}

// ---- Views of axes, in the address

const isLogarithmic = (axis: Axis) => axis.scale === 'radiance' || axis.scale === 'throughput';

export const defaultViews = (axes: readonly Axis[]): AxisView[] =>
  axes.map((axis) => ({ index: axis.index, hidden: false, log: isLogarithmic(axis), flipped: false }));

/** Formats views such as `3,0h,1f,2l`: order, hidden, flipped, the other scale than usual. Null for the usual views. */
export function formatViews(views: readonly AxisView[], axes: readonly Axis[]): string | null {
  const text = (all: readonly AxisView[]) =>
    all
      .map(({ index, hidden, log, flipped }) => {
        const isOther = log !== isLogarithmic(axes[index]!);
        return `${index}${hidden ? 'h' : ''}${flipped ? 'f' : ''}${isOther ? 'l' : ''}`;
      })
      .join(',');
  const is = text(views);
  return is === text(defaultViews(axes)) ? null : is;
}

/** Parses views. Axes that the text lacks follow in their order. */
export function parseViews(text: string | undefined, axes: readonly Axis[]): AxisView[] {
  const usual = defaultViews(axes);
  const out: AxisView[] = [];
  for (const part of (text ?? '').split(',')) {
    const match = /^(\d{1,3})([hfl]*)$/.exec(part);
    const view = usual[Number(match?.[1] ?? -1)];
    if (!match || !view || out.some((it) => it.index === view.index)) continue;
    const has = (flag: string) => match[2]!.includes(flag);
    out.push({ ...view, hidden: has('h'), flipped: has('f'), log: has('l') !== view.log });
  }
  return [...out, ...usual.filter((view) => !out.some((it) => it.index === view.index))];
}

/** Returns names of objects and of all that contain them, sorted. */
export function objectNames(schema: Schema): string[] {
  const all = new Set<string>();
  schema.names.forEach((name, i) => {
    if ((schema.kinds[i] ?? 'object').toLowerCase() !== 'object') return;
    for (let at = name; at; at = at.slice(0, Math.max(at.lastIndexOf('.'), at.lastIndexOf('/'), 0))) all.add(at);
  });
  return [...all].sort();
}

