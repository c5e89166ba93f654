/** Made-up paths with the axes, bins and joint histograms of the wire. */
import type { Axis, PlotSet, ScaleName } from '../../../src/lib/light/plot/contract';

const NAMES = ['room.wall', 'room.floor', 'room.ceiling', 'table.top', 'table.leg', 'lamp.shade', 'window.frame', 'chair', 'vase', 'book.12', 'curtain'];
const LIGHTS = ['lamp', 'sky', 'window.sun', 'screen'];
const ENDS = ['escaped', 'absorbed', 'roulette', 'light', 'limit'];
const KINDS = ['diffuse', 'glossy', 'mirror', 'glass', 'volume'];

const octaves = (base: number, per: number) =>
  Array.from({ length: 64 }, (_, k) => (k < 2 ? 0 : 2 ** ((k - base) / per)));
const RADIANCE = octaves(22, 2);
const THROUGHPUT = octaves(49, 4);
const FILM = [960, 540];
const BOX: [number, number] = [-4, 4];

const axis = (name: string, scale: ScaleName, more: Partial<Axis> = {}): Omit<Axis, 'index'> => ({
  name,
  scale,
  edges: scale === 'radiance' ? RADIANCE : scale === 'throughput' ? THROUGHPUT : null,
  extent: scale === 'world' ? BOX : null,
  categories: null,
  ...more,
});
const words = (name: string, list: string[], scale: ScaleName = 'class') => axis(name, scale, { categories: ['none', ...list] });

export const AXES: Axis[] = [
  axis('pixel.x', 'film', { extent: [0, FILM[0]!] }),
  axis('pixel.y', 'film', { extent: [0, FILM[1]!] }),
  axis('radiance.r', 'radiance'),
  axis('radiance.g', 'radiance'),
  axis('radiance.b', 'radiance'),
  axis('throughput.r', 'throughput'),
  axis('throughput.g', 'throughput'),
  axis('throughput.b', 'throughput'),
  axis('depth', 'count'),
  words('end', ENDS),
  axis('first.x', 'world'),
  axis('first.y', 'world'),
  axis('first.z', 'world'),
  words('first.interaction', KINDS),
  words('first.object', NAMES, 'name'),
  axis('last.x', 'world'),
  axis('last.y', 'world'),
  axis('last.z', 'world'),
  axis('light.radiance', 'radiance'),
  words('light', LIGHTS, 'name'),
].map((it, index) => ({ ...it, index }));

function generator(seed: number) {
  let state = seed;
  const next = () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
  return { next, normal: () => Math.sqrt(-2 * Math.log(1 - next())) * Math.cos(2 * Math.PI * next()) };
}

export function binOf({ scale, extent, edges }: Axis, v: number): number {
  if (edges) return v > 0 ? Math.max(1, edges.findLastIndex((edge) => v >= edge)) : 0;
  if (scale === 'film') return Math.floor((v * 64) / extent![1]);
  if (scale === 'world')
    return Number.isNaN(v) ? 0 : 1 + Math.min(62, Math.max(0, Math.floor((63 * (v - extent![0])) / (extent![1] - extent![0]))));
  return Math.min(v, 63);
}

export interface MadeSet extends PlotSet {
  /** Returns the counts of the rows of a mask. */
  count(mask: Uint8Array | null): Float64Array[];
}

export function makeSet(rows: number, seed: number, shift = 0): MadeSet {
  const { next, normal } = generator(seed);
  const values = AXES.map(() => new Float32Array(rows));
  for (let i = 0; i < rows; i++) {
    const [x, y] = [Math.floor(next() * FILM[0]!), Math.floor(next() * FILM[1]!)];
    const depth = 1 + Math.min(20, Math.floor(-Math.log(1 - next()) * (2.4 + shift)));
    const escaped = next() < 0.12;
    const isLit = !escaped && next() < 0.82;
    const light = !isLit ? 0 : next() < 0.6 - 0.2 * shift ? 1 : next() < 0.6 ? 2 : next() < 0.8 ? 3 : 4;
    const power = isLit ? 2 ** (5 + 3 * normal() - depth + (light === 3 ? 7 : 0)) : 0;
    const factor = 2 ** (-0.7 * depth + 0.6 * normal());
    const wall = next();
    const object = escaped ? 0 : 1 + Math.floor(NAMES.length * wall ** 2.2);
    const at = [(x / FILM[0]!) * 7 - 3.5, (1 - y / FILM[1]!) * 6 - 3, wall * 4 - 2 + 0.3 * normal()];
    const last = at.map((v) => v + (depth > 1 ? 1.3 * normal() : 0));
    const row = [
      x,
      y,
      power * 1.1,
      power * 0.9 * (1 + 0.1 * normal()),
      power * (light === 2 ? 1.6 : 0.4),
      factor,
      factor * 0.9 * 2 ** (0.2 * normal()),
      factor * 0.7 * 2 ** (0.3 * normal()),
      depth,
      escaped ? 1 : isLit ? 4 : next() < 0.5 ? 2 : 3,
      ...at.map((v) => (escaped ? NaN : v)),
      escaped ? 0 : 1 + Math.floor(5 * next() ** (2 + shift)),
      object,
      ...last.map((v) => (escaped ? NaN : v)),
      power * 2 ** (depth / 2),
      light,
    ];
    row.forEach((v, k) => (values[k]![i] = v));
  }
  const of = values.map((column, i) => Uint8Array.from(column, (v) => binOf(AXES[i]!, v)));
  const count = (mask: Uint8Array | null) =>
    of.map((column) => {
      const list = new Float64Array(64);
      for (let i = 0; i < rows; i++) if (!mask || mask[i]) list[column[i]!]!++;
      return list;
    });
  const pairs = new Map<string, Float32Array>();
  return {
    values,
    rows,
    selected: null,
    bins: count(null),
    count,
    selectedBins: null,
    total: rows,
    selectedTotal: rows,
    basis: 'recorded',
    pair(a, b) {
      const key = `${a} ${b}`;
      let counts = pairs.get(key);
      if (!counts) {
        counts = new Float32Array(64 * 64);
        for (let i = 0; i < rows; i++) counts[64 * of[a]![i]! + of[b]![i]!]!++;
        pairs.set(key, counts);
      }
      return counts;
    },
  };
}

/** Returns made-up sets with the joint histograms of the first order of axes. */
export function prepare(rows: number, sets: number): MadeSet[] {
  const data = Array.from({ length: sets }, (_, i) => makeSet(rows, 7 + i, 0.8 * i));
  for (let i = 0; i + 1 < AXES.length; i++) for (const set of data) set.pair(i, i + 1);
  return data;
}
