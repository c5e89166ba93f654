/** The density of selected paths over the pixels, as colors. */

import { hot, lookup, type Rgb } from '../color';
import { smooth } from '../picture';
import { place, spread, type Scale } from '../scale';
import type { Density } from './state.svelte';

/** `hot`: colors of a hot body. `over`: one color over the picture. `none`: the picture. */
export type DensityMode = 'hot' | 'over' | 'none';
export const MODES: readonly DensityMode[] = ['hot', 'over', 'none'];

/** Number of paths, or their luminance. */
export type Quantity = 'count' | 'light';

export const OVERLAY: Rgb = [0, 229, 200];
const DARK = 0xff1a1816;

/** Returns the density of all pixels, smoothed with a Gaussian of `sigma` pixels. */
export function spreadOut(density: Density, quantity: Quantity, [width, height]: readonly [number, number], sigma: number): Float32Array {
  const values = new Float32Array(width * height);
  density.pixel.forEach((pixel, i) => {
    if (pixel < values.length) values[pixel] = density[quantity][i]!;
  });
  return smooth(values, width, height, sigma);
}

/** Returns a scale for a density; null if no path is selected. Half a percent at the upper end is cut off. */
export function densityScale(values: Float32Array, logarithmic: boolean): Scale | null {
  const ends = spread(
    values.filter((v) => v > 0),
    values.length > 400 ? 0.005 : 0,
  );
  if (!ends) return null;
  const high = ends[1];
  if (!logarithmic) return { low: 0, high, logarithmic };
  const low = Math.max(Math.min(ends[0], high / 10), high / 1000);
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
  if (base && (mode === 'none' || (mode === 'over' && !scale))) return out.fill(0).map((_, i) => base[i]!);
  const [r, g, b] = OVERLAY;
  for (let i = 0; i < out.length; i++) {
    const v = values[i]!;
    // The least density is a visible color.
    const t = scale && v > 0 ? Math.min(Math.max(0.12 + 0.88 * place(scale, v), 0.12), 1) : 0;
    if (mode === 'hot') {
      out[i] = t > 0 ? HOT[Math.round(255 * t)]! : DARK;
      continue;
    }
    const under = base?.[i] ?? DARK;
    const alpha = t * opacity;
    const mix = (color: number, shift: number) => Math.round(color * alpha + ((under >>> shift) & 255) * (1 - alpha)) << shift;
    out[i] = 0xff000000 | mix(b, 16) | mix(g, 8) | mix(r, 0);
  }
  return out;
}

/** Color of a place on the scale, for the legend. */
export const legendColor =
  (mode: DensityMode) =>
  (t: number): Rgb => {
    const v = 0.12 + 0.88 * t;
    return mode === 'hot' ? hot(v) : [OVERLAY[0] * v + 26 * (1 - v), OVERLAY[1] * v + 26 * (1 - v), OVERLAY[2] * v + 26 * (1 - v)];
  };

