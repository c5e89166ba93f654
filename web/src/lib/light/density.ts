/** The density of selected paths over the pixels, as colors. */

import { autoExposure, hot, lookup, srgbByte, toneGain, type Rgb } from '../color';
import { smooth } from '../picture';
import type { Scale } from '../scale';
import type { Density } from './state.svelte';

/** `hot`: colors of a hot body. `over`: one color over the picture. `none`: the picture. */
export type DensityMode = 'hot' | 'over' | 'none';
export const MODES: readonly DensityMode[] = ['hot', 'over', 'none'];

/** Number of paths, or their luminance. */
export type Quantity = 'count' | 'light';

export const OVERLAY: Rgb = [0, 229, 200];
const DARK = 0xff1a1816;
/** Color number, of 256, of the least density. */
const LEAST = 31;

/** Returns the density of all pixels, smoothed with a Gaussian of `sigma` pixels. */
export function spreadOut(density: Density, quantity: Quantity, [width, height]: readonly [number, number], sigma: number): Float32Array {
  const values = new Float32Array(width * height);
  const amounts = density[quantity];
  density.pixel.forEach((pixel, i) => {
    if (pixel < values.length) values[pixel] = amounts[i]!;
  });
  return smooth(values, width, height, sigma);
}

/** Returns a scale for a density; null if no path is selected. Half a percent at the upper end is cut off. */
export function densityScale(values: Float32Array, logarithmic: boolean): Scale | null {
  let count = 0;
  for (let i = 0; i < values.length; i++) if (values[i]! > 0) count++;
  if (count === 0) return null;
  // A sample of some ten thousand pixels is enough to find the ends.
  const stride = Math.ceil(count / 20_000);
  const some = new Float32Array(Math.ceil(count / stride));
  let [seen, kept] = [0, 0];
  for (let i = 0; i < values.length; i++) if (values[i]! > 0 && seen++ % stride === 0) some[kept++] = values[i]!;
  some.sort();
  const cut = Math.floor((count > 400 ? 0.005 : 0) * (some.length - 1));
  const high = some[some.length - 1 - cut]!;
  if (!logarithmic) return { low: 0, high, logarithmic };
  const low = Math.max(Math.min(some[0]!, high / 10), high / 1000);
  return { low, high, logarithmic };
}

const HOT = lookup(hot);

/**
 * Returns the 32-bit words of a canvas.
 * - `base`: the picture; null if there is none.
 * - `opacity`: of the one color where the density is greatest.
 */
export function paintDensity(
  values: Float32Array,
  scale: Scale | null,
  mode: DensityMode,
  base: Uint32Array | null,
  opacity: number,
): Uint32Array<ArrayBuffer> {
  const out = new Uint32Array(values.length);
  if (base && (mode === 'none' || (mode === 'over' && !scale))) {
    out.set(base);
    return out;
  }
  const [r, g, b] = OVERLAY;
  const { low, high, logarithmic } = scale ?? { low: 0, high: 1, logarithmic: false };
  const factor = high > low ? (logarithmic ? 1 / Math.log(high / low) : 1 / (high - low)) : 0;
  const alphas = Float64Array.from({ length: 256 }, (_, i) => (i / 255) * opacity);
  for (let i = 0; i < out.length; i++) {
    const v = values[i]!;
    const under = base ? base[i]! : DARK;
    if (!(v > 0)) {
      out[i] = mode === 'hot' ? DARK : under;
      continue;
    }
    const t = logarithmic ? Math.log(v / low) * factor : (v - low) * factor;
    // The least density is a visible color.
    const step = t >= 1 || factor === 0 ? 255 : t <= 0 ? LEAST : Math.round(LEAST + (255 - LEAST) * t);
    if (mode === 'hot') {
      out[i] = HOT[step]!;
      continue;
    }
    const alpha = alphas[step]!;
    const rest = 1 - alpha;
    out[i] =
      0xff000000 |
      ((b * alpha + ((under >>> 16) & 255) * rest + 0.5) << 16) |
      ((g * alpha + ((under >>> 8) & 255) * rest + 0.5) << 8) |
      (r * alpha + (under & 255) * rest + 0.5);
  }
  return out;
}

/** Number of paths around a pixel that its luminance in a gray picture is estimated from. */
const ENOUGH_PATHS = 6;

/**
 * Returns a gray picture of the mean luminance of all recorded paths, for data without an image; 32-bit words of a canvas. Few paths
 * are smoothed.
 */
export function grayPicture(all: Density, film: readonly [number, number]): Uint32Array<ArrayBuffer> {
  const paths = all.count.reduce((sum, n) => sum + n, 0);
  const byPixel = paths / Math.max(film[0] * film[1], 1);
  // A Gaussian covers about 4 pi sigma^2 pixels.
  const sigma = byPixel < ENOUGH_PATHS ? Math.min(Math.sqrt(ENOUGH_PATHS / (byPixel * 4 * Math.PI)), 6) : 0;
  const counts = spreadOut(all, 'count', film, sigma);
  const sums = all.luminance ? { ...all, light: all.luminance.map((y, i) => y * all.count[i]!) } : all;
  const luminances = spreadOut(sums, 'light', film, sigma).map((sum, i) => (counts[i]! > 0 ? sum / counts[i]! : 0));
  const exposure = autoExposure(luminances);
  const out = new Uint32Array(luminances.length);
  luminances.forEach((y, i) => {
    const exposed = Math.max(y * exposure, 0);
    const byte = srgbByte(exposed * toneGain(exposed));
    out[i] = 0xff000000 | (byte << 16) | (byte << 8) | byte;
  });
  return out;
}

/** Color of a place on the scale, for the legend. */
export const legendColor =
  (mode: DensityMode) =>
  (t: number): Rgb => {
    const v = 0.12 + 0.88 * t;
    return mode === 'hot' ? hot(v) : [OVERLAY[0] * v + 26 * (1 - v), OVERLAY[1] * v + 26 * (1 - v), OVERLAY[2] * v + 26 * (1 - v)];
  };

