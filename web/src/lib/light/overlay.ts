/** Densities of selected paths as colors: of a hot body, or in one color for each data set over a picture. */

import { hot, lookup, type Rgb } from '../color';
import type { Scale } from '../scale';
import { densityScale } from './density';

/** `over`: one color over the picture. `hot`: colors of a hot body. `none`: the picture. */
export type DensityMode = 'over' | 'hot' | 'none';
export const MODES: readonly DensityMode[] = ['over', 'hot', 'none'];

/** Colors of a density: over a picture, over a map, and of the data sets A and B. */
export const OVER_PICTURE: Rgb = [0, 229, 200];
export const OVER_MAP: Rgb = [255, 64, 190];
export const OVER_SETS: readonly [Rgb, Rgb] = [
  [245, 48, 52],
  [48, 118, 255],
];

/** Color of a pixel without picture and density, as the word of a canvas. */
export const DARK = 0xff1a1816;
/** Strength, of 255, of the least density, which is visible. */
const LEAST = 31;

/** A density over the pixels, and its color. */
export interface Layer {
  values: Float32Array;
  color: Rgb;
}

/** Returns one scale for all densities; null if no path is selected. */
export function commonScale(all: readonly Float32Array[], logarithmic: boolean): Scale | null {
  if (all.length === 1) return densityScale(all[0]!, logarithmic);
  const pool = new Float32Array(all.reduce((sum, it) => sum + it.length, 0));
  let at = 0;
  for (const values of all) {
    pool.set(values, at);
    at += values.length;
  }
  return densityScale(pool, logarithmic);
}

/** Returns a function that returns the strength of a density, 1 to 255; 0: no density. */
function strengthOf({ low, high, logarithmic }: Scale): (value: number) => number {
  const factor = high > low ? (logarithmic ? 1 / Math.log(high / low) : 1 / (high - low)) : Infinity;
  return (value) => {
    if (!(value > 0)) return 0;
    if (factor === Infinity) return 255;
    const t = logarithmic ? Math.log(value / low) * factor : (value - low) * factor;
    return t >= 1 ? 255 : t <= 0 ? LEAST : Math.round(LEAST + (255 - LEAST) * t);
  };
}

const HOT = lookup(hot);

/** Returns a density in the colors of a hot body; 32-bit words of a canvas. */
export function paintHot(values: Float32Array, scale: Scale): Uint32Array<ArrayBuffer> {
  const strength = strengthOf(scale);
  return Uint32Array.from(values, (value) => (value > 0 ? HOT[strength(value)]! : DARK));
}

/**
 * Returns densities over a picture; 32-bit words of a canvas. The order of the layers does not matter.
 * - `opacity`: of the greatest density.
 */
export function paintOver(
  layers: readonly Layer[],
  scale: Scale,
  base: Uint32Array,
  opacity: number,
): Uint32Array<ArrayBuffer> {
  const out = new Uint32Array(base);
  const strength = strengthOf(scale);
  for (let i = 0; i < out.length; i++) {
    let [sum, rest, r, g, b] = [0, 1, 0, 0, 0];
    for (const { values, color } of layers) {
      const alpha = (strength(values[i]!) / 255) * opacity;
      sum += alpha;
      rest *= 1 - alpha;
      r += alpha * color[0];
      g += alpha * color[1];
      b += alpha * color[2];
    }
    if (sum === 0) continue;
    const [under, share] = [out[i]!, (1 - rest) / sum];
    out[i] =
      0xff000000 |
      ((b * share + ((under >>> 16) & 255) * rest + 0.5) << 16) |
      ((g * share + ((under >>> 8) & 255) * rest + 0.5) << 8) |
      (r * share + (under & 255) * rest + 0.5);
  }
  return out;
}

/** Returns the colors of a legend: of a hot body, or of one color over a dark picture. */
export const legendColor =
  (color: Rgb | 'hot') =>
  (t: number): Rgb => {
    const v = (LEAST + (255 - LEAST) * t) / 255;
    if (color === 'hot') return hot(v);
    const [r, g, b] = color.map((c) => c * v + 26 * (1 - v));
    return [r!, g!, b!];
  };
