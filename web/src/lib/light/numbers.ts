/** Light in numbers: rows of one data set or of two, and how they differ. The command `femc paths --by` has the same rows. */

import type { Estimate, LightAmount, Summary, SummaryGroup } from './api';

/** Number of standard errors from the middle to the ends of a 95 % interval. */
export const INTERVAL_95 = 1.96;
/** Number of standard errors beyond which a difference is marked. */
export const MARKED_ERRORS = 3;

export interface NumberRow {
  /** Group: `all`, one of the groups, or `box`. */
  by: string;
  name: string;
  where: string | null;
  a: LightAmount;
  /** Null: there is one data set. */
  b: LightAmount | null;
}

/** Measure of a row. */
export type Measure = 'light' | 'energy' | 'per_path';
export const MEASURES: readonly { measure: Measure; label: string; unit: string }[] = [
  { measure: 'light', label: 'light in the picture', unit: 'cd/m²' },
  { measure: 'energy', label: 'mean energy of intersections', unit: 'cd/m²' },
  { measure: 'per_path', label: 'records of a path', unit: '' },
];

const NOTHING: LightAmount = {
  paths: 0,
  light: { value: 0, standard_error: null },
  records: 0,
  per_path: { value: 0, standard_error: null },
  energy: null,
};

/** Returns the rows of a group, after a row of all selected records. Rows that one of the data sets lacks are 0 there. */
export function rowsOf(group: SummaryGroup, a: Summary, b: Summary | null): NumberRow[] {
  const others = new Map(b?.groups[group].map((it) => [it.name, it]));
  const rows: NumberRow[] = [];
  for (const it of a.groups[group]) {
    rows.push({ by: group, name: it.name, where: it.where, a: it, b: b && (others.get(it.name) ?? NOTHING) });
    others.delete(it.name);
  }
  for (const it of others.values()) rows.push({ by: group, name: it.name, where: it.where, a: NOTHING, b: it });
  if (group === 'bounce') rows.sort((x, y) => Number(x.name === 'camera' ? -1 : x.name) - Number(y.name === 'camera' ? -1 : y.name));
  return rows;
}

export const allRow = (a: Summary, b: Summary | null): NumberRow => ({ by: 'all', name: 'all', where: null, a: a.total, b: b && b.total });

export const boxRow = (a: Summary, b: Summary | null): NumberRow => ({ by: 'box', name: 'box', where: null, a: a.total, b: b && b.total });

export interface Difference {
  /** A minus B. */
  value: number;
  /** Its standard error; null: unknown. */
  standard_error: number | null;
  /** A divided by B; null: B is 0. */
  ratio: number | null;
  /** 95 % interval of the ratio. */
  bounds: [number, number] | null;
  /** Difference in standard errors. */
  z: number | null;
}

/** Compares an estimate of A with one of B. A and B are taken for independent. An amount without recorded paths is 0. */
export function differenceOf(a: LightAmount, b: LightAmount, measure: Measure): Difference | null {
  const [x, y]: (Estimate | null)[] = [a[measure], b[measure]];
  // Without intersections, there is no mean.
  if (!x || !y) return null;
  const known = (of: LightAmount, it: Estimate) => (of.paths === 0 ? 0 : it.standard_error);
  const [ofX, ofY] = [known(a, x), known(b, y)];
  const error = ofX === null || ofY === null ? null : Math.hypot(ofX, ofY);
  const value = x.value - y.value;
  const ratio = y.value > 0 ? x.value / y.value : null;
  let bounds: [number, number] | null = null;
  if (ratio !== null && ratio > 0 && ofX !== null && ofY !== null) {
    const factor = Math.exp(INTERVAL_95 * Math.hypot(ofX / x.value, ofY / y.value));
    bounds = [ratio / factor, ratio * factor];
  }
  return { value, standard_error: error || null, ratio, bounds, z: error ? value / error : null };
}

export const isMarked = (it: Difference | null): boolean => it?.z != null && Math.abs(it.z) > MARKED_ERRORS;

const half = (it: Estimate | null | undefined): number | null =>
  it?.standard_error == null ? null : INTERVAL_95 * it.standard_error;

type Cells = Record<string, string | number | null>;

/** Returns the cells of a row with the names of the columns of `femc paths --by --csv`. Errors are half widths of 95 % intervals. */
export function cellsOf({ by, name, a, b }: NumberRow): Cells {
  const amount = (of: LightAmount, end: string): Cells => ({
    [`paths${end}`]: of.paths,
    [`light${end}`]: of.light.value,
    [`light_error${end}`]: half(of.light),
    [`records${end}`]: of.records,
    [`per_path${end}`]: of.per_path.value,
    [`per_path_error${end}`]: half(of.per_path),
    [`energy${end}`]: of.energy?.value ?? null,
    [`energy_error${end}`]: half(of.energy),
  });
  const cells: Cells = { by, name, ...amount(a, '') };
  if (!b) return cells;
  const [it, energy] = [differenceOf(a, b, 'light')!, differenceOf(a, b, 'energy')];
  return {
    ...cells,
    ...amount(b, '_there'),
    difference: it.value,
    difference_error: it.standard_error === null ? null : INTERVAL_95 * it.standard_error,
    ratio: it.ratio,
    ratio_low: it.bounds?.[0] ?? null,
    ratio_high: it.bounds?.[1] ?? null,
    standard_errors: it.z,
    differs: it.z === null ? null : isMarked(it) ? 'yes' : 'no',
    energy_difference: energy?.value ?? null,
    energy_difference_error: energy?.standard_error == null ? null : INTERVAL_95 * energy.standard_error,
    energy_ratio: energy?.ratio ?? null,
    energy_ratio_low: energy?.bounds?.[0] ?? null,
    energy_ratio_high: energy?.bounds?.[1] ?? null,
  };
}

/** Formats rows as CSV with a header line. */
export function toCsv(rows: readonly NumberRow[]): string {
  const all = rows.map(cellsOf);
  const names = Object.keys(all[0] ?? {});
  const field = (cell: string | number | null | undefined) => {
    const text = cell == null ? '' : String(cell);
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [names.join(','), ...all.map((cells) => names.map((name) => field(cells[name])).join(','))].join('\n') + '\n';
}
