/** Bins of the axes as bars on a canvas. */

import type { PlotSet } from './contract';
import type { Drawing } from './graphics';
import { lengthOf, xOf } from './layout';
import { identity, shape, type Scene } from './lines';
import { ratio as ratioOf, ratioColor } from './ratio';
import { BINS, type AxisScale } from './scale';
import { pageSlices, type Job } from './slices';

/** Least height of a bar, in pixels. */
export const MIN_BAR_HEIGHT = 3;

type Rgb = readonly [number, number, number];
const css = ([r, g, b]: Rgb, alpha: number) => `rgb(${r} ${g} ${b} / ${alpha})`;

/** A bar: neighboring bins that are together at least as high as a bar must be. */
export interface Bar {
  /** Heights on the axis. */
  from: number;
  to: number;
  bins: number[];
}

const known = new WeakMap<AxisScale, { least: number; bars: Bar[] }>();

/** Returns the bars of an axis; none is lower than `least`. */
export function barsOf({ scale }: { scale: AxisScale }, least: number): Bar[] {
  const last = known.get(scale);
  if (last?.least === least) return last.bars;
  const bars = makeBars(scale, least);
  known.set(scale, { least, bars });
  return bars;
}

function makeBars(scale: AxisScale, least: number): Bar[] {
  const bins = Array.from({ length: BINS }, (_, k) => k).filter((k) => scale.to[k]! > scale.from[k]!);
  bins.sort((a, b) => scale.from[a]! - scale.from[b]!);
  const bars: Bar[] = [];
  for (const k of bins) {
    const last = bars.at(-1);
    const [from, to] = [scale.from[k]!, scale.to[k]!];
    const isSlot = scale.base > 0 && k === 0;
    if (last && last.to - last.from < least && !scale.isCategorical && !isSlot && !(scale.base > 0 && last.bins[0] === 0)) {
      last.to = to;
      last.bins.push(k);
    } else bars.push({ from, to, bins: [k] });
  }
  return bars;
}

/** Returns the share of a set's records in a bar. */
export function shareIn(bar: Bar, counts: ArrayLike<number> | undefined, total: number): number {
  if (!counts || !(total > 0)) return 0;
  let sum = 0;
  for (const k of bar.bins) sum += counts[k] ?? 0;
  return sum / total;
}

/** Returns the shares of a set's records in bars: of all records, or of the selected ones among the recorded ones. */
export const sharesIn = (bars: readonly Bar[], set: PlotSet, index: number, which: 'all' | 'selected'): number[] =>
  bars.map((bar) =>
    which === 'all' ? shareIn(bar, set.bins[index], set.total) : shareIn(bar, set.selectedBins?.[index], set.selectedTotal),
  );

/** Draws the bars of all axes; lengths are in CSS pixels. */
export function drawBars(context: CanvasRenderingContext2D, scene: Scene): void {
  const { ratio, width, height, axes, sets, palette, top } = scene;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const length = lengthOf(scene);
  const most = Math.min(0.42 * scene.spacing, 44) * (sets.length > 1 ? 0.75 : 1);
  const hasSelection = sets.some((it) => it.selectedBins);
  // Rectangles of one color are filled together.
  const layers: Map<string, number[]>[] = [new Map(), new Map(), new Map()];
  const cuts: [number, number, number, number][] = [];
  const fill = (layer: number, style: string, ...box: [number, number, number, number]) => {
    const boxes = layers[layer]!.get(style);
    if (boxes) boxes.push(...box);
    else layers[layer]!.set(style, box);
  };
  const two = sets.length > 1;
  axes.forEach((axis, place) => {
    const x = xOf(scene, place);
    const bars = barsOf(axis, MIN_BAR_HEIGHT / length);
    const all = sets.map((it) => sharesIn(bars, it, axis.index, 'all'));
    const chosen = hasSelection ? sets.map((it) => sharesIn(bars, it, axis.index, 'selected')) : null;
    // The place of records without a value may have most of them: it does not make the others invisible.
    const isSlot = (i: number) => axis.scale.base > 0 && bars[i]!.bins[0] === 0;
    let greatest = 0;
    for (const list of all) list.forEach((share, i) => (greatest = isSlot(i) ? greatest : Math.max(greatest, share)));
    if (greatest === 0) greatest = 1;
    bars.forEach((bar, i) => {
      const [low, high] = axis.flipped ? [1 - bar.to, 1 - bar.from] : [bar.from, bar.to];
      let [y, size] = [top + (1 - high) * length, (high - low) * length];
      if (axis.scale.isCategorical) [y, size] = [y + 0.08 * size, 0.84 * size];
      else if (size > 4) size -= 1;
      const tone = (list: number[][], alpha: number) => {
        // Sixteen steps of color on each side keep the number of fills small.
        const t = Math.round(16 * ratioOf(list[0]![i]!, list[1]![i]!));
        return css(ratioColor(1 + t / 16, 1 - t / 16, palette), alpha);
      };
      sets.forEach((_, number) => {
        const side = two && number === 0 ? -1 : 1;
        const draw = (layer: number, share: number, style: string) => {
          if (!(share > 0)) return;
          const part = Math.max(most * Math.min(share / greatest, 1), 1.2);
          const left = side > 0 ? x + 1 : x - 1 - part;
          // An edge in the color of the page separates bars from lines.
          if (layer === 1) fill(0, css(palette.panel, 0.85), left - (side > 0 ? 0 : 1), y - 0.5, part + 1, size + 1);
          fill(layer, style, left, y, part, size);
          if (layer === 1 && share > greatest * 1.001) cuts.push([x + side * (most - 4) - 0.75, y, 1.5, size]);
        };
        if (!chosen) draw(1, all[number]![i]!, two ? tone(all, 0.9) : css(palette.bar, 0.9));
        else {
          draw(1, all[number]![i]!, css(palette.rest, 0.55));
          draw(2, chosen[number]![i]!, two ? tone(chosen, 1) : css(palette.single, 1));
        }
      });
    });
  });
  for (const layer of layers) {
    for (const [style, boxes] of layer) {
      context.fillStyle = style;
      context.beginPath();
      for (let i = 0; i < boxes.length; i += 4) context.rect(boxes[i]!, boxes[i + 1]!, boxes[i + 2]!, boxes[i + 3]!);
      context.fill();
    }
  }
  // Marks of bars that are longer than there is room for.
  for (const box of cuts) context.clearRect(...box);
}

/** Drawing of the bars of a plot on a canvas. */
export class BarDrawing implements Drawing, Job {
  private scene: Scene | null = null;
  private key = '';

  constructor(private readonly canvas: HTMLCanvasElement) {}

  update(scene: Scene) {
    const { width, height, ratio, palette, axes, sets } = scene;
    const counts = sets.map((set) =>
      axes.map(({ index }) => `${identity(set.bins[index])} ${identity(set.selectedBins?.[index])}`).concat(`${set.total} ${set.selectedTotal}`),
    );
    const key = `${width} ${height} ${ratio} ${palette.panel} ${axes.map(shape)} ${counts}`;
    if (this.key === key) return;
    this.key = key;
    this.scene = scene;
    pageSlices().add(this);
  }

  step(): boolean {
    const { canvas, scene } = this;
    const context = canvas.getContext('2d');
    if (!scene || !context) return false;
    const [width, height] = [Math.round(scene.width * scene.ratio), Math.round(scene.height * scene.ratio)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    drawBars(context, scene);
    return false;
  }

  destroy() {
    pageSlices().remove(this);
    this.scene = null;
  }
}
