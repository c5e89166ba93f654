import { beforeEach, describe, expect, test, vi } from 'vitest';
import { Columns, cut, labelsOf, nameParts, Scales, spansOf, type Column } from '../../src/lib/light/plot/column';
import type { Axis, AxisView, Brush, PlotSet } from '../../src/lib/light/plot/contract';
import { beginDrag, brushAfterKey, draggedBrush } from '../../src/lib/light/plot/drag';
import { Interaction } from '../../src/lib/light/plot/interaction.svelte';
import { heightAt, layoutOf, lengthOf, placeAt, xOf, yOf } from '../../src/lib/light/plot/layout';
import { Slices, type Job } from '../../src/lib/light/plot/slices';
import { lineAt, pointsOf, tipAt } from '../../src/lib/light/plot/tip';

const bins = (counts: Record<number, number>) => {
  const list = new Float64Array(64);
  for (const [k, n] of Object.entries(counts)) list[Number(k)] = n;
  return list;
};
const AXES: Axis[] = [
  { index: 0, name: 'depth', scale: 'count', edges: null, extent: null, categories: null },
  { index: 1, name: 'first.object', scale: 'name', edges: null, extent: null, categories: ['none', 'ball', 'room.wall'] },
  { index: 2, name: 'pixel.x', scale: 'film', edges: null, extent: [0, 64], categories: null },
];
const SET: PlotSet = {
  values: [Float32Array.of(1, 4), Float32Array.of(1, 2), Float32Array.of(0, 63)],
  rows: 2,
  selected: null,
  bins: [bins({ 1: 3, 4: 1 }), bins({ 1: 3, 2: 1 }), bins({ 0: 3, 63: 1 })],
  selectedBins: null,
  pair: () => null,
  total: 4,
  selectedTotal: 4,
  basis: 'recorded',
};
const VIEWS: AxisView[] = AXES.map(({ index }) => ({ index, hidden: false, log: false, flipped: false }));
const layout = layoutOf(3, 310, 320);
const brush = (axis: number, more: Partial<Brush> = {}): Brush => ({ axis, ranges: [], categories: [], inverted: false, ...more });

/** Columns of the plot with brushes. */
function columnsOf(brushes: Brush[] = [], views = VIEWS, known = new Columns(), scales = new Scales(), sets = [SET]): Column[] {
  const shown = views.map((view) => ({ view, axis: AXES[view.index]!, scale: scales.scaleOf(AXES[view.index]!, view.log, sets) }));
  return known.columnsOf(shown, layout, brushes);
}

describe('the layout', () => {
  test('axes have equal distances in the room, and at least 64 pixels', () => {
    expect([0, 1, 2].map((place) => xOf(layout, place))).toEqual([58, 158, 258]);
    expect(layout.width).toBe(310);
    expect(layoutOf(3, 100, 320).width).toBe(58 + 52 + 128);
    expect(layoutOf(1, 310, 320).width).toBe(110);
    expect([60, 107, 109, 400].map((x) => placeAt(layout, x))).toEqual([0, 0, 1, 3]);
  });

  test('heights and positions are inverse to each other, also on flipped axes', () => {
    for (const flipped of [false, true])
      for (const at of [0, 0.25, 1]) expect(heightAt(layout, yOf(layout, at, flipped), flipped)).toBeCloseTo(at);
    expect(yOf(layout, 1, false)).toBe(layout.top);
    expect(yOf(layout, 1, true)).toBe(layout.bottom);
    expect([-50, 900].map((y) => heightAt(layout, y, false))).toEqual([1, 0]);
  });
});

describe('columns', () => {
  test('only the columns that change are new objects', () => {
    const [known, scales] = [new Columns(), new Scales()];
    const before = columnsOf([], VIEWS, known, scales);
    expect(columnsOf([], [...VIEWS], known, scales)).toEqual(before);
    const after = columnsOf([brush(0, { ranges: [[1, 2]] })], VIEWS, known, scales);
    expect(after.map((it, i) => it === before[i])).toEqual([false, true, true]);
    expect(after[0]!.brush.ranges).toEqual([[1, 2]]);
    const flipped = columnsOf([brush(0, { ranges: [[1, 2]] })], VIEWS.map((it) => ({ ...it, flipped: it.index === 2 })), known, scales);
    expect(flipped.map((it, i) => it === after[i])).toEqual([true, true, false]);
    const words = columnsOf([brush(1, { categories: [2] })], VIEWS, known, scales);
    expect(words[1]!.brush.categories).toEqual([2]);
    expect(columnsOf([brush(1, { categories: [2], inverted: true })], VIEWS, known, scales)[1]!.brush.inverted).toBe(true);
  });

  test('counts that do not move an end of the axis keep its scale', () => {
    const scales = new Scales();
    const first = scales.scaleOf(AXES[0]!, false, [SET]);
    const more = { ...SET, bins: [bins({ 1: 9, 4: 7 })] };
    expect(scales.scaleOf(AXES[0]!, false, [more])).toBe(first);
    expect(scales.scaleOf(AXES[0]!, true, [more])).not.toBe(first);
    expect(scales.scaleOf(AXES[0]!, false, [{ ...SET, bins: [bins({ 1: 9, 5: 1 })] }]).high).toBe(6);
  });

  test('names, labels and spans', () => {
    expect([nameParts('radiance.r'), nameParts('depth')]).toEqual([['radiance', 'r'], ['', 'depth']]);
    expect([cut('room.wall', 300), cut('room.wall', 48), cut('chandelier', 40)]).toEqual(['room.wall', '…wall', 'chan…']);
    const [depth, object] = columnsOf([brush(0, { ranges: [[-Infinity, 1], [4, 4]] })]) as [Column, Column];
    const quarter = lengthOf(layout) / 4;
    expect(spansOf(depth, layout)).toEqual([
      { top: layout.bottom - quarter, size: quarter, range: 0 },
      { top: layout.top, size: quarter, range: 1 },
    ]);
    expect(labelsOf(object, layout).map((it) => it.text)).toEqual(['ball', 'room.wall']);
    const low = layoutOf(3, 310, 75);
    expect(labelsOf(object, low).map((it) => it.text)).toEqual(['ball']);
  });
});

describe('drags of brushes', () => {
  const y = (at: number) => yOf(layout, at, false);

  test('a press beside ranges begins a new one, in one moves it, at an end changes it', () => {
    const [depth] = columnsOf([brush(0, { ranges: [[1, 2]] })]) as [Column];
    const drag = (at: number, to: number) => draggedBrush(beginDrag(depth, layout, y(at), 10), layout, y(to)).ranges;
    expect(drag(0.8, 0.95)).toEqual([[1, 2], [4, 4]]);
    expect(drag(0.8, 1)).toEqual([[1, 2], [4, Infinity]]);
    expect(drag(0.25, 0.5)).toEqual([[2, 3]]);
    expect(drag(0.51, 0.75)).toEqual([[1, 3]]);
    expect(drag(0.01, 0.26)).toEqual([[2, 2]]);
    // A finger holds an end from farther away.
    expect(beginDrag(depth, layout, y(0.57), 10).mode).toBe('new');
    expect(beginDrag(depth, layout, y(0.57), 22).mode).toBe('high');
  });

  test('ends of a flipped axis are the other way around', () => {
    const views = VIEWS.map((it) => ({ ...it, flipped: true }));
    const [depth] = columnsOf([brush(0, { ranges: [[1, 2]] })], views) as [Column];
    expect(beginDrag(depth, layout, yOf(layout, 0.5, true), 10).mode).toBe('high');
  });

  test('a drag over categories adds them', () => {
    const object = columnsOf([brush(1, { categories: [2] })])[1]!;
    expect(draggedBrush(beginDrag(object, layout, y(0.99), 10), layout, y(0.9)).categories).toEqual([1, 2]);
  });

  test('keys move an end, not past the other one, and remove the range', () => {
    const [depth] = columnsOf([brush(0, { ranges: [[2, 3]] })]) as [Column];
    expect(brushAfterKey(depth, 0, 0, 'ArrowUp')?.ranges).toEqual([[3, 3]]);
    expect(brushAfterKey(depth, 0, 1, 'PageDown')?.ranges).toEqual([[2, 2]]);
    expect(brushAfterKey(depth, 0, 1, 'End')?.ranges).toEqual([[2, Infinity]]);
    expect(brushAfterKey(depth, 0, 1, 'Delete')?.ranges).toEqual([]);
    expect(brushAfterKey(depth, 0, 1, 'a')).toBeNull();
    expect(brushAfterKey(depth, 1, 1, 'End')).toBeNull();
  });
});

describe('values under the pointer', () => {
  test('the bar at an axis, with its selected part', () => {
    const columns = columnsOf();
    expect(tipAt(columns, [SET], layout, 60, yOf(layout, 0.1, false))).toEqual({
      x: 58,
      y: yOf(layout, 0.1, false),
      head: '1',
      rows: [{ name: 'recorded', text: '3 (75.0 %)', kind: '' }],
    });
    expect(tipAt(columns, [SET], layout, 108, 100)).toBeNull();
    const chosen = { ...SET, basis: 'all samples' as const, selectedBins: [bins({ 1: 1 }), bins({}), bins({})] };
    const tip = tipAt(columns, [chosen, chosen], layout, 158, yOf(layout, 0.9, false))!;
    expect(tip.head).toBe('ball');
    expect(tip.rows.map((it) => `${it.name} ${it.kind}`)).toEqual(['A, all samples a', 'selected, recorded ', 'B, all samples b', 'selected, recorded ']);
  });

  test('the nearest line between two axes, with its values on all axes', () => {
    const columns = columnsOf();
    const [first, second] = [0, 1].map((row) => pointsOf({ set: 0, row }, columns, [SET], layout)!);
    expect(first!.map((it) => it.text)).toEqual(['1', 'ball', '0']);
    expect(second!.map((it) => it.text)).toEqual(['4', 'room.wall', '63']);
    const middle = { x: 108, y: (second![0]!.y + second![1]!.y) / 2 };
    expect(lineAt(columns, [SET], layout, middle.x, middle.y)).toEqual({ set: 0, row: 1 });
    expect(lineAt(columns, [SET], layout, 300, middle.y)).toBeNull();
  });
});

describe('slices', () => {
  /** A browser whose time passes with the work. */
  class Browser {
    ms = 0;
    readonly frames: (() => void)[] = [];
    readonly tasks: (() => void)[] = [];
    readonly slices = new Slices({ now: () => this.ms, frame: (run) => this.frames.push(run), task: (run) => this.tasks.push(run) }, 8);

    job(pieces: number, pieceMs: number, log: string[] = [], name = ''): Job {
      return {
        step: () => {
          this.ms += pieceMs;
          log.push(name);
          return --pieces > 0;
        },
      };
    }
  }

  test('jobs take turns, and a slice ends with its time', () => {
    const browser = new Browser();
    const log: string[] = [];
    browser.slices.add(browser.job(3, 3, log, 'a'));
    browser.slices.add(browser.job(2, 3, log, 'b'));
    expect(log).toEqual([]);
    expect(browser.frames.length).toBe(1);
    browser.frames.shift()!();
    expect(log).toEqual(['a', 'b', 'a']);
    expect(browser.tasks.length).toBe(1);
    browser.tasks.shift()!();
    expect(log).toEqual(['a', 'b', 'a', 'b', 'a']);
    expect([...browser.frames, ...browser.tasks]).toEqual([]);
  });

  test('work that is added twice is done once, also while it is waiting for its next piece', () => {
    const browser = new Browser();
    const log: string[] = [];
    const job = browser.job(2, 9, log, 'a');
    browser.slices.add(job);
    browser.slices.add(job);
    browser.frames.shift()!();
    browser.slices.add(job);
    expect(browser.frames.length).toBe(0);
    browser.tasks.shift()!();
    expect(log).toEqual(['a', 'a']);
    expect(browser.tasks.length).toBe(0);
  });

  test('removed work is not done, and new work begins with a frame again', () => {
    const browser = new Browser();
    const log: string[] = [];
    const job = browser.job(5, 1, log, 'a');
    browser.slices.add(job);
    browser.slices.remove(job);
    browser.frames.shift()!();
    expect(log).toEqual([]);
    browser.slices.add(job);
    expect(browser.frames.length).toBe(1);
  });
});

describe('the interaction', () => {
  const frames: (() => void)[] = [];
  beforeEach(() => {
    frames.length = 0;
    vi.stubGlobal('requestAnimationFrame', (run: () => void) => frames.push(run));
    vi.stubGlobal('cancelAnimationFrame', () => (frames.length = 0));
  });

  function begin(lock: string | null = null) {
    const state = { views: VIEWS, brushes: [] as Brush[], calls: [] as [Brush[], boolean][], taps: 0 };
    const [known, scales] = [new Columns(), new Scales()];
    const it: Interaction = new Interaction(
      {
        views: () => state.views,
        brushes: () => state.brushes,
        lock: () => lock,
        columns: () => columnsOf([...it.brushes], [...it.views], known, scales),
        layout: () => layout,
        field: () => ({ getBoundingClientRect: () => ({ left: 0, top: 0 }) }) as HTMLElement,
        onviews: (next) => (state.views = next),
        onbrushes: (next, isFinal) => {
          state.calls.push([next, isFinal]);
          state.brushes = next;
        },
        ongrab: () => {},
        ontap: () => state.taps++,
      },
      () => false,
    );
    const column = (index: number) => columnsOf([...it.brushes], [...it.views], known, scales).find((column) => column.index === index)!;
    return { it, state, column };
  }
  const event = (x: number, at: number, more: object = {}) =>
    ({ button: 0, clientX: x, clientY: yOf(layout, at, false), currentTarget: { setPointerCapture() {} }, pointerType: 'mouse', ...more }) as unknown as PointerEvent;

  test('a drag tells the page of its brush once a frame, and once more at its end', () => {
    const { it, state, column } = begin();
    it.down(event(58, 0.05), column(0));
    expect(it.isDragging).toBe(true);
    for (const at of [0.2, 0.3, 0.4]) it.move(event(58, at));
    expect(state.calls).toEqual([]);
    expect(frames.length).toBe(1);
    frames.shift()!();
    expect(state.calls).toEqual([[[brush(0, { ranges: [[1, 2]] })], false]]);
    it.move(event(58, 0.6));
    it.up(event(58, 0.7));
    expect(frames.length).toBe(0);
    expect(state.calls.slice(1)).toEqual([[[brush(0, { ranges: [[1, 3]] })], true]]);
    expect(it.isDragging).toBe(false);
  });

  test('a press that does not move selects a category, and a touch shows the values', () => {
    const { it, state, column } = begin();
    it.down(event(158, 0.9), column(1));
    it.up(event(158, 0.9, { pointerType: 'touch' }));
    expect(state.brushes).toEqual([brush(1, { categories: [1] })]);
    expect(state.taps).toBe(1);
  });

  test('a cancelled drag leaves the brushes as they were; a locked plot has no drags', () => {
    const { it, state, column } = begin();
    it.down(event(58, 0.1), column(0));
    it.move(event(58, 0.6));
    frames.shift()!();
    it.cancel();
    expect(state.brushes).toEqual([]);
    const locked = begin('no');
    locked.it.down(event(58, 0.1), locked.column(0));
    locked.it.finish(brush(0, { ranges: [[1, 2]] }));
    expect([locked.it.isDragging, locked.state.calls]).toEqual([false, []]);
  });

  test('two moves of an axis in succession both count', () => {
    const { it, state } = begin();
    it.shift(0, 1);
    it.shift(0, 1);
    expect(state.views.map((view) => view.index)).toEqual([1, 2, 0]);
    it.shift(0, 1);
    expect(state.views.map((view) => view.index)).toEqual([1, 2, 0]);
  });

  test('a title is dragged to another place, and the click after it opens no menu', () => {
    const { it, state, column } = begin();
    it.titleDown(event(60, 1), column(0));
    it.titleMove(event(63, 1));
    it.titleMove(event(175, 1));
    expect(it.views.map((view) => view.index)).toEqual([1, 0, 2]);
    expect(state.views).toBe(VIEWS);
    expect(it.titleDrag).toEqual({ index: 0, x: 2, dx: 15, hasMoved: true });
    it.titleUp();
    expect(state.views.map((view) => view.index)).toEqual([1, 0, 2]);
    expect([it.skipClick(), it.skipClick()]).toEqual([true, false]);
  });
});
