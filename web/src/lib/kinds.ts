/** Kinds of tasks (graph/src/kind.rs) in the order of the legend, and the color of each in the timeline. */

import { OKABE_ITO } from './color';

export const KINDS = [
  'render',
  'reduce',
  'image',
  'decide',
  'first-pass',
  'first-pass-start',
  'first-pass-rays',
  'first-pass-solve',
  'first-pass-guides',
  'first-pass-finish',
  'learn',
  'reduce-layers',
  'reduce-paths',
  'count-levels',
  'reduce-levels',
  'encode-picture',
  'encode-sheet',
  'encode-clip',
  'paint',
  'geometry',
  'solution',
  'measure',
  'join-readings',
  'drill',
  // Kinds of earlier versions, in old records.
  'encode',
  'first-pass-block',
] as const;

/** The palette of Okabe and Ito has eight colors. Kinds of similar work have shades of one color. */
const COLORS: Readonly<Record<string, string>> = {
  render: OKABE_ITO[0],
  reduce: OKABE_ITO[4],
  image: OKABE_ITO[2],
  decide: OKABE_ITO[6],
  'first-pass': OKABE_ITO[1],
  'first-pass-start': '#B87F00',
  'first-pass-rays': OKABE_ITO[5],
  'first-pass-solve': '#F2C46B',
  'first-pass-guides': '#9C4500',
  'first-pass-finish': '#7A5200',
  learn: '#C9A36A',
  'reduce-layers': '#2F8FC4',
  'reduce-paths': '#8CCBF0',
  'count-levels': '#1F6F9C',
  'reduce-levels': '#B5DDF5',
  'encode-picture': OKABE_ITO[3],
  'encode-sheet': '#A85A84',
  'encode-clip': '#E3B3CD',
  paint: '#8064A2',
  geometry: '#5B4A80',
  solution: '#A99AC8',
  measure: '#3F7F5F',
  'join-readings': '#9CCBB0',
  drill: OKABE_ITO[7],
  encode: OKABE_ITO[3],
  'first-pass-block': OKABE_ITO[5],
} satisfies Record<(typeof KINDS)[number], string>;

/** Color of a kind; black for an unknown one. */
export const kindColor = (kind: string): string => COLORS[kind] ?? '#000000';

/** Returns the given kinds in the order of the legend; unknown ones come last. */
export function legendOf(stages: Iterable<string>): string[] {
  const found = new Set(stages);
  const known = KINDS.filter((kind) => found.delete(kind));
  return [...known, ...[...found].sort()];
}
