/** Scales of values: where a value lies in 0..1, and what to write beside it. */

export interface Scale {
  low: number;
  high: number;
  logarithmic: boolean;
}

/** The place of a value, 0..1 within the scale; NaN of what has none. */
export function place({ low, high, logarithmic }: Scale, value: number): number {
  if (logarithmic) {
    if (!(value > 0)) return value <= 0 ? -1 : NaN;
    return high > low ? Math.log(value / low) / Math.log(high / low) : 0.5;
  }
  return high > low ? (value - low) / (high - low) : 0.5;
}

/** The value at a place. */
export function valueAt({ low, high, logarithmic }: Scale, t: number): number {
  return logarithmic ? low * (high / low) ** t : low + t * (high - low);
}

/** Round values within the scale, five or so: 1, 2, 5 times powers of ten. */
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

/** The lowest and highest of finite values after a share of each end is cut off; null where there are none. */
export function spread(values: Iterable<number>, cut = 0, positive = false): [number, number] | null {
  const kept = Float64Array.from([...values].filter((v) => Number.isFinite(v) && (!positive || v > 0))).sort();
  if (kept.length === 0) return null;
  const skip = Math.floor(cut * (kept.length - 1));
  return [kept[skip]!, kept[kept.length - 1 - skip]!];
}
