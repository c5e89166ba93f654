/** The finite-element solution of a frame: elements as triangles, with the light at their corners. */

import { viridis, type Rgb } from '../../color';
import { place, type Scale } from '../../scale';
import { accessor, chunks, type GltfDocument, type Vec3 } from './glb';

/** Light that is shown on the elements. */
export type SolutionKind = 'colors' | 'luminance' | 'illuminance' | 'indirect';
export const SOLUTION_KINDS: readonly SolutionKind[] = ['colors', 'luminance', 'illuminance', 'indirect'];

/** Parses the kind from the address; null: the surfaces have simple shading. */
export function parseSolutionKind(text: string | undefined): SolutionKind | null {
  return SOLUTION_KINDS.find((kind) => kind === text) ?? null;
}

/** Unit of the values of a kind. */
export const unitOf = (kind: SolutionKind) => (kind === 'illuminance' || kind === 'indirect' ? 'lx' : 'cd/m²');

/** Triangles of a material, one side. All arrays are by vertex, except the indices. */
export interface SolutionPart {
  positions: Float32Array;
  indices: Uint32Array;
  /** Luminance along the normal by channel, cd/m². */
  radiance: Float32Array;
  /** Illuminance, lx. */
  illuminance: Float32Array;
  /** Part of it that comes directly from lamps, lx. */
  direct: Float32Array;
  /** Whether these are lamps that are not elements. They receive no light in the solution. */
  isLamp: boolean;
}

export interface Solution {
  /** Subtracted from all positions, m. */
  origin: Vec3;
  parts: readonly SolutionPart[];
  /** Number of triangles of the whole solution. The parts are empty if there are more than `limit`. */
  triangles: number;
  limit: number;
}

/** Parses binary glTF; throws an `Error` with a description if it is invalid. */
export function parseSolution(buffer: ArrayBuffer): Solution {
  const { document, binary } = chunks(buffer);
  const scene = document.scenes?.[document.scene ?? 0];
  const { origin, full_triangles, max_triangles } = scene?.extras ?? {};
  return {
    origin: Array.isArray(origin) && origin.length === 3 ? (origin as unknown as Vec3) : [0, 0, 0],
    parts: (document.nodes ?? []).flatMap((node) => partsOf(document, binary, node)),
    triangles: Number(full_triangles ?? 0),
    limit: Number(max_triangles ?? 0),
  };
}

function partsOf(document: GltfDocument, binary: ArrayBuffer, node: NonNullable<GltfDocument['nodes']>[number]): SolutionPart[] {
  const primitives = node.mesh === undefined ? [] : (document.meshes?.[node.mesh]?.primitives ?? []);
  return primitives.map(({ attributes, indices }) => {
    const floats = (name: string, width: number) => {
      const number = attributes[name];
      const values = number === undefined ? null : accessor(document, binary, number, width);
      if (!(values instanceof Float32Array)) throw new Error(`the solution has no numbers for ${name}`);
      return values;
    };
    if (indices === undefined) throw new Error('the solution has no triangles');
    return {
      positions: floats('POSITION', 3),
      indices: Uint32Array.from(accessor(document, binary, indices, 1)),
      radiance: floats('_RADIANCE', 3),
      illuminance: floats('_ILLUMINANCE', 1),
      direct: floats('_DIRECT', 1),
      isLamp: node.extras?.lamp ?? false,
    };
  });
}

/** Returns the values of a kind at the vertices. The value of `colors` is the luminance. */
export function valuesOf(part: SolutionPart, kind: SolutionKind): Float32Array {
  if (kind === 'illuminance') return part.illuminance;
  if (kind === 'indirect') return part.illuminance.map((all, i) => Math.max(all - part.direct[i]!, 0));
  return Float32Array.from(part.illuminance, (_, i) => {
    const [r, g, b] = [part.radiance[3 * i]!, part.radiance[3 * i + 1]!, part.radiance[3 * i + 2]!];
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  });
}

/** Shares of the area whose values are below and above the scale. */
const [BELOW, ABOVE] = [0.03, 0.01];

/** Lower end of the scale over its upper end, at least. Backs of walls outside of a room are nearly black. */
const LOWEST = 1e-3;

/** Returns a logarithmic scale over the values of the elements, by area, without the lowest and highest shares. */
export function solutionScale(solution: Solution, kind: SolutionKind): Scale {
  const all: [value: number, area: number][] = [];
  for (const part of solution.parts) {
    if (part.isLamp) continue;
    const values = valuesOf(part, kind);
    for (let i = 0; i + 2 < part.indices.length; i += 3) {
      const corners = part.indices.subarray(i, i + 3);
      const share = areaOf(part.positions, corners) / 3;
      for (const corner of corners) {
        const value = values[corner]!;
        if (value > 0 && Number.isFinite(value)) all.push([value, share]);
      }
    }
  }
  if (!all.length) return { low: 1, high: 1, logarithmic: true };
  all.sort(([a], [b]) => a - b);
  const total = all.reduce((sum, [, share]) => sum + share, 0);
  const at = (wanted: number) => {
    let sum = 0;
    return (all.find(([, share]) => (sum += share) >= wanted * total) ?? all.at(-1)!)[0];
  };
  const high = at(1 - ABOVE);
  return { low: Math.max(at(BELOW), LOWEST * high), high, logarithmic: true };
}

/** Returns the area of a triangle, m². */
function areaOf(positions: Float32Array, corners: ArrayLike<number>): number {
  const [a, b, c] = [0, 1, 2].map((k) => positions.subarray(3 * corners[k]!, 3 * corners[k]! + 3));
  const [u, v] = [b!, c!].map((it) => [it[0]! - a![0]!, it[1]! - a![1]!, it[2]! - a![2]!]);
  const cross = [1, 2, 3].map((k) => u![k % 3]! * v![(k + 1) % 3]! - u![(k + 1) % 3]! * v![k % 3]!);
  return Math.hypot(...cross) / 2;
}

/** Returns the colors of the vertices as bytes of the screen. In their own colors, the highest value of the scale is white. */
export function colorsOf(part: SolutionPart, kind: SolutionKind, scale: Scale): Uint8Array {
  const count = part.illuminance.length;
  const colors = new Uint8Array(3 * count);
  if (kind === 'colors') {
    const exposure = 1 / scale.high;
    for (let i = 0; i < 3 * count; i++) colors[i] = screenByte(part.radiance[i]! * exposure);
    return colors;
  }
  const values = valuesOf(part, kind);
  for (let i = 0; i < count; i++) {
    const t = place(scale, values[i]!);
    const [r, g, b]: Rgb = viridis(Math.min(Math.max(Number.isNaN(t) ? 0 : t, 0), 1));
    colors.set([r, g, b], 3 * i);
  }
  return colors;
}

/** Returns the byte of a linear component, by the transfer function of sRGB. */
function screenByte(linear: number): number {
  const it = Math.min(Math.max(linear, 0), 1);
  return Math.round(255 * (it <= 0.0031308 ? 12.92 * it : 1.055 * it ** (1 / 2.4) - 0.055));
}
