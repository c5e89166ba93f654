/** Confidence intervals from Student's distribution, as in engine/film/src/convergence.rs. */

const Z = 1.959963984540054;

/**
 * Returns the 97.5 % quantile: half the width of a 95 % interval, in standard errors. For 1 and 2 degrees of freedom
 * it has a closed form. From 3 on, the expansion about the normal quantile is used (Abramowitz and Stegun, 26.7.5),
 * within 1 %.
 */
export function student95(freedom: number): number {
  if (!(freedom >= 1)) return NaN;
  if (freedom < 2.5) return freedom < 1.5 ? 12.706205 : 4.302653;
  const terms = [
    (Z ** 3 + Z) / 4,
    (5 * Z ** 5 + 16 * Z ** 3 + 3 * Z) / 96,
    (3 * Z ** 7 + 19 * Z ** 5 + 17 * Z ** 3 - 15 * Z) / 384,
  ];
  return terms.reduceRight((rest, term) => (rest + term) / freedom, 0) + Z;
}

/** Range of a luminance, not negative: from, to. */
export type Interval = readonly [number, number];

/**
 * Returns the interval that contains the true luminance of a pixel in about 95 of 100 pixels.
 * - `standardError`: standard error of the pixel, relative to `luminance`.
 */
export function interval95(luminance: number, standardError: number, freedom: number): Interval {
  const half = luminance * standardError * student95(freedom);
  return [Math.max(0, luminance - half), luminance + half];
}
