/** Changes of brushes by a pointer on an axis, and by keys on the ends of ranges. */

import { joined } from './brush';
import { spansOf, type Column } from './column';
import type { Brush } from './contract';
import { heightAt, type Layout } from './layout';
import { rangeBetween, step, withEnd, withEndAt, withShift } from './scale';

/** Part of a brush that a pointer holds. */
export interface BrushDrag {
  column: Column;
  /** Ranges that the drag does not change. */
  base: [number, number][];
  mode: 'new' | 'move' | 'low' | 'high';
  /** Range that is moved or resized. */
  range: [number, number];
  /** Height where the drag began, and its position in pixels. */
  from: number;
  y: number;
  hasMoved: boolean;
}

/**
 * Returns the drag that begins at a position: of the end or the range that is there, or of a new range.
 * - `reach`: greatest distance of the pointer from an end, in pixels
 */
export function beginDrag(column: Column, layout: Layout, y: number, reach: number): BrushDrag {
  const { brush, scale, flipped } = column;
  const drag: BrushDrag = {
    column,
    base: brush.ranges.map((it) => [it[0], it[1]]),
    mode: 'new',
    range: [0, 0],
    from: heightAt(layout, y, flipped),
    y,
    hasMoved: false,
  };
  if (scale.isCategorical) return drag;
  let [nearest, own] = [Infinity, -1];
  for (const { top, size, range } of spansOf(column, layout)) {
    const isInside = y >= top && y <= top + size;
    const [toTop, toEnd] = [Math.abs(y - top), Math.abs(y - top - size)];
    const edge = Math.min(toTop, toEnd);
    // The middle third of a small range moves it.
    const most = isInside ? Math.min(reach, size / 3) : reach;
    if (edge <= most && edge < nearest) {
      const isUpper = toTop < toEnd !== flipped;
      [drag.mode, own, nearest] = [isUpper ? 'high' : 'low', range, edge];
    } else if (isInside && nearest === Infinity) [drag.mode, own] = ['move', range];
  }
  if (own >= 0) {
    drag.range = brush.ranges[own]!;
    drag.base = drag.base.filter((_, i) => i !== own);
  }
  return drag;
}

/** Returns the brush after the pointer of a drag has moved to a position. */
export function draggedBrush({ column, base, mode, range, from }: BrushDrag, layout: Layout, y: number): Brush {
  const { scale, brush, flipped } = column;
  const to = heightAt(layout, y, flipped);
  if (scale.isCategorical) {
    const [low, high] = [Math.min(from, to), Math.max(from, to)];
    const passed = scale.order.filter((k) => scale.from[k]! < high && scale.to[k]! > low);
    return { ...brush, categories: [...new Set([...brush.categories, ...passed])].sort((a, b) => a - b) };
  }
  let next: [number, number];
  if (mode === 'new') next = rangeBetween(scale, from, to);
  else if (mode === 'move') next = withShift(scale, range, to - from);
  else next = withEnd(scale, range, mode === 'low' ? 0 : 1, to);
  return { ...brush, ranges: joined([...base, next], scale.isDiscrete) };
}

const STEPS: Record<string, number> = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 5, PageDown: -5 };

/** Returns the brush after a key is pressed on the lower (0) or upper (1) end of a range; null if the key changes nothing. */
export function brushAfterKey({ brush, scale, flipped }: Column, number: number, end: 0 | 1, key: string): Brush | null {
  const range = brush.ranges[number];
  if (!range) return null;
  const by = STEPS[key];
  let next: [number, number] | null = [range[0], range[1]];
  if (by !== undefined) next[end] = step(scale, range[end], flipped && key.startsWith('Arrow') ? -by : by);
  else if (key === 'Home') next = withEndAt(scale, next, end, 'low');
  else if (key === 'End') next = withEndAt(scale, next, end, 'high');
  else if (key === 'Delete' || key === 'Backspace') next = null;
  else return null;
  // An end does not pass the other one.
  if (next && next[0] > next[1]) next[end] = next[1 - end]!;
  const ranges = brush.ranges.flatMap((it, i) => (i !== number ? [it] : next ? [next] : []));
  return { ...brush, ranges };
}
