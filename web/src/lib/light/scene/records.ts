/** Recorded light in space: intersections as points, paths as moving segments, light records as rays, and voxels. */

import { hot, viridis, type Rgb } from '../../color';
import { place, spread, type Scale } from '../../scale';
import { NONE, type Corners, type Schema } from '../api';
import type { PerTable, Rows } from '../data';
import { transform, type Geometry, type SceneObject, type Vec3 } from './glb';

export type Coloring = 'energy' | 'bounce';
export const COLORINGS: readonly Coloring[] = ['energy', 'bounce'];

/** Points and their colors; positions relative to the origin. */
export interface Points {
  positions: Float32Array;
  /** Red, green, blue, and the size. */
  colors: Uint8Array;
  /** Row of each point in the table of intersections. */
  rows: Uint32Array;
}

/** Line segments. A segment is visible while the moving window of its path is over it. */
export interface Segments {
  from: Float32Array;
  to: Float32Array;
  /** Length along the path at both ends, m. */
  span: Float32Array;
  colors: Uint8Array;
  count: number;
}

/** Columns of the records that the scene view reads. */
export interface Records {
  position: readonly [Float32Array, Float32Array, Float32Array];
  /** Mean of red, green and blue: as in the voxels. */
  energy: Float32Array;
  bounce: Float32Array;
  /** Value of the name axis: 0, or 1 + the number of the name. */
  object: Float32Array;
  material: Float32Array;
  path: Uint32Array;
  parent: Uint32Array;
  /** Energy of the samples. */
  pathEnergy: Float32Array;
  light: { path: Uint32Array; intersection: Uint32Array; lamp: Float32Array; occluder: Float32Array; found: Float32Array };
  names: readonly string[];
  /** Kind of each name: object, material or light. */
  kinds: readonly string[];
  /** Numbers of the words of `found` for which a point on a lamp was sampled. */
  sampled: ReadonlySet<number>;
}

function column(schema: Schema, rows: Rows, table: keyof PerTable<unknown>, name: string): Float32Array {
  const at = schema.tables[table].findIndex((axis) => axis.name === name);
  const values = rows.values[table][at];
  if (!values) throw new Error(`the recorded light has no attribute ${name}`);
  return values;
}

function energyOf(schema: Schema, rows: Rows, table: 'paths' | 'intersections'): Float32Array {
  const [r, g, b] = ['r', 'g', 'b'].map((c) => column(schema, rows, table, `radiance.${c}`));
  return r!.map((red, i) => (red + g![i]! + b![i]!) / 3);
}

export function recordsOf(schema: Schema, rows: Rows): Records {
  const of = (name: string) => column(schema, rows, 'intersections', name);
  const light = (name: string) => column(schema, rows, 'lights', name);
  const words = schema.tables.lights.find((axis) => axis.name === 'found')?.words ?? [];
  return {
    position: [of('position.x'), of('position.y'), of('position.z')],
    energy: energyOf(schema, rows, 'intersections'),
    bounce: of('bounce'),
    object: of('object'),
    material: of('material'),
    path: rows.links.intersectionPath,
    parent: rows.links.intersectionParent,
    pathEnergy: energyOf(schema, rows, 'paths'),
    light: {
      path: rows.links.lightPath,
      intersection: rows.links.lightIntersection,
      lamp: light('light'),
      occluder: light('occluder'),
      found: light('found'),
    },
    names: schema.names,
    kinds: schema.kinds,
    sampled: new Set(words.flatMap((word, i) => (word === 'surface' || word === 'airlight' ? [i + 1] : []))),
  };
}

/** Returns the name of the object of an intersection; null: none. */
export const objectAt = (records: Records, row: number): string | null =>
  records.names[records.object[row]! - 1] ?? null;

/** Smallest energy of a scale, as a share of the largest one: fog and Russian roulette leave paths with far less. */
const LEAST_SHARE = 1e-5;

/** Returns the scale of energies: logarithmic, at most five powers of ten, without half a percent at each end. */
export function energyScale(values: Iterable<number>): Scale {
  const [low, high] = spread(values, 0.005, true) ?? [1, 1];
  return { low: Math.max(low, LEAST_SHARE * high), high, logarithmic: true };
}

/** Colors begin above black, which marks hidden rays. */
export const energyColor = (t: number): Rgb => hot(0.16 + 0.84 * Math.min(Math.max(t, 0), 1));
const MOST_BOUNCES = 12;

export function bounceScale(bounces: Float32Array): Scale {
  let high = 1;
  for (const bounce of bounces) if (bounce > high) high = bounce;
  return { low: 0, high: Math.min(high, MOST_BOUNCES), logarithmic: false };
}

export const colorOf = (coloring: Coloring): ((t: number) => Rgb) => (coloring === 'energy' ? energyColor : viridis);

const STEPS = 255;
/** Colors of records. */
export interface Paint {
  coloring: Coloring;
  /** Returns the color of a value. */
  color: (value: number) => Rgb;
  /** Size of points and width of lines, of 255. */
  size: number;
}

/** Returns the colors of a scale. */
export function scalePaint(scale: Scale, coloring: Coloring): Paint {
  const table = Array.from({ length: STEPS + 1 }, (_, i) => colorOf(coloring)(i / STEPS));
  return {
    coloring,
    size: 255,
    color: (value) => {
      const t = place(scale, value);
      return table[t > 0 ? Math.round(Math.min(t, 1) * STEPS) : 0]!;
    },
  };
}

/** Returns one color for all records, such as those of a data set. Smaller ones are visible over equal ones. */
export const plainPaint = (color: Rgb, size = 255): Paint => ({ coloring: 'energy', color: () => color, size });

function write([r, g, b]: Rgb, size: number, into: Uint8Array, at: number) {
  into[at] = r;
  into[at + 1] = g;
  into[at + 2] = b;
  into[at + 3] = size;
}

/**
 * Returns intersections as points.
 * - `isShown`: rows to show.
 */
export function pointsOf(
  records: Records,
  { coloring, color, size }: Paint,
  origin: Vec3,
  isShown: (row: number) => boolean,
): Points {
  const total = records.energy.length;
  const rows = new Uint32Array(total);
  let count = 0;
  for (let row = 0; row < total; row++) if (isShown(row)) rows[count++] = row;
  const positions = new Float32Array(3 * count);
  const colors = new Uint8Array(4 * count);
  const values = coloring === 'energy' ? records.energy : records.bounce;
  for (let i = 0; i < count; i++) {
    const row = rows[i]!;
    for (let k = 0; k < 3; k++) positions[3 * i + k] = records.position[k]![row]! - origin[k]!;
    write(color(values[row]!), size, colors, 4 * i);
  }
  return { positions, colors, rows: rows.slice(0, count) };
}

/** Returns at most `most` of the paths, evenly spread over them. */
export function sparse(paths: readonly number[], most: number): number[] {
  if (paths.length <= most) return [...paths];
  return Array.from({ length: most }, (_, i) => paths[Math.floor((i * paths.length) / most)]!);
}

class SegmentList implements Segments {
  from: Float32Array;
  to: Float32Array;
  span: Float32Array;
  colors: Uint8Array;
  count = 0;
  constructor(capacity: number) {
    this.from = new Float32Array(3 * capacity);
    this.to = new Float32Array(3 * capacity);
    this.span = new Float32Array(2 * capacity);
    this.colors = new Uint8Array(4 * capacity);
  }
  add(from: Vec3, to: Vec3, begin: number, end: number) {
    this.from.set(from, 3 * this.count);
    this.to.set(to, 3 * this.count);
    this.span[2 * this.count] = begin;
    this.span[2 * this.count + 1] = end;
    return this.count++;
  }
}

/** Share of the paths that end within the length of the animation. A few paths may be far longer than all others. */
const ENDED_SHARE = 0.95;

/** Paths as segments. */
export interface PathSegments extends Segments {
  /** Length within which 95 % of the paths end, m. */
  length: number;
}

/**
 * Returns paths as segments with the length along the path.
 * - `paths`: rows of the paths to show.
 * - `camera`: position of the camera in coordinates of the scene; null: paths begin at their first intersection.
 * - `withLight`: from the end of a path to the camera, as the light travels.
 */
export function segmentsOf(
  records: Records,
  paths: readonly number[],
  { paint: { coloring, color, size }, origin, camera, withLight }: {
    paint: Paint;
    origin: Vec3;
    camera: Vec3 | null;
    withLight: boolean;
  },
): PathSegments {
  const shown = new Set(paths);
  const { path, parent, position } = records;
  const total = path.length;
  let capacity = 0;
  for (let row = 0; row < total; row++) if (shown.has(path[row]!)) capacity++;
  const list = new SegmentList(capacity);
  const reached = new Float32Array(total);
  const whole = new Map<number, number>();
  const at = (row: number): Vec3 => [
    position[0][row]! - origin[0],
    position[1][row]! - origin[1],
    position[2][row]! - origin[2],
  ];
  const start: Vec3 | null = camera && [camera[0] - origin[0], camera[1] - origin[1], camera[2] - origin[2]];
  const owners: number[] = [];
  for (let row = 0; row < total; row++) {
    const owner = path[row]!;
    if (!shown.has(owner)) continue;
    const before = parent[row]!;
    const from = before === NONE ? start : at(before);
    if (!from) continue;
    const to = at(row);
    const begin = before === NONE ? 0 : reached[before]!;
    const end = begin + Math.hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    reached[row] = end;
    if (end > (whole.get(owner) ?? 0)) whole.set(owner, end);
    const i = list.add(from, to, begin, end);
    owners.push(owner);
    write(color(coloring === 'energy' ? records.pathEnergy[owner]! : records.bounce[row]!), size, list.colors, 4 * i);
  }
  const lengths = Float64Array.from(whole.values()).sort();
  const length = lengths[Math.ceil(ENDED_SHARE * lengths.length) - 1] ?? 0;
  if (withLight) {
    for (let i = 0; i < list.count; i++) {
      const all = whole.get(owners[i]!)!;
      const [begin, end] = [list.span[2 * i]!, list.span[2 * i + 1]!];
      list.span[2 * i] = all - end;
      list.span[2 * i + 1] = all - begin;
      const from = list.from.slice(3 * i, 3 * i + 3);
      list.from.set(list.to.subarray(3 * i, 3 * i + 3), 3 * i);
      list.to.set(from, 3 * i);
    }
  }
  return { from: list.from, to: list.to, span: list.span, colors: list.colors, count: list.count, length };
}

function joined<T extends Float32Array | Uint8Array | Uint32Array>(a: T, b: T): T {
  const out = new (a.constructor as new (length: number) => T)(a.length + b.length);
  out.set(a);
  out.set(b, a.length);
  return out;
}

/** Returns the points of two data sets. The rows are those of their own sets. */
export const joinPoints = (a: Points, b: Points): Points => ({
  positions: joined(a.positions, b.positions),
  colors: joined(a.colors, b.colors),
  rows: joined(a.rows, b.rows),
});

/** Returns the paths of two data sets. */
export const joinPaths = (a: PathSegments, b: PathSegments): PathSegments => ({
  from: joined(a.from.subarray(0, 3 * a.count), b.from),
  to: joined(a.to.subarray(0, 3 * a.count), b.to),
  span: joined(a.span.subarray(0, 2 * a.count), b.span),
  colors: joined(a.colors.subarray(0, 4 * a.count), b.colors),
  count: a.count + b.count,
  length: Math.max(a.length, b.length),
});

// ---- Light records

const LIT: Rgb = [255, 226, 138];
const HIDDEN: Rgb = [0, 0, 0];

/** Rays of light records. A hidden ray has two segments. */
export interface Rays extends Segments {
  /** Number of rays. */
  total: number;
  /** Number of rays that an object hides. */
  hidden: number;
  /** Number of records of lamps without a known position. */
  lost: number;
}

/** Largest number of places of a lamp. */
const MOST_PLACES = 64;
/** Extent of a lamp, as a share of that of the scene, from which on its recorded intersections are places of their own. */
const WIDE_SHARE = 0.25;

/**
 * Returns the places of each lamp by name: the middles of the connected parts of its geometry, or recorded intersections with it. An
 * object may contain many lamps, which the records do not distinguish.
 */
export function lampPlaces(records: Records, geometry: Geometry | null): Map<string, Vec3[]> {
  const out = new Map<string, Vec3[]>();
  const wanted = new Set(records.light.lamp);
  records.names.forEach((name, i) => {
    if (!wanted.has(i + 1)) return;
    // The name of a lamp is that of its object and of its material.
    const slash = name.lastIndexOf('/');
    const [object, material] = [slash < 0 ? name : name.slice(0, slash), slash < 0 ? null : name.slice(slash + 1)];
    const made = geometry ? partsOf(geometry, object, material) : [];
    const places = made.length ? made : recordedPlaces(records, object, material);
    if (places.length) out.set(name, places);
  });
  return out;
}

/** Returns the middles of the connected parts of an object with a material. */
function partsOf(geometry: Geometry, object: string, material: string | null): Vec3[] {
  const places: Vec3[] = [];
  for (const { name, surfaces, matrix } of geometry.objects) {
    if (name !== object) continue;
    for (const surface of surfaces) {
      if (material !== null && geometry.materials[surface.material]?.name !== material) continue;
      for (const { low, high } of connectedBoxes(surface.positions, surface.indices)) {
        const middle = transform(matrix, [0, 1, 2].map((k) => (low[k]! + high[k]!) / 2) as unknown as Vec3);
        places.push([0, 1, 2].map((k) => middle[k]! + geometry.origin[k]!) as unknown as Vec3);
      }
    }
  }
  return places.filter((_, i) => places.length <= MOST_PLACES || i % Math.ceil(places.length / MOST_PLACES) === 0);
}

interface Bounds {
  low: number[];
  high: number[];
}

function extend({ low, high }: Bounds, x: number, y: number, z: number) {
  [x, y, z].forEach((v, k) => {
    low[k] = Math.min(low[k]!, v);
    high[k] = Math.max(high[k]!, v);
  });
}

const emptyBounds = (): Bounds => ({ low: [Infinity, Infinity, Infinity], high: [-Infinity, -Infinity, -Infinity] });

/** Returns the boxes of triangles that are connected by vertices at equal positions. */
export function connectedBoxes(positions: Float32Array, indices: Uint32Array): Bounds[] {
  const first = new Map<string, number>();
  const root = Uint32Array.from({ length: positions.length / 3 }, (_, i) => {
    const key = `${positions[3 * i]} ${positions[3 * i + 1]} ${positions[3 * i + 2]}`;
    const known = first.get(key);
    if (known === undefined) first.set(key, i);
    return known ?? i;
  });
  const find = (i: number) => {
    while (root[i] !== i) i = root[i] = root[root[i]!]!;
    return i;
  };
  for (let i = 0; i < indices.length; i += 3) {
    const a = find(indices[i]!);
    root[find(indices[i + 1]!)] = a;
    root[find(indices[i + 2]!)] = a;
  }
  const boxes = new Map<number, Bounds>();
  for (const i of indices) {
    const part = find(i);
    let box = boxes.get(part);
    if (!box) boxes.set(part, (box = emptyBounds()));
    extend(box, positions[3 * i]!, positions[3 * i + 1]!, positions[3 * i + 2]!);
  }
  return [...boxes.values()];
}

function recordedPlaces(records: Records, object: string, material: string | null): Vec3[] {
  const { names, kinds, position } = records;
  const number = (name: string, kind: string) => names.findIndex((it, i) => it === name && (kinds[i] ?? kind) === kind) + 1;
  const [objectNumber, materialNumber] = [number(object, 'object'), material === null ? 0 : number(material, 'material')];
  const [whole, lamp] = [emptyBounds(), emptyBounds()];
  const rows: number[] = [];
  records.object.forEach((value, row) => {
    const at: Vec3 = [position[0][row]!, position[1][row]!, position[2][row]!];
    extend(whole, ...at);
    if (objectNumber === 0 || value !== objectNumber) return;
    if (materialNumber && records.material[row] !== materialNumber) return;
    extend(lamp, ...at);
    rows.push(row);
  });
  const size = ({ low, high }: Bounds) => Math.hypot(...[0, 1, 2].map((k) => high[k]! - low[k]!));
  if (!rows.length) return [];
  if (size(lamp) <= WIDE_SHARE * size(whole)) return [[0, 1, 2].map((k) => (lamp.low[k]! + lamp.high[k]!) / 2) as unknown as Vec3];
  return sparse(rows, MOST_PLACES).map((row): Vec3 => [position[0][row]!, position[1][row]!, position[2][row]!]);
}

/** Returns the corners of a box around objects, relative to the origin. */
export function boxOf(objects: readonly SceneObject[]): [Vec3, Vec3] | null {
  const bounds = emptyBounds();
  for (const { surfaces, matrix } of objects) {
    for (const { positions } of surfaces) {
      for (let i = 0; i < positions.length; i += 3) {
        extend(bounds, ...transform(matrix, [positions[i]!, positions[i + 1]!, positions[i + 2]!]));
      }
    }
  }
  const { low, high } = bounds;
  return low[0]! <= high[0]! ? [low as unknown as Vec3, high as unknown as Vec3] : null;
}

/** Largest number of triangles that are tested for all rays. */
const MOST_TESTS = 3e7;
/** Number of parts of a lamp that are tried for a hidden ray. */
const MOST_ENDS = 8;

/**
 * Returns the rays from intersections to the lamps: to the nearest part of a lamp, and if an object hides it, to the nearest part that it
 * hides. A hidden ray is black behind the object that hides it, and black as a
 * whole where the object has no geometry.
 */
export function raysOf(records: Records, geometry: Geometry | null, origin: Vec3, isShown: (row: number) => boolean): Rays {
  const { light, names, position } = records;
  const lamps = lampPlaces(records, geometry);
  const shown: number[] = [];
  for (let row = 0; row < light.lamp.length; row++) {
    if (records.sampled.has(light.found[row]!) && isShown(row)) shown.push(row);
  }
  const list = new SegmentList(2 * shown.length);
  const occluders = new Map<string, Occluder | null>();
  let [hidden, lost, tests] = [0, 0, 0];
  for (const row of shown) {
    const places = lamps.get(names[light.lamp[row]! - 1] ?? '');
    const vertex = light.intersection[row]!;
    if (!places || vertex === NONE) {
      lost++;
      continue;
    }
    const from = [0, 1, 2].map((k) => position[k]![vertex]! - origin[k]!) as unknown as Vec3;
    const ends = nearestFirst(places, from, origin);
    const name = names[light.occluder[row]! - 1];
    if (name === undefined) {
      list.colors.set([...LIT, 255], 4 * list.add(from, ends[0]!, 0, 1));
      continue;
    }
    hidden++;
    if (!occluders.has(name)) occluders.set(name, geometry && occluderOf(geometry, name, origin));
    const occluder = occluders.get(name)!;
    let [to, split] = [ends[0]!, occluder ? occluder.nearest(from, ends[0]!) : 0];
    for (const end of ends.slice(0, MOST_ENDS)) {
      tests += (occluder?.triangles.length ?? 0) / 9;
      const t = occluder && tests < MOST_TESTS ? occluder.hit(from, end) : null;
      if (t === null) continue;
      [to, split] = [end, t];
      break;
    }
    const middle = [0, 1, 2].map((k) => from[k]! + split * (to[k]! - from[k]!)) as unknown as Vec3;
    if (split > 0) list.colors.set([...LIT, 255], 4 * list.add(from, middle, 0, 1));
    list.colors.set([...HIDDEN, 255], 4 * list.add(middle, to, 0, 1));
  }
  const { from, to, span, colors, count } = list;
  return { from, to, span, colors, count, total: shown.length - lost, hidden, lost };
}

/** Returns places relative to the origin, the nearest one first. */
function nearestFirst(places: readonly Vec3[], from: Vec3, origin: Vec3): Vec3[] {
  const all = places.map((at): Vec3 => [at[0] - origin[0], at[1] - origin[1], at[2] - origin[2]]);
  const away = (at: Vec3) => Math.hypot(at[0] - from[0], at[1] - from[1], at[2] - from[2]);
  return all.length > 1 ? all.sort((a, b) => away(a) - away(b)) : all;
}

/** Triangles of an object that hides rays. */
class Occluder {
  constructor(
    /** Nine numbers a triangle. */
    readonly triangles: Float32Array,
    readonly middle: Vec3,
  ) {}

  /** Returns the part of the ray before its first hit; null: the ray misses the object. */
  hit(from: Vec3, to: Vec3): number | null {
    const d = [to[0] - from[0], to[1] - from[1], to[2] - from[2]] as const;
    let best = Infinity;
    for (let i = 0; i < this.triangles.length; i += 9) {
      const t = triangleHit(this.triangles, i, from, d);
      if (t < best) best = t;
    }
    return best <= 1 ? best : null;
  }

  /** Returns the part of the ray before the point next to the middle of the object. */
  nearest(from: Vec3, to: Vec3): number {
    let [dot, square] = [0, 0];
    for (let k = 0; k < 3; k++) {
      const d = to[k]! - from[k]!;
      dot += d * (this.middle[k]! - from[k]!);
      square += d * d;
    }
    return square > 0 ? Math.min(Math.max(dot / square, 0.02), 0.98) : 0;
  }
}

function occluderOf(geometry: Geometry, name: string, origin: Vec3): Occluder | null {
  const nodes = geometry.objects.filter((it) => it.name === name);
  const box = boxOf(nodes);
  if (!box) return null;
  const shift = [0, 1, 2].map((k) => geometry.origin[k]! - origin[k]!);
  const count = nodes.reduce((sum, it) => sum + it.surfaces.reduce((n, { indices }) => n + indices.length, 0), 0);
  const triangles = new Float32Array(3 * count);
  let at = 0;
  for (const { surfaces, matrix } of nodes) {
    for (const { positions, indices } of surfaces) {
      for (const index of indices) {
        const i = 3 * index;
        const point = transform(matrix, [positions[i]!, positions[i + 1]!, positions[i + 2]!]);
        for (let k = 0; k < 3; k++) triangles[at++] = point[k]! + shift[k]!;
      }
    }
  }
  const middle = [0, 1, 2].map((k) => (box[0][k]! + box[1][k]!) / 2 + shift[k]!) as unknown as Vec3;
  return new Occluder(triangles, middle);
}

/** Part of the ray before a triangle (Moeller and Trumbore 1997); `Infinity`: none. */
export function triangleHit(v: Float32Array, i: number, from: Vec3, d: readonly [number, number, number]): number {
  const [ax, ay, az] = [v[i]!, v[i + 1]!, v[i + 2]!];
  const [ux, uy, uz] = [v[i + 3]! - ax, v[i + 4]! - ay, v[i + 5]! - az];
  const [wx, wy, wz] = [v[i + 6]! - ax, v[i + 7]! - ay, v[i + 8]! - az];
  const [px, py, pz] = [d[1] * wz - d[2] * wy, d[2] * wx - d[0] * wz, d[0] * wy - d[1] * wx];
  const det = ux * px + uy * py + uz * pz;
  if (det === 0) return Infinity;
  const [tx, ty, tz] = [from[0] - ax, from[1] - ay, from[2] - az];
  const a = (tx * px + ty * py + tz * pz) / det;
  if (a < 0 || a > 1) return Infinity;
  const [qx, qy, qz] = [ty * uz - tz * uy, tz * ux - tx * uz, tx * uy - ty * ux];
  const b = (d[0] * qx + d[1] * qy + d[2] * qz) / det;
  if (b < 0 || a + b > 1) return Infinity;
  const t = (wx * qx + wy * qy + wz * qz) / det;
  return t > 1e-5 ? t : Infinity;
}

// ---- Voxels

export interface Voxels {
  /** Lower corners, relative to the origin. */
  corners: Float32Array;
  colors: Uint8Array;
  /** Width, m. */
  width: number;
  count: number;
}

/** Answer of the server with voxels. */
export interface VoxelAnswer {
  cube: Corners;
  level: number;
  index: Uint32Array;
  energy: Float32Array;
}

/**
 * Returns the voxels above a threshold.
 * - `threshold`: 0 to 1 on the scale.
 */
export function voxelsOf(
  { cube, level, index, energy }: VoxelAnswer,
  scale: Scale,
  threshold: number,
  color: (t: number) => Rgb,
  origin: Vec3,
): Voxels {
  const side = 2 ** level;
  const width = (cube[1][0] - cube[0][0]) / side;
  const corners = new Float32Array(3 * index.length);
  const colors = new Uint8Array(4 * index.length);
  let count = 0;
  for (let i = 0; i < index.length; i++) {
    const t = Math.min(Math.max(place(scale, energy[i]!), 0), 1);
    if (!(energy[i]! > 0) || t < threshold) continue;
    const cell = index[i]!;
    const at = [cell % side, Math.floor(cell / side) % side, Math.floor(cell / (side * side))];
    for (let k = 0; k < 3; k++) corners[3 * count + k] = cube[0][k]! + at[k]! * width - origin[k]!;
    colors.set([...color(t), 255], 4 * count);
    count++;
  }
  return { corners: corners.slice(0, 3 * count), colors: colors.slice(0, 4 * count), width, count };
}
