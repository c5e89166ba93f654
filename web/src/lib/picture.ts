/** Converts a frame's planes to displayable images. */

import { autoExposure, diverging, lookup, luminance, srgbByte, toneGain, viridis } from './color';
import { percent, quantity, value } from './format';
import { halves } from './half';
import type { Pixels } from './pixels';
import { place, spread, valueAt, type Scale } from './scale';

/** Maps from light statistics, by pixel. */
export const MAPS = ['deviation', 'depth', 'throughput'] as const;
export type Mapped = (typeof MAPS)[number];
export const SHOWS = ['picture', 'luminance', 'pixel-error', 'error', 'samples', ...MAPS, 'difference'] as const;
export type Show = (typeof SHOWS)[number];
/** Maps of one frame. */
export type Measured = Exclude<Show, 'picture' | 'difference'>;

export const isMapped = (show: Show): show is Mapped => (MAPS as readonly string[]).includes(show);

/** Measured quantities: title, unit, channel. */
export const MEASURES: Record<Exclude<Show, 'picture'>, { title: string; unit: string; channel: string }> = {
  luminance: { title: 'Luminance', unit: 'cd/m²', channel: 'Y' },
  'pixel-error': { title: 'Pixel error', unit: 'relative standard error of the pixel', channel: 'standard_error' },
  error: { title: 'Block error', unit: '95 % interval of the block of 16 × 16 pixels, ± relative', channel: 'error' },
  samples: { title: 'Samples', unit: 'samples per pixel', channel: 'samples' },
  deviation: { title: 'Deviation', unit: 'cd/m², standard deviation of a sample', channel: 'deviation' },
  depth: { title: 'Depth', unit: 'intersections per path', channel: 'depth' },
  throughput: { title: 'Throughput', unit: 'throughput at the end of a path', channel: 'throughput' },
  difference: { title: 'Difference', unit: 'cd/m², other frame minus this one', channel: 'Y' },
};

/** Formats values of a picture or map. */
export const formatOf = (show: Show): ((v: number) => string) =>
  show === 'error' || show === 'pixel-error' ? percent : show === 'samples' ? quantity : value;

/** Color for a missing value. */
export const NO_VALUE = 0xff808080;

/** Returns the luminances of all pixels, cd/m2. */
export function luminances(pixels: Pixels): Float32Array {
  const y = pixels.floats('Y');
  if (y) return y;
  const [r, g, b] = ['R', 'G', 'B'].map((name) => pixels.floats(name));
  return Float32Array.from({ length: pixels.width * pixels.height }, (_, i) =>
    luminance(r?.[i] ?? 0, g?.[i] ?? 0, b?.[i] ?? 0),
  );
}

/** Returns the automatic exposure of the picture, 1/(cd/m2). */
export const suitableExposure = (pixels: Pixels): number => autoExposure(luminances(pixels));

/** Applies the farm's tone curve to the picture, gray if only luminances are known; returns 32-bit words of a canvas. */
export function develop(pixels: Pixels, exposure: number): Uint32Array<ArrayBuffer> {
  const out = new Uint32Array(pixels.width * pixels.height);
  const table = halves();
  const [red, green, blue] = ['R', 'G', 'B'].map((name) => pixels.planes.get(name) ?? pixels.planes.get('Y'));
  if (!red || !green || !blue) return out.fill(NO_VALUE);
  for (let i = 0; i < out.length; i++) {
    const r = Math.max(table[red[i]!]! * exposure, 0);
    const g = Math.max(table[green[i]!]! * exposure, 0);
    const b = Math.max(table[blue[i]!]! * exposure, 0);
    const gain = toneGain(luminance(r, g, b));
    out[i] = 0xff000000 | (srgbByte(b * gain) << 16) | (srgbByte(g * gain) << 8) | srgbByte(r * gain);
  }
  return out;
}

/** Returns the other frame's luminance minus this one's for each pixel; null if the film sizes differ. */
export function difference(a: Pixels, b: Pixels): Float32Array | null {
  if (a.width !== b.width || a.height !== b.height) return null;
  const [x, y] = [luminances(a), luminances(b)];
  return x.map((v, i) => y[i]! - v);
}

/**
 * Smooths values with a Gaussian. Values that are not finite are left out of the means and stay unchanged. Zeros cost little: most pixels
 * of a density have no path.
 * - `sigma`: pixels; 0 changes nothing.
 */
export function smooth(values: Float32Array, width: number, height: number, sigma: number): Float32Array {
  if (!(sigma > 0)) return values;
  const reach = Math.ceil(3 * sigma);
  const kernel = Float64Array.from({ length: 2 * reach + 1 }, (_, i) => Math.exp(-((i - reach) ** 2) / (2 * sigma * sigma)));
  const isNumber = (v: number) => v - v === 0;
  if (values.every(isNumber)) {
    const [across, down] = [width, height].map((size) => kernelSums(size, kernel, reach)) as [Float64Array, Float64Array];
    const out = convolve(values, width, height, kernel);
    for (let y = 0, i = 0; y < height; y++) for (let x = 0; x < width; x++, i++) out[i]! /= across[x]! * down[y]!;
    return out;
  }
  const sums = convolve(values.map((v) => (isNumber(v) ? v : 0)), width, height, kernel);
  const weights = convolve(values.map((v) => Number(isNumber(v))), width, height, kernel);
  return values.map((v, i) => (isNumber(v) ? sums[i]! / weights[i]! : v));
}

/** Returns the sums of neighbors, weighted by the kernel along the rows and along the columns. */
function convolve(values: Float32Array, width: number, height: number, kernel: Float64Array): Float32Array {
  const reach = (kernel.length - 1) / 2;
  const rows = new Float32Array(values.length);
  const isUsed = new Uint8Array(height);
  const sums = new Float64Array(width);
  for (let y = 0, i = 0; y < height; y++) {
    sums.fill(0);
    for (let x = 0; x < width; x++, i++) {
      const v = values[i]!;
      if (v === 0) continue;
      isUsed[y] = 1;
      const last = Math.min(width - 1, x + reach);
      for (let to = Math.max(0, x - reach); to <= last; to++) sums[to]! += v * kernel[to - x + reach]!;
    }
    if (isUsed[y]) rows.set(sums, y * width);
  }
  const out = new Float32Array(values.length);
  for (let y = 0; y < height; y++) {
    sums.fill(0);
    for (let from = Math.max(0, y - reach); from <= Math.min(height - 1, y + reach); from++) {
      if (!isUsed[from]) continue;
      const weight = kernel[from - y + reach]!;
      for (let x = 0, at = from * width; x < width; x++, at++) sums[x]! += weight * rows[at]!;
    }
    out.set(sums, y * width);
  }
  return out;
}

/** Returns the sum of the part of the kernel that lies within the picture, for each place of a row or column. */
function kernelSums(size: number, kernel: Float64Array, reach: number): Float64Array {
  return Float64Array.from({ length: size }, (_, at) => {
    let sum = 0;
    for (let k = Math.max(-reach, -at); k <= Math.min(reach, size - 1 - at); k++) sum += kernel[k + reach]!;
    return sum;
  });
}

/** Returns a scale for the values, cut off by half a percent at each end; null if there is no value. */
export function suitableScale(show: Exclude<Show, 'picture'>, values: Float32Array): Scale | null {
  // A sample of some ten thousand values is enough to find the ends.
  const stride = Math.max(1, Math.floor(values.length / 50_000));
  const some = stride === 1 ? values : values.filter((_, i) => i % stride === 0);
  if (show === 'difference') {
    const ends = spread(some.map(Math.abs), 0.005);
    return ends && { low: -(ends[1] || 1e-6), high: ends[1] || 1e-6, logarithmic: false };
  }
  const linear = show === 'samples' || show === 'depth' || show === 'throughput';
  const ends = spread(some, show === 'samples' ? 0 : 0.005, !linear);
  if (!ends) return null;
  if (show === 'samples') return { low: 0, high: Math.max(ends[1], 1), logarithmic: false };
  if (linear) return { low: ends[0], high: Math.max(ends[1], ends[0] * 1.01 + 1e-6), logarithmic: false };
  // Show at most six decades; darker values look black anyway.
  const high = ends[1];
  const low = Math.max(ends[0], high * 1e-6);
  return { low, high: high > low ? high : low * 1.01, logarithmic: true };
}

const TABLES = { viridis: lookup(viridis), diverging: lookup(diverging) };

/** Maps values to colors; returns 32-bit words of a canvas. */
export function paint(values: Float32Array, scale: Scale, colors: keyof typeof TABLES): Uint32Array<ArrayBuffer> {
  const table = TABLES[colors];
  const out = new Uint32Array(values.length);
  for (let i = 0; i < values.length; i++) {
    const t = place(scale, values[i]!);
    out[i] = Number.isNaN(t) ? NO_VALUE : table[t <= 0 ? 0 : t >= 1 ? 255 : Math.round(t * 255)]!;
  }
  return out;
}

export interface Summary {
  pixels: number;
  mean: number;
  low: number;
  high: number;
}

/**
 * Returns mean, minimum and maximum of the finite values.
 * - `chosen`: indices of the pixels that count; null: all pixels.
 */
export function summarize(values: Float32Array, chosen: Uint32Array | null = null): Summary | null {
  let [n, sum, low, high] = [0, 0, Infinity, -Infinity];
  const length = chosen?.length ?? values.length;
  for (let i = 0; i < length; i++) {
    const v = values[chosen ? chosen[i]! : i]!;
    if (v - v !== 0) continue;
    n++;
    sum += v;
    if (v < low) low = v;
    if (v > high) high = v;
  }
  return n ? { pixels: n, mean: sum / n, low, high } : null;
}

/** Returns a histogram: the centers of equal parts of a scale, and the number of pixels in each. */
export function histogram(
  values: Float32Array,
  scale: Scale,
  parts: number,
  chosen: Uint32Array | null = null,
): { middles: number[]; counts: number[] } {
  const counts = new Array<number>(parts).fill(0);
  const length = chosen?.length ?? values.length;
  for (let i = 0; i < length; i++) {
    const t = place(scale, values[chosen ? chosen[i]! : i]!);
    if (t >= 0 && t <= 1 + 1e-9) counts[Math.min(Math.floor(t * parts + 1e-9), parts - 1)]!++;
  }
  return { middles: counts.map((_, i) => valueAt(scale, (i + 0.5) / parts)), counts };
}
