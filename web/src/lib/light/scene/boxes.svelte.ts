/** Boxes of the scene view: one in the selection, and one for each data set to compare. One of them has handles. */

import { views } from '../../stores.svelte';
import { formatBoxText, parseBoxes, type Box } from '../boxes';
import { OVER_SETS } from '../overlay';
import { formatChips, type Chips } from '../text';
import { findBox, roundBox, withBox } from './pick';
import type { Outline } from './stage';

export type BoxKind = 'selection' | 'a' | 'b';
export const BOX_KINDS: readonly BoxKind[] = ['selection', 'a', 'b'];

interface Surroundings {
  chips: Chips | null;
  /** Half of the diagonal of the scene, m. */
  radius: number;
  onselect: (text: string, isFinal: boolean) => void;
}

const toHex = ([r, g, b]: readonly [number, number, number]) => (r << 16) | (g << 8) | b;
const COLORS: Record<BoxKind, number> = { selection: 0x00c2a8, a: toHex(OVER_SETS[0]), b: toHex(OVER_SETS[1]) };

export class SceneBoxes {
  /** Box with handles. */
  kind = $derived<BoxKind>(BOX_KINDS.find((it) => it === views.query.boxof) ?? 'selection');
  private readonly compared = $derived(parseBoxes(views.query.boxa, views.query.boxb));
  private dragged = $state.raw<Box | null>(null);

  constructor(private readonly around: () => Surroundings) {}

  private stored(kind: BoxKind): Box | null {
    if (kind === 'selection') return findBox(this.around().chips)?.box ?? null;
    return this.compared[kind === 'a' ? 0 : 1];
  }

  /** The box with handles; null if there is none. */
  get box(): Box | null {
    return this.dragged ?? this.stored(this.kind);
  }

  /** Whether the selection can have a box: the page can read its text. */
  get canSet(): boolean {
    return this.kind !== 'selection' || this.around().chips !== null;
  }

  /** All other boxes. */
  get outlines(): Outline[] {
    return BOX_KINDS.flatMap((kind) => {
      const box = kind === this.kind ? null : this.stored(kind);
      return box ? [{ box, color: COLORS[kind] }] : [];
    });
  }

  choose(kind: BoxKind) {
    views.set({ boxof: kind === 'selection' ? null : kind });
  }

  /** - `isFinal`: false while the box is dragged. */
  set = (next: Box | null, isFinal: boolean) => {
    const { chips, radius, onselect } = this.around();
    const rounded = next && roundBox(next, radius);
    this.dragged = isFinal ? null : next;
    if (this.kind === 'selection') {
      if (chips) onselect(formatChips(withBox(chips, rounded)), isFinal);
    } else if (isFinal) views.set({ [this.kind === 'a' ? 'boxa' : 'boxb']: rounded && formatBoxText(rounded) });
  };
}
