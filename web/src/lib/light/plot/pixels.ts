/** Lines of a plot without a graphics card: counts.ts counts them, and this module makes colors of the counts. */

import { ROOTS, StripCounts, type StripLines, type StripShape } from './counts';
import { addDensity, COLUMNS, ROWS } from './density';
import type { Drawing } from './graphics';
import { DEEP, DENSEST, DENSITY, identity, REST, shape, type Scene } from './lines';
import { ratioColor } from './ratio';
import { hasHeights, heightsOf } from './scale';
import { pageSlices, type Job } from './slices';

interface Strip {
  /** Counts of all and of selected lines, by set. */
  all: StripCounts[];
  chosen: StripCounts[];
  densityKey: string;
  /** Opacity of the density, and the ratio of both sets, in bytes; row by row from the lowest on. */
  opacities: Uint8Array;
  ratios: Uint8Array;
  painted: string;
}

/** Texts that change with the counts of a strip for a mask, with its density, and with its pixels. */
interface Plan {
  shape: string;
  density: string;
  pixels: string;
}

/** Values by the code of a count, for the current opacity and colors. */
interface Tables {
  key: string;
  /** Opacity of lines, and part of the deep tone, by four times the root of the count. */
  cover: Float32Array;
  deep: Float32Array;
  /** Color of lines of a single set, times their opacity. */
  front: Float32Array;
  /** Color of ratios, 0: only B, 255: only A. */
  tints: Float32Array;
}

const NONE = new Float32Array();

/** Drawing of the lines on a canvas without WebGL. */
export class PixelDrawing implements Drawing, Job {
  private context: CanvasRenderingContext2D;
  private scene: Scene | null = null;
  private strips: Strip[] = [];
  private plans: Plan[] = [];
  private frame = 0;
  /** Strip that is drawn. */
  private current = 0;
  private began = 0;
  private image: ImageData | null = null;
  private words = new Uint32Array();
  private tables: Tables = { key: '', cover: NONE, deep: NONE, front: NONE, tints: NONE };

  constructor(
    private canvas: HTMLCanvasElement,
    private ondrawn?: (milliseconds: number) => void,
  ) {
    const context = canvas.getContext('2d', { willReadFrequently: true });
    if (!context) throw new Error('cannot draw on a canvas');
    this.context = context;
  }

  update(scene: Scene) {
    // The pixels of fine screens are too many.
    scene = { ...scene, ratio: Math.min(scene.ratio, 1) };
    this.scene = scene;
    this.began ||= performance.now();
    const { canvas } = this;
    const [width, height] = [scene.width, scene.height].map((it) => Math.max(1, Math.round(it * scene.ratio)));
    const count = Math.max(scene.axes.length - 1, 0);
    const isNew = canvas.width !== width || canvas.height !== height;
    if (isNew || count !== this.strips.length) {
      if (isNew) [canvas.width, canvas.height] = [width!, height!];
      else this.context.clearRect(0, 0, width!, height!);
      this.strips = Array.from({ length: count }, () => ({
        all: [],
        chosen: [],
        densityKey: '',
        opacities: new Uint8Array(),
        ratios: new Uint8Array(),
        painted: '',
      }));
    }
    const look = `${scene.opacity} ${scene.palette.panel} ${scene.sets.length} ${scene.sets.map((it) => it.rows)}`;
    if (this.tables.key !== look) this.tables = makeTables(scene, look);
    const masks = scene.sets.map((it) => identity(it.selected)).join();
    this.plans = this.strips.map((_, i) => {
      const shape = this.shapeKey(scene, i);
      const density = `${shape}|${this.densityKey(scene, i)}`;
      return { shape, density, pixels: `${this.column(scene, i)} ${density}|${masks}|${look}` };
    });
    pageSlices().add(this);
  }

  private column = (scene: Scene, place: number) => Math.round((scene.left + place * scene.spacing) * scene.ratio);

  private shapeKey(scene: Scene, i: number): string {
    const [a, b] = [scene.axes[i]!, scene.axes[i + 1]!];
    const data = scene.sets.map((it) => `${it.rows} ${identity(it.values[a.index])} ${identity(it.values[b.index])}`);
    const columns = this.column(scene, i + 1) - this.column(scene, i);
    return `${columns} ${this.canvas.height} ${scene.top} ${scene.bottom} ${shape(a)} ${shape(b)} ${data}`;
  }

  private densityKey(scene: Scene, i: number): string {
    if (!scene.showDensity) return '';
    const [a, b] = [scene.axes[i]!, scene.axes[i + 1]!];
    return scene.sets.map((it) => identity(it.pair(a.index, b.index))).join();
  }

  /** Draws a piece of a strip between two axes: a part of its counts, its density, or its pixels. */
  step(): boolean {
    const { scene, strips, plans } = this;
    if (!scene) return false;
    const isStale = (i: number) => strips[i]!.painted !== plans[i]!.pixels;
    if (this.current >= strips.length) this.current = 0;
    for (let n = 0; n < strips.length && !isStale(this.current); n++) this.current = (this.current + 1) % strips.length;
    const i = this.current;
    if (i < strips.length && isStale(i)) {
      if (!this.prepare(scene, i)) return true;
      this.show(scene, i);
      strips[i]!.painted = plans[i]!.pixels;
      if (strips.some((_, k) => isStale(k))) return true;
    }
    // The last pixels are on the screen after the next frame.
    this.frame ||= requestAnimationFrame(() => {
      this.frame = 0;
      this.ondrawn?.(performance.now() - this.began);
      this.began = 0;
    });
    return false;
  }

  private stripShape(scene: Scene, i: number): StripShape {
    return {
      columns: this.column(scene, i + 1) - this.column(scene, i),
      rows: this.canvas.height,
      base: this.canvas.height - scene.bottom * scene.ratio,
      length: (scene.bottom - scene.top) * scene.ratio,
    };
  }

  /** Does a piece of the work before the pixels of a strip. Returns whether all of it is done. */
  private prepare(scene: Scene, i: number): boolean {
    const strip = this.strips[i]!;
    const [a, b] = [scene.axes[i]!, scene.axes[i + 1]!];
    const place = this.stripShape(scene, i);
    const plan = this.plans[i]!;
    const sets = scene.sets.slice(0, 2);
    const hasSelection = sets.some((it) => it.selected);
    for (const [number, set] of sets.entries()) {
      for (const { index, scale } of [a, b]) {
        const values = set.values[index];
        if (!values || hasHeights(values, scale)) continue;
        heightsOf(values, scale);
        return false;
      }
      const lines: StripLines = {
        left: heightsOf(set.values[a.index], a.scale),
        right: heightsOf(set.values[b.index], b.scale),
        leftFlipped: a.flipped,
        rightFlipped: b.flipped,
        rows: set.rows,
      };
      if ((strip.all[number] ??= new StripCounts()).advance(plan.shape, place, lines, null)) return false;
      if (hasSelection && (strip.chosen[number] ??= new StripCounts()).advance(plan.shape, place, lines, set.selected)) return false;
    }
    if (strip.densityKey === plan.density) return true;
    strip.densityKey = plan.density;
    this.spread(scene, i, place);
    return false;
  }

  /** Puts the pixels of a strip on the canvas. */
  private show(scene: Scene, i: number) {
    const place = this.stripShape(scene, i);
    // Strips of the same size share their pixels.
    if (this.image?.width !== place.columns || this.image.height !== place.rows) {
      this.image = new ImageData(place.columns, place.rows);
      this.words = new Uint32Array(this.image.data.buffer);
    }
    this.paint(scene, this.strips[i]!, place, scene.sets.some((it) => it.selected), this.words);
    this.context.putImageData(this.image, this.column(scene, i), 0);
  }

  /** Enlarges the density between two axes to the pixels of the screen. */
  private spread(scene: Scene, i: number, { columns, rows, base, length }: StripShape) {
    const strip = this.strips[i]!;
    strip.opacities = new Uint8Array(columns * rows);
    strip.ratios = new Uint8Array(scene.sets.length > 1 ? columns * rows : 0);
    if (!scene.showDensity) return;
    const [a, b] = [scene.axes[i]!, scene.axes[i + 1]!];
    const grids = scene.sets.slice(0, 2).map((set) => {
      const grid = new Float32Array(COLUMNS * ROWS);
      const counts = set.pair(a.index, b.index);
      if (counts) addDensity(counts, { ...a.scale, flipped: a.flipped }, { ...b.scale, flipped: b.flipped }, grid);
      return grid;
    });
    const [first, second] = [grids[0], grids[1]];
    if (!first) return;
    const scale = (255 * DENSITY) / Math.log(DENSEST);
    const [low, high] = [Math.max(Math.round(base), 0), Math.min(Math.round(base + length), rows)];
    // Columns of the grid and their parts, for each pixel of a row.
    const places = Float32Array.from({ length: columns }, (_, x) =>
      Math.min(Math.max(((x + 0.5) / columns) * COLUMNS - 0.5, 0), COLUMNS - 1.001),
    );
    for (let y = low; y < high; y++) {
      const v = Math.min(Math.max(((y + 0.5 - base) / length) * ROWS - 0.5, 0), ROWS - 1.001);
      const row = Math.floor(v);
      for (let x = 0; x < columns; x++) {
        const u = places[x]!;
        const at = row * COLUMNS + Math.floor(u);
        const one = sample(first, at, u - Math.floor(u), v - row);
        const other = second ? sample(second, at, u - Math.floor(u), v - row) : 0;
        const mean = second ? (one + other) / 2 : one;
        if (mean <= 0) continue;
        strip.opacities[y * columns + x] = Math.min(scale * Math.log(1 + 5 * mean), 255 * DENSITY);
        if (second) strip.ratios[y * columns + x] = 127.5 + (127.5 * (one - other)) / (one + other);
      }
    }
  }

  /** Writes the pixels between two axes, as 32-bit words from the highest row on. */
  private paint({ palette, sets }: Scene, strip: Strip, { columns, rows }: StripShape, hasSelection: boolean, words: Uint32Array) {
    const { cover, deep, tints, front: fronts } = this.tables;
    const [panelR, panelG, panelB] = palette.panel;
    const [restR, restG, restB] = palette.rest;
    const [deepR, deepG, deepB] = palette.deep;
    const two = sets.length > 1;
    const [scaleA, scaleB] = [1 / (sets[0]?.rows || 1), 1 / (sets[1]?.rows || 1)];
    const front = hasSelection ? strip.chosen : strip.all;
    const [frontA, frontB] = [front[0]?.bytes, two ? front[1]?.bytes : undefined];
    const [allA, allB] = [strip.all[0]?.bytes, two ? strip.all[1]?.bytes : undefined];
    if (!frontA || !allA) return;
    const { opacities, ratios } = strip;
    for (let y = 0, at = 0; y < rows; y++) {
      let to = (rows - 1 - y) * columns;
      for (let x = 0; x < columns; x++, at++, to++) {
        const dense = opacities[at]!;
        const a = frontA[at]!;
        const b = frontB !== undefined ? frontB[at]! : 0;
        let rest = 0;
        if (hasSelection) {
          rest = allA[at]!;
          if (allB !== undefined && allB[at]! > 0) rest = Math.round(Math.sqrt(rest * rest + allB[at]! * allB[at]!));
        }
        if ((dense | a | b | rest) === 0) {
          words[to] = 0;
          continue;
        }
        // Parts of the page's color and of the colors before the front.
        let red = panelR;
        let green = panelG;
        let blue = panelB;
        if (dense > 0) {
          const alpha = dense / 255;
          const tint = two ? 3 * ratios[at]! : -1;
          red += alpha * ((two ? tints[tint]! : restR) - red);
          green += alpha * ((two ? tints[tint + 1]! : restG) - green);
          blue += alpha * ((two ? tints[tint + 2]! : restB) - blue);
        }
        if (rest > 0) {
          const alpha = REST * cover[rest]!;
          red += alpha * (restR - red);
          green += alpha * (restG - green);
          blue += alpha * (restB - blue);
        }
        if (frontB === undefined) {
          const part = 1 - cover[a]!;
          red = red * part + fronts[3 * a]!;
          green = green * part + fronts[3 * a + 1]!;
          blue = blue * part + fronts[3 * a + 2]!;
        } else if ((a | b) > 0) {
          const code = b === 0 ? a : a === 0 ? b : Math.round(Math.sqrt(a * a + b * b));
          const shareA = a * a * scaleA;
          const shareB = b * b * scaleB;
          const tint = 3 * Math.round(127.5 + (127.5 * (shareA - shareB)) / (shareA + shareB));
          const alpha = cover[code]!;
          const part = deep[code]!;
          red += alpha * (tints[tint]! + part * (deepR - tints[tint]!) - red);
          green += alpha * (tints[tint + 1]! + part * (deepG - tints[tint + 1]!) - green);
          blue += alpha * (tints[tint + 2]! + part * (deepB - tints[tint + 2]!) - blue);
        }
        words[to] = 0xff000000 | (blue << 16) | (green << 8) | red;
      }
    }
  }

  destroy() {
    cancelAnimationFrame(this.frame);
    pageSlices().remove(this);
    this.scene = null;
  }
}

/** Returns the density between four numbers of a grid. */
function sample(grid: Float32Array, at: number, s: number, t: number): number {
  const low = grid[at]! * (1 - s) + grid[at + 1]! * s;
  return low * (1 - t) + (grid[at + COLUMNS]! * (1 - s) + grid[at + COLUMNS + 1]! * s) * t;
}

function makeTables({ opacity, palette, sets }: Scene, key: string): Tables {
  // Codes of two sets together reach the root of two times 255.
  const size = 364;
  const amount = Float32Array.from({ length: size }, (_, code) => opacity * (code / ROOTS) ** 2);
  const tints = new Float32Array(3 * 256);
  for (let i = 0; i < 256; i++) {
    const t = i / 127.5 - 1;
    const color = sets.length > 1 ? ratioColor(1 + t, 1 - t, palette) : palette.single;
    tints.set(color, 3 * i);
  }
  const cover = amount.map((x) => x / (1 + x));
  const deep = amount.map((x) => DEEP * Math.min(Math.max(Math.log2(1 + x) / 5 - 0.25, 0), 1));
  const front = new Float32Array(3 * size);
  for (let code = 0; code < size; code++)
    for (let i = 0; i < 3; i++) {
      const tone = palette.single[i]!;
      front[3 * code + i] = cover[code]! * (tone + deep[code]! * (palette.deep[i]! - tone));
    }
  return { key, cover, deep, front, tints };
}
