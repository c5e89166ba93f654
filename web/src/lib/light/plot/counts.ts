/**
 * Counts of lines per pixel without a graphics card. Processors count lines ten times as fast as they imitate a graphics
 * card, and a change of the selection only adds and takes away the lines that it concerns.
 */

/** Place of the axes on the screen, in pixels; rows are counted from the lower end of the canvas. */
export interface StripShape {
  /** Pixels between the two axes. */
  columns: number;
  /** Rows of the canvas. */
  rows: number;
  /** Row of the lower end of the axes, and their length. */
  base: number;
  length: number;
}

/** Lines of a set between two neighboring axes. */
export interface StripLines {
  left: Float32Array;
  right: Float32Array;
  leftFlipped: boolean;
  rightFlipped: boolean;
  rows: number;
}

/** Fraction bits of positions. */
const BITS = 16;
const ONE = 1 << BITS;

/**
 * Adds lines to `steps`: differences of the counts of neighboring rows, `rows + 2` numbers a column.
 * - `mask`: lines that the counts shall have; null: all
 * - `counted`: lines that the counts have; null: none
 */
export function addLines(
  steps: Int16Array,
  { columns, rows, base, length }: StripShape,
  lines: StripLines,
  mask: Uint8Array | null,
  counted: Uint8Array | null,
): void {
  const stride = rows + 2;
  const { left, right } = lines;
  const most = Math.max(0, (rows - 1) * ONE);
  const size = Math.max(length - 1e-3, 0) * ONE;
  const start = base * ONE;
  const [leftScale, leftStart] = lines.leftFlipped ? [-size, start + size] : [size, start];
  const [rightScale, rightStart] = lines.rightFlipped ? [-size, start + size] : [size, start];
  for (let i = 0; i < lines.rows; i++) {
    const weight = (mask ? mask[i]! : 1) - (counted ? counted[i]! : 0);
    if (weight === 0) continue;
    let y = (leftStart + leftScale * left[i]!) | 0;
    let end = (rightStart + rightScale * right[i]!) | 0;
    y = y < 0 ? 0 : y > most ? most : y;
    end = end < 0 ? 0 : end > most ? most : end;
    const by = ((end - y) / columns) | 0;
    let row = y >> BITS;
    let at = 0;
    if (by >= 0) {
      for (let x = 0; x < columns; x++) {
        y += by;
        const next = y >> BITS;
        steps[at + row]! += weight;
        steps[at + (next > row ? next : row + 1)]! -= weight;
        row = next;
        at += stride;
      }
    } else {
      for (let x = 0; x < columns; x++) {
        y += by;
        const next = y >> BITS;
        steps[at + (next < row ? next + 1 : row)]! += weight;
        steps[at + row + 1]! -= weight;
        row = next;
        at += stride;
      }
    }
  }
}

/** Counts in a byte: four times the root of the count, so that small counts are exact enough and thousands fit. */
export const ROOTS = 4;
const codes = Uint8Array.from({ length: 4096 }, (_, n) => Math.min(Math.round(ROOTS * Math.sqrt(n)), 255));

/** Writes counts as bytes, row by row from the lowest on. */
export function encode(steps: Int16Array, { columns, rows }: StripShape, bytes: Uint8Array): void {
  for (let x = 0; x < columns; x++) {
    const at = x * (rows + 2);
    let count = 0;
    for (let y = 0, to = x; y < rows; y++, to += columns) {
      count += steps[at + y]!;
      bytes[to] = codes[count < 4096 ? count : 4095]!;
    }
  }
}

/** Counts of a set between two neighboring axes. */
export class StripCounts {
  /** Counts as bytes, row by row from the lowest on. */
  bytes = new Uint8Array();
  private key: string | null = null;
  private steps = new Int16Array();
  private counted: Uint8Array | null = null;

  /**
   * Brings the counts up to date.
   * - `key`: text that changes with everything but the mask
   * - `selected`: lines to count; null: all
   */
  update(key: string, shape: StripShape, lines: StripLines, selected: Uint8Array | null): void {
    const mask = selected ?? ALL;
    if (this.key !== key) {
      this.key = key;
      this.steps = new Int16Array(shape.columns * (shape.rows + 2));
      this.bytes = new Uint8Array(shape.columns * shape.rows);
      this.counted = null;
    }
    if (this.counted === mask) return;
    if (this.counted && isFar(this.counted, mask, lines.rows)) {
      this.steps.fill(0);
      this.counted = null;
    }
    addLines(this.steps, shape, lines, selected, this.counted);
    encode(this.steps, shape, this.bytes);
    this.counted = mask;
  }
}

/** Mask of layers with all lines. */
const ALL = new Uint8Array();

/** Returns whether a new count is less work than a correction. */
function isFar(counted: Uint8Array, mask: Uint8Array, rows: number): boolean {
  if (counted === ALL || mask === ALL) return true;
  let [changed, all] = [0, 0];
  for (let i = 0; i < rows; i++) {
    changed += counted[i]! ^ mask[i]!;
    all += mask[i]!;
  }
  return changed > all;
}
