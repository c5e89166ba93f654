/** Colors of the sets of a plot: red for A, gray for equal shares, blue for B. */

type Rgb = readonly [number, number, number];

/** Colors of a plot, in bytes, for a light or a dark page. */
export interface Palette {
  /** Set A of two. */
  a: Rgb;
  /** Equal shares. */
  equal: Rgb;
  /** Set B of two. */
  b: Rgb;
  /** A single set. */
  single: Rgb;
  /** Records outside the selection. */
  rest: Rgb;
  /** Tone toward which the color of many lines goes. */
  deep: Rgb;
  /** Bars of a single set. */
  bar: Rgb;
  /** Background. */
  panel: Rgb;
}

export const LIGHT: Palette = {
  a: [200, 30, 40],
  equal: [128, 132, 140],
  b: [20, 92, 190],
  single: [0, 95, 153],
  rest: [138, 147, 160],
  deep: [0, 16, 48],
  bar: [74, 86, 104],
  panel: [255, 255, 255],
};

export const DARK: Palette = {
  a: [255, 96, 88],
  equal: [140, 146, 155],
  b: [84, 160, 255],
  single: [108, 189, 240],
  rest: [120, 131, 145],
  deep: [255, 255, 255],
  bar: [176, 188, 204],
  panel: [22, 29, 38],
};

/** Returns (h1 - h2) / (h1 + h2); 0 if there is neither. */
export const ratio = (h1: number, h2: number): number => (h1 + h2 > 0 ? (h1 - h2) / (h1 + h2) : 0);

/** Returns the color of two normalized counts: red if only the first has records, blue if only the second has. */
export function ratioColor(h1: number, h2: number, palette: Palette = LIGHT): Rgb {
  const t = ratio(h1, h2);
  const end = t < 0 ? palette.b : palette.a;
  const part = Math.abs(t);
  const mix = (i: number) => Math.round(palette.equal[i]! + (end[i]! - palette.equal[i]!) * part);
  return [mix(0), mix(1), mix(2)];
}
