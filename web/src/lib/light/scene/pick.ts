/** Picks of objects as conditions of the selection. */

import { chipsOrNull } from '../data';
import { formatChips, quote, toChips, withAlso, withChip, withText, type Chip, type Chips } from '../text';
import type { Box } from './stage';

/**
 * What a pick selects. `object`: the intersections with it. `path`: paths that visit objects in an order. `interaction`: paths that meet it
 * at any time. `shadow`: light records that it hides.
 */
export type PickMode = 'object' | 'path' | 'interaction' | 'shadow';

export const MODES: readonly { mode: PickMode; label: string; title: string }[] = [
  { mode: 'object', label: 'object', title: 'Intersections with the object' },
  { mode: 'path', label: 'A, then B', title: 'Paths that hit object A, and later object B' },
  { mode: 'interaction', label: 'interaction', title: 'Whole paths that hit the object at any time' },
  { mode: 'shadow', label: 'shadow', title: 'Light that the object hides' },
];

export const parseMode = (text: string | undefined): PickMode => MODES.find((it) => it.mode === text)?.mode ?? 'object';

/** Returns the condition of a pick. */
export function termOf(mode: PickMode, name: string, first: string | null): string {
  if (mode === 'object') return `object == ${quote(name)}`;
  if (mode === 'interaction') return `any(object == ${quote(name)})`;
  if (mode === 'shadow') return `light(occluder == ${quote(name)})`;
  return `${quote(first ?? name)} then ${quote(name)}`;
}

/**
 * Returns the selection after a pick.
 * - `before`: condition of the pick before, which the new one replaces; null: the new one is added.
 */
export function withPick(text: string, term: string, before: string | null): string {
  const chips = chipsOrNull(text);
  if (!chips || before === null) return withText(text, term);
  const at = chips.chips.findIndex((chip) => formatChips({ chips: [chip], joins: [] }) === before);
  const [next] = toChips(term).chips;
  return at < 0 || !next ? withText(text, term) : formatChips(withChip(chips, [at], () => next));
}

// ---- Box

/** Returns the numbers of a chip `any(in box(..))`; null: another chip. */
function boxOf(chip: Chip): Box | null {
  const inner = chip.kind === 'group' && chip.word === 'any' && chip.inner.chips.length === 1 ? chip.inner.chips[0]! : chip;
  if (inner.kind !== 'term' || inner.body.kind !== 'box') return null;
  return inner.body.numbers as unknown as Box;
}

/** Returns the box of a selection; null: it has none. */
export function findBox(chips: Chips | null): { at: number; box: Box } | null {
  const all = chips?.chips ?? [];
  for (let at = 0; at < all.length; at++) {
    const box = boxOf(all[at]!);
    if (box) return { at, box };
  }
  return null;
}

/** Returns a selection with another box; null removes it. */
export function withBox(chips: Chips, box: Box | null): Chips {
  const found = findBox(chips);
  if (!box) return found ? withChip(chips, [found.at], () => null) : chips;
  const next = toChips(`any(in box(${box.join(',')}))`).chips[0]!;
  return found ? withChip(chips, [found.at], (it) => ({ ...next, negated: it.negated })) : withAlso(chips, next);
}

/** Rounds a box to a thousandth of the extent of the scene. */
export function roundBox(box: Box, radius: number): Box {
  const digits = Math.min(Math.max(Math.ceil(3 - Math.log10(radius)), 0), 12);
  return box.map((v) => Number(v.toFixed(digits))) as unknown as Box;
}
