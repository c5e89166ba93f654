/** Place of the axes on the screen. Lengths are in CSS pixels. */

const LEFT = 58;
const RIGHT = 52;
const TOP = 48;
const BOTTOM = 12;
/** Least distance of axes. */
const MIN_SPACING = 64;

export interface Layout {
  width: number;
  height: number;
  /** Position of the first axis, and the distance of axes. */
  left: number;
  spacing: number;
  /** Upper and lower end of the axes. */
  top: number;
  bottom: number;
}

/** Returns the layout of `axes` axes in a plot; it is wider than `room` if the axes need more. */
export function layoutOf(axes: number, room: number, height: number): Layout {
  const gaps = Math.max(axes - 1, 0);
  const spacing = Math.max(MIN_SPACING, (room - LEFT - RIGHT) / Math.max(gaps, 1));
  return { width: LEFT + RIGHT + spacing * gaps, height, left: LEFT, spacing, top: TOP, bottom: height - BOTTOM };
}

/** Returns the length of the axes. */
export const lengthOf = ({ top, bottom }: Layout): number => bottom - top;

/** Returns the position of the axis at a place in the order. */
export const xOf = ({ left, spacing }: Layout, place: number): number => left + place * spacing;

/** Returns the place in the order that is nearest to a position. */
export const placeAt = ({ left, spacing }: Layout, x: number): number => Math.round((x - left) / spacing);

/** Returns the position of a height of an axis; heights are from 0 to 1. */
export const yOf = (layout: Layout, height: number, flipped: boolean): number =>
  layout.top + (flipped ? height : 1 - height) * lengthOf(layout);

/** Returns the height of an axis at a position, within the axis. */
export function heightAt(layout: Layout, y: number, flipped: boolean): number {
  const at = Math.min(Math.max((layout.bottom - y) / lengthOf(layout), 0), 1);
  return flipped ? 1 - at : at;
}
