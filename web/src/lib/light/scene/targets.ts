/** Targets of a frame's paths: openings through which light comes, and bright patches. */

import type { Vec3 } from './glb';

/** A target and the light that it brings. */
export interface Target {
  kind: 'opening' | 'patch';
  /** Share of the indirect light of the picture that passes through the opening, or comes from the patch. */
  light: number;
  /** Lengths of the edges of a parallelogram, or the radius of a ball, m. */
  lengths: readonly number[];
  /** Center in coordinates of the scene, m. */
  center: Vec3;
}

export interface Targets {
  /** Subtracted from the ends of lines, m. */
  origin: Vec3;
  targets: readonly Target[];
  /** Ends of the outlines' lines: six numbers for each, m. */
  ends: Float32Array;
}

/** Number of lines of a circle. */
const CIRCLE = 24;

interface TargetRecord {
  kind: unknown;
  light: unknown;
  shape: unknown;
  corner?: unknown;
  edges?: unknown;
  center?: unknown;
  radius?: unknown;
}

/** Parses the document of targets; throws an `Error` with a description if it is invalid. */
export function parseTargets(buffer: ArrayBuffer): Targets {
  const document = JSON.parse(new TextDecoder().decode(buffer)) as { format?: unknown; origin?: unknown; targets?: unknown };
  if (document.format !== 'femc targets 1') throw new Error(`unknown format of targets: ${String(document.format)}`);
  const origin = vector(document.origin);
  const lines: number[] = [];
  const targets = (Array.isArray(document.targets) ? (document.targets as TargetRecord[]) : []).map((record): Target => {
    const { kind, light } = record;
    if ((kind !== 'opening' && kind !== 'patch') || typeof light !== 'number') throw new Error('invalid target');
    const { center, lengths, ends } = record.shape === 'ball' ? ball(record) : parallelogram(record);
    lines.push(...ends);
    return { kind, light, lengths, center: add(center, origin) };
  });
  return { origin, targets, ends: Float32Array.from(lines) };
}

interface Shape {
  center: Vec3;
  lengths: readonly number[];
  ends: number[];
}

function parallelogram({ corner, edges }: TargetRecord): Shape {
  const start = vector(corner);
  const [a, b] = (Array.isArray(edges) ? edges : []).map(vector);
  if (!a || !b) throw new Error('a target has no edges');
  const corners = [start, add(start, a), add(add(start, a), b), add(start, b)];
  const ends = corners.flatMap((from, i) => [...from, ...corners[(i + 1) % 4]!]);
  return { center: add(start, scaled(add(a, b), 0.5)), lengths: [Math.hypot(...a), Math.hypot(...b)], ends };
}

function ball({ center, radius }: TargetRecord): Shape {
  const middle = vector(center);
  if (typeof radius !== 'number' || !Number.isFinite(radius)) throw new Error('a target has no radius');
  const ends: number[] = [];
  for (const [first, second] of [[0, 1], [1, 2], [2, 0]] as const) {
    const at = (step: number) => {
      const angle = (2 * Math.PI * step) / CIRCLE;
      const point = [...middle];
      point[first]! += radius * Math.cos(angle);
      point[second]! += radius * Math.sin(angle);
      return point;
    };
    for (let step = 0; step < CIRCLE; step++) ends.push(...at(step), ...at(step + 1));
  }
  return { center: middle, lengths: [radius], ends };
}

function vector(value: unknown): Vec3 {
  if (!Array.isArray(value) || value.length !== 3 || !value.every(Number.isFinite)) throw new Error('a position of a target is invalid');
  return value as unknown as Vec3;
}

const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const scaled = (a: Vec3, by: number): Vec3 => [a[0] * by, a[1] * by, a[2] * by];

/** Returns a size like `0.05 m x 2.06 m`. */
export function sizeText({ lengths }: Target): string {
  const meters = (length: number) => `${Number(length.toPrecision(2))} m`;
  return lengths.length === 1 ? `radius ${meters(lengths[0]!)}` : lengths.map(meters).join(' x ');
}
