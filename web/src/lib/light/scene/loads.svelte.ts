/** Data of the scene view that the plots do not need: geometry, the finite-element solution, targets of paths and voxels. */

import { explain } from '../../api';
import type { Rgb } from '../../color';
import type { Scale } from '../../scale';
import { light, type Corners, type Model, type Source } from '../api';
import { unite } from '../data';
import { Newest, type DataSet } from '../state.svelte';
import { parseGlb, type Vec3 } from './glb';
import { energyScale, voxelsOf, type VoxelAnswer, type Voxels } from './records';
import { parseSolution } from './solution';
import { parseTargets } from './targets';

export type Layer = 'surfaces' | 'points' | 'paths' | 'lights' | 'voxels' | 'targets';
export const LAYERS: readonly Layer[] = ['surfaces', 'points', 'paths', 'lights', 'voxels', 'targets'];
const FIRST_LAYERS: readonly Layer[] = ['surfaces', 'points', 'paths'];

/** Parses the visible layers from the address. */
export function parseLayers(text: string | undefined): ReadonlySet<Layer> {
  if (!text) return new Set(FIRST_LAYERS);
  const words = text.split(',');
  return new Set(LAYERS.filter((it) => words.includes(it)));
}

/** Voxels of a data set, or the difference of two. */
export interface LoadedVoxels extends VoxelAnswer {
  /** Difference of two sets: 1 or -1 for each voxel, and `energy` is the amount. */
  sign: Int8Array | null;
  /** Scale of the amounts. */
  differences: Scale;
}

const RETRY_INTERVAL_MS = 2000;

/** A model of the scene, requested until it is made. */
export class LoadedModel<T> {
  value = $state.raw<T | null>(null);
  /** `idle`: not requested. `none`: the data have no such model. `waiting`: it is not made yet. */
  status = $state.raw<'idle' | 'loading' | 'waiting' | 'none' | 'shown' | 'fault'>('idle');
  fault = $state.raw<string | null>(null);

  private key = '';
  private timer: ReturnType<typeof setTimeout> | undefined;
  private readonly requests = new Newest(0, (error) => {
    this.fault = explain(error);
    this.status = 'fault';
  });

  constructor(
    private readonly model: Model,
    private readonly parse: (bytes: ArrayBuffer) => T,
  ) {}

  /** Requests the model, unless it is that of the last request. */
  load(source: Source) {
    const key = JSON.stringify(source);
    if (key === this.key) return;
    this.key = key;
    this.status = 'loading';
    this.ask(source);
  }

  private ask(source: Source) {
    clearTimeout(this.timer);
    this.requests.run(async (signal) => {
      const bytes = await light.model(source, this.model, signal);
      this.fault = null;
      this.value = bytes ? this.parse(bytes) : null;
      this.status = bytes ? 'shown' : bytes === null ? 'waiting' : 'none';
      if (bytes === null) this.timer = setTimeout(() => this.ask(source), RETRY_INTERVAL_MS);
    });
  }

  stop() {
    clearTimeout(this.timer);
    this.requests.stop();
  }
}

export class SceneData {
  readonly geometry = new LoadedModel('geometry', parseGlb);
  readonly solution = new LoadedModel('solution', parseSolution);
  readonly targets = new LoadedModel('targets', parseTargets);
  voxelFault = $state.raw<string | null>(null);
  voxels = $state.raw<LoadedVoxels | null>(null);

  private voxelKey = '';
  private readonly voxelRequests = new Newest(100, (error) => (this.voxelFault = explain(error)));

  /**
   * Requests voxels of one data set, or of two for their difference.
   * - `tags`: identify the data.
   */
  loadVoxels(sets: readonly DataSet[], tags: string, wish: { where: string; level: number; bounce: number | null }) {
    const key = JSON.stringify([sets.map((it) => it.source), tags, wish]);
    if (key === this.voxelKey) return;
    this.voxelKey = key;
    const boxes = sets.map((it) => it.schema!.box);
    const box = boxes.length > 1 ? unite(boxes[0]!, boxes[1]!) : null;
    this.voxelRequests.run(async (signal) => {
      const answers = await Promise.all(sets.map((it) => light.voxels(it.source, { ...wish, box }, signal)));
      const all = answers.flatMap((it): VoxelAnswer[] =>
        it ? [{ ...it.header, index: it.u32('voxels.index'), energy: it.f32('voxels.energy') }] : [],
      );
      const [a, b] = all;
      const isLacking = all.length < sets.length;
      this.voxels = isLacking ? null : a && b ? differenceOf(a, b) : a ? { ...a, sign: null, differences: energyScale([]) } : null;
    });
  }

  /** Returns the voxels of a difference above a threshold: red where A has more, blue where B has. */
  drawDifference(of: LoadedVoxels, threshold: number, origin: Vec3, color: (t: number) => Rgb): Voxels {
    const signed = (want: number) => {
      const kept = [...of.index.keys()].filter((i) => of.sign![i] === want);
      const part = {
        ...of,
        index: Uint32Array.from(kept, (i) => of.index[i]!),
        energy: Float32Array.from(kept, (i) => of.energy[i]!),
      };
      return voxelsOf(part, of.differences, threshold, (t) => color(0.5 + 0.5 * want * t), origin);
    };
    const [more, less] = [signed(1), signed(-1)];
    const joined = (a: ArrayLike<number>, b: ArrayLike<number>) => [...Array.from(a), ...Array.from(b)];
    return {
      corners: Float32Array.from(joined(more.corners, less.corners)),
      colors: Uint8Array.from(joined(more.colors, less.colors)),
      width: more.width,
      count: more.count + less.count,
    };
  }

  stop() {
    this.geometry.stop();
    this.solution.stop();
    this.targets.stop();
    this.voxelRequests.stop();
  }
}

/** Returns the energies of A minus those of B; a voxel that one of them lacks has no energy there. */
export function differenceOf(a: VoxelAnswer, b: VoxelAnswer): LoadedVoxels {
  const values = new Map<number, number>();
  a.index.forEach((cell, i) => values.set(cell, a.energy[i]!));
  b.index.forEach((cell, i) => values.set(cell, (values.get(cell) ?? 0) - b.energy[i]!));
  const kept = [...values].filter(([, value]) => value !== 0).sort(([x], [y]) => x - y);
  const energy = Float32Array.from(kept, ([, value]) => Math.abs(value));
  const high = energyScale(energy).high;
  return {
    cube: a.cube,
    level: a.level,
    index: Uint32Array.from(kept, ([cell]) => cell),
    energy,
    sign: Int8Array.from(kept, ([, value]) => Math.sign(value)),
    differences: { low: 0, high, logarithmic: false },
  };
}

/** Describes the cube that the voxels of a difference divide, and whether A and B have the same box. */
export function describeCube(a: Corners, b: Corners, cube: Corners): string {
  const width = `${Number((cube[1][0] - cube[0][0]).toPrecision(3))} m`;
  if (JSON.stringify(a) === JSON.stringify(b)) return `A and B have the same box: one cube of ${width} for both.`;
  const isApart = [0, 1, 2].some((k) => a[1][k]! < b[0][k]! || b[1][k]! < a[0][k]!);
  if (isApart) return `The boxes of A and B have no place in common: no voxel has light of both. One cube of ${width} contains them.`;
  return `The boxes of A and B differ: the voxels divide one cube of ${width} around both.`;
}
