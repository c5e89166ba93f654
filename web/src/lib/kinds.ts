/** Kinds of tasks (farm/model/src/kind.rs) in the order of the legend, and the color of each in the timeline. */

import { OKABE_ITO } from './color';

export const KINDS = [
  'render',
  'reduce',
  'image',
  'decide',
  'encode',
  'first-pass',
  'first-pass-block',
  'paint',
  'drill',
] as const;

/** The palette of Okabe and Ito has eight colors; the ninth kind has a violet of similar lightness. */
const COLORS: Readonly<Record<string, string>> = {
  render: OKABE_ITO[0],
  reduce: OKABE_ITO[4],
  image: OKABE_ITO[2],
  decide: OKABE_ITO[6],
  encode: OKABE_ITO[3],
  'first-pass': OKABE_ITO[1],
  'first-pass-block': OKABE_ITO[5],
  paint: '#8064A2',
  drill: OKABE_ITO[7],
} satisfies Record<(typeof KINDS)[number], string>;

/** Color of a kind; black for an unknown one. */
export const kindColor = (kind: string): string => COLORS[kind] ?? '#000000';

/** Returns the given kinds in the order of the legend; unknown ones come last. */
export function legendOf(stages: Iterable<string>): string[] {
  const found = new Set(stages);
  const known = KINDS.filter((kind) => found.delete(kind));
  return [...known, ...[...found].sort()];
}
