/** Scales of values: the position of a value in 0..1, and the labels beside it. */

export interface Scale {
  low: number;
  high: number;
  logarithmic: boolean;
}

/** Returns the position of a value in 0..1 within the scale; NaN for a value without a position. */
export function place({ low, high, logarithmic }: Scale, value: number): number {
  if (logarithmic) {
    if (!(value > 0)) return value <= 0 ? -1 : NaN;
    return high > low ? Math.log(value / low) / Math.log(high / low) : 0.5;
  }
  return high > low ? (value - low) / (high - low) : 0.5;
}

/** Returns the value at a position. */
export function valueAt({ low, high, logarithmic }: Scale, t: number): number {
  return logarithmic ? low * (high / low) ** t : low + t * (high - low);
}

/** Returns about `wanted` round values within the scale: 1, 2, 5 times powers of ten. */
export function ticks(scale: Scale, wanted = 5): number[] {
  const { low, high, logarithmic } = scale;
  if (!(high > low)) return [low];
  const out: number[] = [];
  if (logarithmic) {
    const decades = Math.log10(high / low);
    const steps = decades > wanted ? [1] : decades > wanted / 2 ? [1, 3] : [1, 2, 5];
    const stride = Math.max(1, Math.floor(decades / wanted));
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e += steps.length === 1 ? stride : 1) {
      for (const step of steps) {
        const tick = step * 10 ** e;
        if (tick >= low * 0.999 && tick <= high * 1.001) out.push(tick);
      }
    }
    if (out.length >= 2) return out;
    out.length = 0;
  }
  const rough = (high - low) / wanted;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((s) => s * power).find((s) => s >= rough)!;
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high * (1 + 1e-12) + 1e-300; i++) out.push(i * step);
  return out;
}

/** Returns the lowest and highest finite value after a share of each end is cut off; null if there is none. */
export function spread(values: Iterable<number>, cut = 0, positive = false): [number, number] | null {
  const kept = Float64Array.from([...values].filter((v) => Number.isFinite(v) && (!positive || v > 0))).sort();
  if (kept.length === 0) return null;
  const skip = Math.floor(cut * (kept.length - 1));
  return [kept[skip]!, kept[kept.length - 1 - skip]!];
}
