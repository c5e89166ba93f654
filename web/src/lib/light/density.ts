/** The density of selected paths over the pixels. */

import { smooth } from '../picture';
import type { Scale } from '../scale';
import type { Density } from './state.svelte';

/** Number of paths, or their luminance. */
export type Quantity = 'count' | 'light';

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
