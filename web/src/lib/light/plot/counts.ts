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
 * Adds lines to `steps`, and takes lines away: differences of the counts of neighboring rows, `rows + 2` numbers a column. Returns the
 * row from which on lines remain; the number of rows if none does.
 * - `mask`: 1 for lines that the counts shall have; null: all
 * - `counted`: 1 for lines that the counts have; kept up to date
 * - `from`: row to begin with
 * - `most`: greatest number of lines that are added or taken away
 */
export function addLines(
  steps: Int32Array,
  { columns, rows, base, length }: StripShape,
  lines: StripLines,
  mask: Uint8Array | null,
  counted: Uint8Array,
  from = 0,
  most = Infinity,
): number {
  const stride = rows + 2;
  const { left, right } = lines;
  const upper = Math.max(0, (rows - 1) * ONE);
  const size = Math.max(length - 1e-3, 0) * ONE;
  const start = base * ONE;
  const [leftScale, leftStart] = lines.leftFlipped ? [-size, start + size] : [size, start];
  const [rightScale, rightStart] = lines.rightFlipped ? [-size, start + size] : [size, start];
  let changed = 0;
  for (let i = from; i < lines.rows; i++) {
    const due = mask ? mask[i]! : 1;
    const weight = due - counted[i]!;
    if (weight === 0) continue;
    if (changed++ >= most) return i;
    counted[i] = due;
    let y = (leftStart + leftScale * left[i]!) | 0;
    let end = (rightStart + rightScale * right[i]!) | 0;
    y = y < 0 ? 0 : y > upper ? upper : y;
    end = end < 0 ? 0 : end > upper ? upper : end;
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
  return lines.rows;
}

/** Counts in a byte: four times the root of the count, so that small counts are exact enough and thousands fit. */
export const ROOTS = 4;
const codes = Uint8Array.from({ length: 4096 }, (_, n) => Math.min(Math.round(ROOTS * Math.sqrt(n)), 255));

/** Writes counts as bytes, row by row from the lowest on. */
export function encode(steps: Int32Array, { columns, rows }: StripShape, bytes: Uint8Array): void {
  for (let x = 0; x < columns; x++) {
    const at = x * (rows + 2);
    let count = 0;
    for (let y = 0, to = x; y < rows; y++, to += columns) {
      count += steps[at + y]!;
      bytes[to] = codes[count < 4096 ? count : 4095]!;
    }
  }
}

/** Pixels of lines that are counted in one piece. */
const PIECE = 400_000;

/** Counts of a set between two neighboring axes. */
export class StripCounts {
  /** Counts as bytes, row by row from the lowest on. */
  bytes = new Uint8Array();
  private key: string | null = null;
  private steps = new Int32Array();
  /** 1 for lines that `steps` has. */
  private counted = new Uint8Array();
  /** Mask of the last call, and the row from which on its lines remain to be counted. */
  private mask: Uint8Array | null = null;
  private at = 0;

  /**
   * Does a piece of the work of bringing the counts up to date. Returns whether more is left.
   * - `key`: text that changes with everything but the mask
   * - `selected`: 1 for lines to count; null: all
   * - `most`: greatest number of lines in a piece
   */
  advance(
    key: string,
    shape: StripShape,
    lines: StripLines,
    selected: Uint8Array | null,
    most = Math.ceil(PIECE / Math.max(shape.columns, 1)),
  ): boolean {
    const isNew = this.key !== key;
    if (isNew) {
      this.key = key;
      this.steps = new Int32Array(shape.columns * (shape.rows + 2));
      this.bytes = new Uint8Array(shape.columns * shape.rows);
      this.counted = new Uint8Array(lines.rows);
    }
    if (isNew || this.mask !== selected) {
      this.mask = selected;
      this.at = 0;
      if (isFar(this.counted, selected, lines.rows)) {
        this.steps.fill(0);
        this.counted.fill(0);
      }
    } else if (this.at === lines.rows) return false;
    this.at = addLines(this.steps, shape, lines, selected, this.counted, this.at, most);
    if (this.at < lines.rows) return true;
    encode(this.steps, shape, this.bytes);
    return false;
  }
}

/** Returns whether a new count is less work than a correction. */
function isFar(counted: Uint8Array, mask: Uint8Array | null, rows: number): boolean {
  if (!mask) return false;
  let [changed, all] = [0, 0];
  for (let i = 0; i < rows; i++) {
    changed += counted[i]! ^ mask[i]!;
    all += mask[i]!;
  }
  return changed > all;
}
