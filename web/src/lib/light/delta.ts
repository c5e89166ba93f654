/** Rows of growing data: an answer may have only the new rows, and refer to the rows of an earlier answer. */

import { Columns, NONE, type Arrays, type ColumnType } from './columns';

export interface GrowingHeader {
  /** Whether later answers may refer to the rows of this one. */
  growing?: boolean;
  /** Tag of the earlier answer that has the kept rows. */
  since?: string;
}

/** An answer with all its rows. */
export interface TaggedAnswer<H> {
  tag: string;
  columns: Columns<H>;
}

/** Latest answers about growing data, by data set. */
export class GrowingAnswers<H> {
  /** The page shows two data sets at most. */
  private static readonly MOST = 2;
  private readonly answers = new Map<string, TaggedAnswer<H>>();

  get(key: string): TaggedAnswer<H> | null {
    return this.answers.get(key) ?? null;
  }

  /** Replaces the answer of a data set; null removes it. */
  set(key: string, answer: TaggedAnswer<H> | null) {
    this.answers.delete(key);
    if (answer) this.answers.set(key, answer);
    const [oldest] = this.answers.keys();
    if (this.answers.size > GrowingAnswers.MOST && oldest !== undefined) this.answers.delete(oldest);
  }
}

type Numbers = Arrays[ColumnType];

/** Columns with a value for each path of the full answer. */
const WHOLE = new Set(['paths.number', 'paths.weight', 'paths.selected', 'intersections.selected', 'lights.selected']);
/** Columns of the difference alone. */
const OWN = new Set(['paths.kept', 'paths.first_intersection', 'paths.first_light']);

/** Origin of each row of a table: the earlier answer (0) or the difference (1), and the row there. */
interface Origins {
  from: Uint8Array;
  row: Uint32Array;
}

/** Returns the first record of each path, and one past the last record. */
function firstRecords(owners: Uint32Array, paths: number): Uint32Array {
  const firsts = new Uint32Array(paths + 1);
  for (const owner of owners) {
    if (owner >= paths) throw new Error('a record of the light data has no path');
    firsts[owner + 1]!++;
  }
  for (let path = 0; path < paths; path++) firsts[path + 1]! += firsts[path]!;
  return firsts;
}

/** Returns the values of rows from two columns. */
function gather(name: string, [earlier, difference]: [Numbers, Numbers], { from, row }: Origins): Numbers {
  if (earlier.constructor !== difference.constructor) throw new Error(`the column ${name} has changed its type`);
  const out = new (difference.constructor as new (length: number) => Numbers)(row.length);
  for (let i = 0; i < row.length; i++) out[i] = (from[i] ? difference : earlier)[row[i]!]!;
  return out;
}

/**
 * Returns an answer with all its rows. If `received` has only new rows, the other rows are those of the earlier answer. Throws an
 * `Error` if they do not fit together.
 */
export function withKeptRows<H extends GrowingHeader>(earlier: TaggedAnswer<H> | null, received: Columns<H>): Columns<H> {
  const { since, ...header } = received.header;
  if (since === undefined) return received;
  if (since !== earlier?.tag) throw new Error('the light data refer to rows that this page does not have');
  const before = earlier.columns;
  const kept = received.u32('paths.kept');
  const counts = [before.u32('paths.frame').length, received.u32('paths.frame').length] as const;
  const paths: Origins = { from: new Uint8Array(kept.length), row: new Uint32Array(kept.length) };
  let fresh = 0;
  kept.forEach((row, i) => {
    paths.from[i] = row === NONE ? 1 : 0;
    paths.row[i] = row === NONE ? fresh++ : row;
    if (row !== NONE && row >= counts[0]) throw new Error('the light data refer to rows that this page does not have');
  });
  if (fresh !== counts[1]) throw new Error('the light data lack new rows');

  const arrays = new Map<string, Numbers>();
  const firstsOf = (table: string) =>
    [before, received].map((answer, i) => firstRecords(answer.u32(`${table}.path`), counts[i]!)) as [Uint32Array, Uint32Array];
  const intersections = firstsOf('intersections');
  const outFirsts = new Uint32Array(kept.length);
  const records = (table: 'intersections' | 'lights', firsts: [Uint32Array, Uint32Array]): Origins => {
    const size = (i: number) => {
      const all = firsts[paths.from[i]!]!;
      return all[paths.row[i]! + 1]! - all[paths.row[i]!]!;
    };
    let total = 0;
    for (let i = 0; i < kept.length; i++) total += size(i);
    const out: Origins = { from: new Uint8Array(total), row: new Uint32Array(total) };
    const owners = new Uint32Array(total);
    const parents = new Uint32Array(total);
    const numbers = new Uint32Array(total);
    const parentName = table === 'intersections' ? 'intersections.parent' : 'lights.intersection';
    const sources = [before.u32(parentName), received.u32(parentName)] as const;
    const firstNumbers = received.u32(table === 'intersections' ? 'paths.first_intersection' : 'paths.first_light');
    let at = 0;
    for (let i = 0; i < kept.length; i++) {
      if (table === 'intersections') outFirsts[i] = at;
      const [from, row] = [paths.from[i]!, paths.row[i]!];
      const [first, count] = [firsts[from]![row]!, size(i)];
      const shift = outFirsts[i]! - intersections[from]![row]!;
      const number = firstNumbers[i]!;
      for (let k = 0; k < count; k++, at++) {
        out.from[at] = from;
        out.row[at] = first + k;
        owners[at] = i;
        const parent = sources[from]![first + k]!;
        parents[at] = parent === NONE ? NONE : parent + shift;
        numbers[at] = number === NONE ? NONE : number + k;
      }
    }
    arrays.set(`${table}.path`, owners);
    arrays.set(parentName, parents);
    arrays.set(`${table}.number`, numbers);
    return out;
  };
  const origins = { paths, intersections: records('intersections', intersections), lights: records('lights', firstsOf('lights')) };
  for (const name of received.names()) {
    if (OWN.has(name) || arrays.has(name)) continue;
    const table = name.slice(0, name.indexOf('.')) as keyof typeof origins;
    const own = received.any(name);
    arrays.set(name, WHOLE.has(name) ? own : gather(name, [before.any(name), own], origins[table]));
  }
  return new Columns(header as typeof received.header, arrays);
}
