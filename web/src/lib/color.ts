/**
 * Colors: the palette of Okabe and Ito for categories, viridis for measured values, blue-white-red for differences,
 * and the farm's own tone curve (engine/film/src/tone.rs) for pictures.
 */

/** Okabe and Ito, "Color Universal Design" (2008). */
export const OKABE_ITO = [
  '#0072B2',
  '#E69F00',
  '#009E73',
  '#CC79A7',
  '#56B4E9',
  '#D55E00',
  '#F0E442',
  '#999999',
] as const;

export type Rgb = readonly [number, number, number];

// Sixteen evenly spaced colors of viridis (matplotlib, CC0). The colors between them are interpolated linearly,
// within 2/255 of the original.
const VIRIDIS_STOPS: readonly Rgb[] = [
  [68, 1, 84],
  [72, 26, 108],
  [71, 47, 125],
  [65, 68, 135],
  [57, 86, 140],
  [49, 104, 142],
  [42, 120, 142],
  [35, 136, 142],
  [31, 152, 139],
  [34, 168, 132],
  [53, 183, 121],
  [84, 197, 104],
  [122, 209, 81],
  [165, 219, 54],
  [210, 226, 27],
  [253, 231, 37],
];

// Symmetric about gray-white; lightness falls toward both sides (after Brewer's RdBu; Apache 2.0).
const DIVERGING_STOPS: readonly Rgb[] = [
  [5, 48, 97],
  [33, 102, 172],
  [67, 147, 195],
  [146, 197, 222],
  [209, 229, 240],
  [247, 247, 247],
  [253, 219, 199],
  [244, 165, 130],
  [214, 96, 77],
  [178, 24, 43],
  [103, 0, 31],
];

// Hot body: black over red and yellow to white; lightness rises throughout.
const HOT_STOPS: readonly Rgb[] = [
  [11, 0, 0],
  [92, 0, 0],
  [173, 0, 0],
  [255, 0, 0],
  [255, 81, 0],
  [255, 162, 0],
  [255, 243, 0],
  [255, 255, 110],
  [255, 255, 255],
];

function along(stops: readonly Rgb[], t: number): Rgb {
  if (Number.isNaN(t)) return [255, 0, 255];
  const place = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
  const i = Math.min(Math.floor(place), stops.length - 2);
  const [a, b, f] = [stops[i]!, stops[i + 1]!, place - i];
  return [a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2])];
}

/** Returns the viridis color at `t` in 0..1 in bytes; magenta for NaN. */
export const viridis = (t: number): Rgb => along(VIRIDIS_STOPS, t);

/** Returns a color from blue (0) over white (0.5) to red (1) in bytes; magenta for NaN. */
export const diverging = (t: number): Rgb => along(DIVERGING_STOPS, t);

/** Returns the color of a hot body at `t` in 0..1 in bytes, from black to white; magenta for NaN. */
export const hot = (t: number): Rgb => along(HOT_STOPS, t);

export const css = ([r, g, b]: Rgb): string => `rgb(${Math.round(r)} ${Math.round(g)} ${Math.round(b)})`;

/** Returns 256 colors as the 32-bit words of a canvas (little-endian RGBA). */
export function lookup(map: (t: number) => Rgb): Uint32Array {
  return Uint32Array.from({ length: 256 }, (_, i) => {
    const [r, g, b] = map(i / 255);
    return (255 << 24) | (Math.round(b) << 16) | (Math.round(g) << 8) | Math.round(r);
  });
}

/** Luminance that is shown as white, in units of 1 / exposure. */
const WHITE = 8;
const MIDDLE_GRAY = 0.18;
const DARKEST = 1e-4;

/** Returns the Rec.709 luminance of a linear color. */
export const luminance = (r: number, g: number, b: number): number => 0.2126 * r + 0.7152 * g + 0.0722 * b;

/** Applies the transfer function of sRGB to `linear` in 0..1. */
export function srgb(linear: number): number {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055;
}

/**
 * Returns the exposure, 1/(cd/m2), that maps the log-average luminance to middle gray, as in `femc render --preview`.
 * - `y`: luminances, cd/m2; those that are not finite or not positive do not count.
 */
export function autoExposure(y: ArrayLike<number>): number {
  let [n, sum] = [0, 0];
  for (let i = 0; i < y.length; i++) {
    const v = y[i]!;
    if (v > 0 && v < Infinity) {
      n++;
      sum += v;
    }
  }
  if (n === 0) return 1;
  const least = (DARKEST * sum) / n;
  let logs = 0;
  for (let i = 0; i < y.length; i++) {
    const v = y[i]!;
    if (v > 0 && v < Infinity) logs += Math.log(Math.max(v, least));
  }
  return MIDDLE_GRAY / Math.exp(logs / n);
}

const SRGB_STEPS = 4096;
let srgbTable: Uint8Array | undefined;

/** Returns the sRGB byte of `linear` from a table, within one step of the formula. */
export function srgbByte(linear: number): number {
  if (!srgbTable) {
    srgbTable = new Uint8Array(SRGB_STEPS + 1);
    // The table is indexed by the square root, so that dark values have a resolution that suits the eye.
    for (let i = 0; i <= SRGB_STEPS; i++) srgbTable[i] = Math.round(255 * srgb((i / SRGB_STEPS) ** 2));
  }
  if (!(linear > 0)) return 0;
  return srgbTable[linear >= 1 ? SRGB_STEPS : Math.round(SRGB_STEPS * Math.sqrt(linear))]!;
}

/** Returns the gain of the photographic operator at luminance `x`, in units of 1 / exposure. */
export const toneGain = (x: number): number => (x < 1e18 ? (1 + x / (WHITE * WHITE)) / (1 + x) : 1);
