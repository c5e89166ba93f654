/** Half floats (IEEE 754 binary16). */

const LENGTH = 1 << 16;
let table: Float32Array | undefined;

/** Decodes the 16 bits of a half float. */
export function decodeHalf(bits: number): number {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 0x1f;
  const fraction = bits & 0x3ff;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

/** Returns all 65,536 values by their bits. A lookup in this table is several times as fast as [`decodeHalf`]. */
export function halves(): Float32Array {
  if (!table) {
    table = new Float32Array(LENGTH);
    for (let bits = 0; bits < LENGTH; bits++) table[bits] = decodeHalf(bits);
  }
  return table;
}
