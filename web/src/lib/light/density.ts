/** The density of selected paths over the pixels. */

import type { Scale } from '../scale';
import type { Density } from './state.svelte';

/** Number of paths, or their luminance. */
export type Quantity = 'count' | 'light';

/**
 * Returns the density of all pixels, smoothed with a Gaussian of `sigma` pixels: the result of `smooth` in picture.ts, faster because most pixels
 * have no selected path.
 */
export function spreadOut(density: Density, quantity: Quantity, [width, height]: readonly [number, number], sigma: number): Float32Array {
  const values = new Float32Array(width * height);
  const amounts = density[quantity];
  if (!(sigma > 0)) {
    density.pixel.forEach((pixel, i) => {
      if (pixel < values.length) values[pixel] = amounts[i]!;
    });
    return values;
  }
  const reach = Math.ceil(3 * sigma);
  const kernel = Float64Array.from({ length: 2 * reach + 1 }, (_, i) => Math.exp(-((i - reach) ** 2) / (2 * sigma * sigma)));
  // Along the rows, from the pixels with paths only.
  const rows = new Float32Array(values.length);
  const isUsed = new Uint8Array(height);
  for (let i = 0; i < density.pixel.length; i++) {
    const pixel = density.pixel[i]!;
    if (pixel >= values.length) continue;
    const y = Math.floor(pixel / width);
    const x = pixel - y * width;
    isUsed[y] = 1;
    for (let to = Math.max(0, x - reach); to <= Math.min(width - 1, x + reach); to++) {
      rows[y * width + to]! += amounts[i]! * kernel[to - x + reach]!;
    }
  }
  const [across, down] = [width, height].map((size) => inverseWeights(size, kernel, reach)) as [Float64Array, Float64Array];
  for (let y = 0; y < height; y++) {
    for (let from = Math.max(0, y - reach); from <= Math.min(height - 1, y + reach); from++) {
      if (!isUsed[from]) continue;
      const weight = kernel[from - y + reach]! * down[y]!;
      const [to, at] = [y * width, from * width];
      for (let x = 0; x < width; x++) values[to + x]! += weight * rows[at + x]!;
    }
    for (let x = 0; x < width; x++) values[y * width + x]! *= across[x]!;
  }
  return values;
}

/** Returns one over the part of the kernel that lies within the film, for each place. */
function inverseWeights(size: number, kernel: Float64Array, reach: number): Float64Array {
  return Float64Array.from({ length: size }, (_, at) => {
    let sum = 0;
    for (let k = Math.max(-reach, -at); k <= Math.min(reach, size - 1 - at); k++) sum += kernel[k + reach]!;
    return 1 / sum;
  });
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
