import { describe, expect, test } from 'vitest';
import { formatSource, parseSource, type Schema } from '../../src/lib/light/api';
import { decodeColumns } from '../../src/lib/light/columns';
import {
  axesOf,
  BrushError,
  brushText,
  countIn,
  brushesOf,
  categoriesOf,
  defaultViews,
  formatViews,
  mismatch,
  namesOf,
  objectNames,
  parseViews,
  plotBins,
  plotPair,
  plotValues,
  rowsOf,
  selectedRows,
  unite,
  withBrushes,
  type Histograms,
} from '../../src/lib/light/data';
import { densityScale, spreadOut } from '../../src/lib/light/density';
import { smooth } from '../../src/lib/picture';
import { formatChips, toChips } from '../../src/lib/light/text';
import type { Brush, TableName } from '../../src/lib/light/plot/contract';
import { encodeColumns } from './columns';

const edges = Array.from({ length: 64 }, (_, i) => i);
const schema = (names: string[] = ['room.wall', 'ball', 'lamp']): Schema => ({
  tag: 't',
  version: 1,
  growing: false,
  frames: [1],
  film: [16, 8],
  box: [
    [0, 0, 0],
    [1, 2, 3],
  ],
  samples: 100,
  bad_samples: 0,
  share: 0.25,
  recorded: 3,
  full_histograms: false,
  counts: { paths: 3, intersections: 2, lights: 1 },
  tables: {
    paths: [
      { name: 'pixel.x', scale: 'film', field: 'pixel.x' },
      { name: 'radiance.r', scale: 'radiance', field: 'path.radiance.r' },
      { name: 'depth', scale: 'count', field: 'depth' },
      { name: 'end', scale: 'class', field: 'end', words: ['escaped', 'absorbed'] },
      { name: 'first.object', scale: 'name', field: 'first.object' },
    ],
    intersections: [
      { name: 'position.y', scale: 'world', field: 'position.y' },
      { name: 'object', scale: 'name', field: 'object' },
    ],
    lights: [{ name: 'radiance.r', scale: 'radiance', field: 'light.radiance.r' }],
  },
  names,
  kinds: names.map((name) => (name === 'lamp' ? 'light' : 'object')),
  words: {},
  radiance_edges: edges,
  throughput_edges: edges,
});

const bins = (counts: Record<number, number>) => Array.from({ length: 64 }, (_, i) => counts[i] ?? 0);
const histograms = (
  first: Record<number, number>,
  categories: Record<string, number[]>,
  pair: Record<number, number> = {},
): Histograms =>
  decodeColumns(
    encodeColumns({ tag: 't', recorded: 3, counted: 'recorded', categories }, [
      ...[0, 1, 2, 3].map((i): [string, 'f64', number[]] => [`paths.${i}`, 'f64', bins({})]),
      ['paths.4', 'f64', bins(first)],
      ['paths.4-2', 'f32', Array.from({ length: 4096 }, (_, i) => pair[i] ?? 0)],
      ['intersections.0', 'f64', bins({})],
      ['intersections.1', 'f64', bins({ 1: 1, 2: 1 })],
      ['lights.0', 'f64', bins({})],
    ]),
  );

const CATEGORIES = { 'paths.first.object': [1, 0], 'intersections.object': [0, 1] };

describe('names as categories', () => {
  const a = { schema: schema(), histograms: histograms({ 0: 5, 1: 3, 2: 2 }, CATEGORIES, { [1 * 64 + 7]: 4 }) };
  const other = {
    schema: schema(['chair', 'ball', 'room.wall', 'door']),
    histograms: histograms({ 1: 7, 2: 6, 3: 5, 63: 1 }, { ...CATEGORIES, 'paths.first.object': [2, 0, 1] }, { [2 * 64]: 9, 63: 1 }),
  };

  test('by falling share, without others if there are none', () => {
    const categories = categoriesOf([a]);
    const [axis] = axesOf(a.schema, 'paths', categories, a.schema.box).slice(4);
    expect(axis!.categories).toEqual(['none', 'ball', 'room.wall']);
    expect([...plotBins(a, a.histograms, 'paths', categories)[4]!.slice(0, 4)]).toEqual([5, 3, 2, 0]);
  });

  test('a second data set has the categories of the first, by name', () => {
    const categories = categoriesOf([a, other]);
    const axes = axesOf(a.schema, 'paths', categories, a.schema.box);
    expect(axes[4]!.categories).toEqual(['none', 'ball', 'room.wall', 'chair', 'others']);
    // Its bins are room.wall 7, chair 6, ball 5, others 1.
    expect([...plotBins(other, other.histograms, 'paths', categories)[4]!.slice(0, 6)]).toEqual([0, 5, 7, 6, 1, 0]);
    const counts = other.histograms.f32('paths.4-2');
    const pair = plotPair(other, counts, 'paths', [4, 2], categories);
    expect([pair[3 * 64], pair[2 * 64], pair[63]]).toEqual([9, 0, 1]);
    expect(plotPair(other, counts, 'paths', [2, 0], categories)).toBe(counts);
  });

  test('rows, too, and a name without a category is one of the others', () => {
    const categories = categoriesOf([a, other]);
    const answer = decodeColumns(
      encodeColumns({ tag: 't', recorded: 3, set: 4, candidates: 9, d: 0.5, dj: null, effective_size: 3 }, [
        ...['pixel.x', 'radiance.r', 'depth', 'end'].map((name): [string, 'f32', number[]] => [
          `paths.${name}`,
          'f32',
          [1, 2, 3, 4],
        ]),
        ['paths.first.object', 'f32', [0, 1, 3, 4]],
        ['paths.number', 'u32', [0, 2, 9, 0xffffffff]],
        ['paths.frame', 'u32', [1, 1, 1, 1]],
        ['paths.sample', 'u32', [0, 1, 2, 3]],
        ...['position.y', 'object'].map((name): [string, 'f32', number[]] => [`intersections.${name}`, 'f32', [1]]),
        ['intersections.number', 'u32', [0]],
        ['intersections.path', 'u32', [0]],
        ['intersections.parent', 'u32', [0xffffffff]],
        ['lights.radiance.r', 'f32', []],
        ['lights.number', 'u32', []],
        ['lights.path', 'u32', []],
        ['lights.intersection', 'u32', []],
      ]),
    ) as unknown as Parameters<typeof rowsOf>[1];
    const rows = rowsOf(other.schema, answer);
    expect(rows).toMatchObject({ set: 4, candidates: 9, d: 0.5, dj: null, effectiveSize: 3 });
    const values = plotValues(other.schema, 'paths', rows, categories);
    // none, chair, room.wall, door
    expect([...values[4]!]).toEqual([0, 3, 2, 4]);
    expect(values[0]).toBe(rows.values.paths[0]);
    expect([...selectedRows(rows.numbers.paths, Uint8Array.of(0b100, 0b10))]).toEqual([0, 1, 1, 0]);
  });

  test('other attributes are refused with a name', () => {
    expect(mismatch(a.schema, other.schema)).toBeNull();
    const odd = schema();
    odd.tables.lights = [{ name: 'power', scale: 'radiance', field: 'power' }];
    expect(mismatch(a.schema, odd)).toContain('lights have different attributes: radiance.r');
    const words = schema();
    words.tables.paths[3]!.words = ['escaped'];
    expect(mismatch(a.schema, words)).toContain('different words');
    expect(unite(a.schema.box, [[-1, 1, 1], [0, 1, 5]])).toEqual([[-1, 0, 0], [1, 2, 5]]);
  });

  test('objects and what contains them', () => {
    expect(objectNames(schema(['room.left/door', 'ball', 'lamp']))).toEqual(['ball', 'room', 'room.left', 'room.left/door']);
  });
});

describe('brushes and the text of the selection', () => {
  const it = schema();
  const categories = categoriesOf([{ schema: it, histograms: histograms({ 1: 3, 2: 2, 63: 1 }, CATEGORIES) }]);
  const axes = (table: TableName) => axesOf(it, table, categories, it.box);
  const brush = (axis: number, more: Partial<Brush>): Brush => ({ axis, ranges: [], categories: [], inverted: false, ...more });
  const written = (text: string, table: TableName, brushes: Brush[]) =>
    formatChips(withBrushes(toChips(text), table, brushes, it, axes(table)));
  const read = (text: string, table: TableName) => brushesOf(toChips(text), table, it.tables[table], axes(table));

  test.each<[TableName, Brush[], string]>([
    ['paths', [brush(2, { ranges: [[3, 5]] })], 'depth >= 3 and depth <= 5'],
    ['paths', [brush(0, { ranges: [[0, 2], [4, 15]], inverted: true })], 'not (pixel.x >= 0 and pixel.x <= 2 or pixel.x >= 4 and pixel.x <= 15)'],
    ['paths', [brush(1, { ranges: [[0.5, Infinity]] }), brush(3, { categories: [0, 2] })], 'path.radiance.r >= 0.5 and (not (end == escaped or end == absorbed) or end == absorbed)'],
    ['paths', [brush(2, { ranges: [[0, 2], [4, 15]] })], 'depth >= 0 and depth <= 2 or depth >= 4 and depth <= 15'],
    ['paths', [brush(4, { categories: [1] })], 'first.object == ball'],
    ['intersections', [brush(0, { ranges: [[1, 2]] })], 'any(position.y >= 1 and position.y <= 2)'],
    ['intersections', [brush(0, { ranges: [[1, 2]] }), brush(1, { categories: [1, 2], inverted: true })], 'any(position.y >= 1 and position.y <= 2 and not (object == room.wall or object == ball))'],
    ['lights', [brush(0, { ranges: [[-Infinity, 2]] })], 'light(light.radiance.r <= 2)'],
  ])('%s: %j', (table, brushes, text) => {
    const now = written('', table, brushes);
    // A union that stands alone needs no parentheses.
    expect(now).toBe(text);
    expect(read(now, table)).toEqual(brushes);
    // Within a longer selection, and for the other plots nothing.
    const longer = written('a then b or sample == 1', table, brushes);
    expect(longer.startsWith('(a then b or sample == 1) and ')).toBe(true);
    expect(read(longer, table)).toEqual(brushes);
    expect(written(longer, table, [])).toBe('a then b or sample == 1');
  });

  test('others are the names that are not listed; none is what equals no name', () => {
    const more = { ...it, names: [...it.names, 'chair', 'chair.leg'], kinds: [...it.kinds, 'object', 'object'] };
    const all = axesOf(more, 'paths', categories, it.box);
    expect(all[4]!.categories).toEqual(['none', 'ball', 'room.wall', 'others']);
    const text = formatChips(withBrushes(toChips(''), 'paths', [brush(4, { categories: [0, 3] })], more, all));
    expect(text).toBe(
      'not (first.object == room or first.object == ball or first.object == chair) or first.object == chair or first.object == chair.leg',
    );
    expect(brushesOf(toChips(text), 'paths', more.tables.paths, all)[0]!.categories).toEqual([0]);
  });

  test('media belong to the materials and to the lights; too many others are refused', () => {
    const names = ['ball', 'glass', 'fog', 'lamp'];
    const more = { ...it, names, kinds: ['object', 'material', 'medium', 'light'] };
    const axis = (name: string) => ({ name, scale: 'name' as const, field: name });
    expect(namesOf(more, axis('material'))).toEqual(['glass', 'fog']);
    expect(namesOf(more, axis('light'))).toEqual(['fog', 'lamp']);
    expect(namesOf(more, axis('occluder'))).toEqual(['ball']);
    const many = Array.from({ length: 202 }, (_, i) => `m${i}`);
    const large = { ...it, names: many, kinds: many.map(() => 'material') };
    const shown = { ...axes('paths')[4]!, categories: ['none', 'm0', 'others'] };
    const others = brush(4, { categories: [2] });
    expect(() => brushText(others, axis('material'), shown, large)).toThrow(BrushError);
    expect(() => brushText(others, axis('material'), shown, large)).toThrow('201 names');
    const fewer = { ...shown, categories: ['none', 'm0', 'm1', 'others'] };
    expect(brushText(brush(4, { categories: [3] }), axis('material'), fewer, large)?.split(' or ').length).toBe(200);
  });

  test('a range of all numbers is no brush', () => {
    expect(written('depth >= 3', 'paths', [brush(2, { ranges: [[-Infinity, Infinity]] })])).toBe('');
    expect(written('', 'paths', [brush(1, { ranges: [[200, Infinity]] })])).toBe('path.radiance.r >= 200');
    expect(countIn(bins({ 0: 2, 5: 3 }))).toBe(5);
  });

  test('what does not change keeps its text, its place and its quantifier', () => {
    const text = 'depth > 2 and not all(position.y <= 1) or end == escaped';
    expect(written(text, 'paths', read(text, 'paths'))).toBe(text);
    const moved = read(text, 'intersections');
    expect(moved).toEqual([brush(0, { ranges: [[-Infinity, 1]], inverted: true })]);
    expect(written(text, 'intersections', [{ ...moved[0]!, ranges: [[0.25, 1]] }])).toBe(
      'depth > 2 and not all(position.y >= 0.25 and position.y <= 1) or end == escaped',
    );
    expect(written(text, 'intersections', [])).toBe('depth > 2 or end == escaped');
    expect(written('any(object == ball)', 'intersections', [...read('any(object == ball)', 'intersections'), brush(0, { ranges: [[0, 1]] })])).toBe(
      'any(object == ball and position.y >= 0 and position.y <= 1)',
    );
  });
});

describe('the address', () => {
  test('axes', () => {
    const axes = axesOf(schema(), 'paths', categoriesOf([]), schema().box);
    const usual = defaultViews(axes);
    expect(formatViews(usual, axes)).toBeNull();
    const views = [usual[2]!, { ...usual[0]!, hidden: true }, { ...usual[1]!, flipped: true, log: false }, ...usual.slice(3)];
    expect(formatViews(views, axes)).toBe('2,0h,1fl,3,4');
    expect(parseViews('2,0h,1fl,3,4', axes)).toEqual(views);
    expect(parseViews('9,x,2,2', axes).map((view) => view.index)).toEqual([2, 0, 1, 3, 4]);
    expect(parseViews(undefined, axes)).toEqual(usual);
  });

  test('data sets', () => {
    expect(parseSource('7/1..3,9')).toEqual({ job: 7, frames: [1, 2, 3, 9] });
    expect(formatSource({ job: 7, frames: [1, 2, 3, 9] })).toBe('7/1..3,9');
    expect(parseSource('2')).toEqual({ file: 2 });
    expect(formatSource({ file: 2 })).toBe('2');
    expect([undefined, '', '7/', 'fx', '../x'].map(parseSource)).toEqual([null, null, null, null, null]);
  });
});

describe('density', () => {
  const density = { pixel: Uint32Array.of(0, 5, 99), count: Float32Array.of(1, 100, 7), light: Float32Array.of(2, 3, 4) };

  test('of the pixels of the film', () => {
    const values = spreadOut(density, 'count', [4, 2], 0);
    expect([...values]).toEqual([1, 0, 0, 0, 0, 100, 0, 0]);
    expect(spreadOut(density, 'light', [4, 2], 0)[5]).toBe(3);
    const film: [number, number] = [23, 17];
    const some = { ...density, pixel: Uint32Array.of(0, 200, 390), light: density.count };
    for (const sigma of [0.5, 1, 4]) {
      const due = smooth(spreadOut(some, 'count', film, 0), ...film, sigma);
      spreadOut(some, 'count', film, sigma).forEach((v, i) => expect(v).toBeCloseTo(due[i]!, 4));
    }
    expect(densityScale(values, true)).toEqual({ low: 1, high: 100, logarithmic: true });
    expect(densityScale(values, false)).toEqual({ low: 0, high: 100, logarithmic: false });
    expect(densityScale(new Float32Array(4), true)).toBeNull();
  });
});
