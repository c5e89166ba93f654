/// <reference types="node" />
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { afterEach, expect, test, vi } from 'vitest';
import { light } from '../../src/lib/light/api';
import { decodeColumns, NONE, type Columns, type ColumnType } from '../../src/lib/light/columns';
import { GrowingAnswers, withKeptRows, type GrowingHeader } from '../../src/lib/light/delta';
import { encodeColumns } from './columns';

/** Answers that a test of `femc-pictures` writes. */
const fixture = (name: string) => {
  const bytes = readFileSync(join(import.meta.dirname, 'light-growth', `${name}.bin`));
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength) as ArrayBuffer;
};

/** Columns and header of an answer, in any order. */
function content(columns: Columns<GrowingHeader>) {
  const { columns: _, ...header } = columns.header as GrowingHeader & { columns?: unknown };
  const bits = (name: string) => {
    const array = columns.any(name);
    return [array.constructor.name, ...new Uint8Array(array.buffer, array.byteOffset, array.byteLength)].join();
  };
  return { header, columns: Object.fromEntries([...columns.names()].sort().map((name) => [name, bits(name)])) };
}

// ---- A server with rows of random values

interface Path {
  key: number;
  value: number;
  intersections: number[];
  /** Values of lights and the indices of their intersections; -1: none. */
  lights: [number, number][];
}

function drawing(seed: number) {
  let state = seed;
  return (below: number) => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) % below;
  };
}

function makePath(key: number): Path {
  const draw = drawing(key);
  const intersections = Array.from({ length: draw(4) }, () => draw(1000) / 8);
  const lights = Array.from({ length: draw(4) }, (): [number, number] => [draw(1000) / 8, draw(intersections.length + 1) - 1]);
  return { key, value: draw(5) ? draw(1000) / 8 : NaN, intersections, lights };
}

type Column = [string, ColumnType, number[]];

function values(rows: Path[]): Column[] {
  const out: Record<string, number[]> = { a: [], frame: [], sample: [], ip: [], iv: [], ipath: [], lv: [], li: [], lpath: [] };
  rows.forEach((row, at) => {
    const first = out.iv!.length;
    out.a!.push(row.value);
    out.frame!.push(row.key % 3);
    out.sample!.push(row.key);
    row.intersections.forEach((value, i) => {
      out.iv!.push(value);
      out.ip!.push(i ? first + i - 1 : NONE);
      out.ipath!.push(at);
    });
    row.lights.forEach(([value, parent]) => {
      out.lv!.push(value);
      out.li!.push(parent < 0 ? NONE : first + parent);
      out.lpath!.push(at);
    });
  });
  return [
    ['paths.a', 'f32', out.a!],
    ['paths.frame', 'u32', out.frame!],
    ['paths.sample', 'u32', out.sample!],
    ['intersections.b', 'f32', out.iv!],
    ['intersections.path', 'u32', out.ipath!],
    ['intersections.parent', 'u32', out.ip!],
    ['lights.c', 'f64', out.lv!],
    ['lights.path', 'u32', out.lpath!],
    ['lights.intersection', 'u32', out.li!],
  ];
}

/** Numbers of rows among all records, weights and marks; every fifth sample is not recorded. */
function whole(rows: Path[], salt: number) {
  const numbers = rows.map((row, i) => (row.key % 5 ? 7 * i + salt : NONE));
  const firsts = (of: (row: Path) => unknown[]) => rows.map((row, i) => (numbers[i] === NONE ? NONE : 3 * i + salt + of(row).length));
  const marks = (rows: Path[], of: (row: Path) => unknown[]) => rows.flatMap((row) => of(row).map((_, i) => (row.key + i + salt) % 2));
  const columns: Column[] = [
    ['paths.number', 'u32', numbers],
    ['paths.weight', 'f32', rows.map((_, i) => (i + salt) / 4)],
    ['paths.selected', 'u8', marks(rows, () => [0])],
    ['intersections.selected', 'u8', marks(rows, (row) => row.intersections)],
    ['lights.selected', 'u8', marks(rows, (row) => row.lights)],
  ];
  return { columns, intersections: firsts((row) => row.intersections), lights: firsts((row) => row.lights) };
}

function fullAnswer(rows: Path[], salt: number) {
  const { columns, intersections, lights } = whole(rows, salt);
  const numbers = (firsts: number[], of: (row: Path) => unknown[]) =>
    rows.flatMap((row, i) => of(row).map((_, k) => (firsts[i] === NONE ? NONE : firsts[i]! + k)));
  return encodeColumns({ tag: `t${salt}`, recorded: salt, growing: true, set: rows.length }, [
    ...values(rows),
    ...columns,
    ['intersections.number', 'u32', numbers(intersections, (row) => row.intersections)],
    ['lights.number', 'u32', numbers(lights, (row) => row.lights)],
  ]);
}

function differenceAnswer(rows: Path[], before: Path[], salt: number, since: string) {
  const { columns, intersections, lights } = whole(rows, salt);
  const kept = rows.map((row) => before.findIndex((other) => other.key === row.key));
  return encodeColumns({ tag: `t${salt}`, recorded: salt, growing: true, set: rows.length, since }, [
    ...values(rows.filter((_, i) => kept[i]! < 0)),
    ...columns,
    ['paths.kept', 'u32', kept.map((row) => (row < 0 ? NONE : row))],
    ['paths.first_intersection', 'u32', intersections],
    ['paths.first_light', 'u32', lights],
  ]);
}

const decode = (bytes: ArrayBuffer) => decodeColumns<GrowingHeader>(bytes);

test('rows of a real difference are those of the full answer', () => {
  const [earlier, full, difference] = ['earlier', 'full', 'difference'].map((name) => decode(fixture(name))) as [
    Columns<GrowingHeader>,
    Columns<GrowingHeader>,
    Columns<GrowingHeader>,
  ];
  const rebuilt = withKeptRows({ tag: 'earlier', columns: earlier }, difference);
  expect(content(rebuilt)).toEqual(content(full));
  expect(difference.u32('paths.kept').some((row) => row !== NONE)).toBe(true);
  expect(difference.u32('paths.frame').length).toBeGreaterThan(0);
  expect(withKeptRows(null, full)).toBe(full);
});

test('rows after random growth are those of the full answer', () => {
  let kept = 0;
  for (let seed = 1; seed <= 60; seed++) {
    const draw = drawing(seed);
    let before = Array.from({ length: draw(30) }, () => makePath(draw(400)));
    let held = decode(fullAnswer(before, seed));
    for (let step = 1; step <= 6; step++) {
      // Some rows leave, some enter, and the others may change their places.
      const keys = new Set(before.filter(() => draw(4) > 0).map((row) => row.key));
      for (let i = draw(12); i > 0; i--) keys.add(draw(400));
      const rows = [...keys].sort((a, b) => ((a * (step + 1)) % 401) - ((b * (step + 1)) % 401)).map(makePath);
      const salt = 100 * seed + step;
      const rebuilt = withKeptRows({ tag: 'held', columns: held }, decode(differenceAnswer(rows, before, salt, 'held')));
      expect(content(rebuilt), `seed ${seed}, step ${step}`).toEqual(content(decode(fullAnswer(rows, salt))));
      kept += rows.filter((row) => before.some((other) => other.key === row.key)).length;
      [before, held] = [rows, rebuilt];
    }
  }
  expect(kept).toBeGreaterThan(1000);
});

test('rows that do not fit together are refused', () => {
  const [a, b] = [[1, 2, 3].map(makePath), [2, 3, 4].map(makePath)];
  const held = { tag: 'x', columns: decode(fullAnswer(a, 1)) };
  const difference = decode(differenceAnswer(b, a, 2, 'x'));
  expect(() => withKeptRows(null, difference)).toThrow('does not have');
  expect(() => withKeptRows({ ...held, tag: 'y' }, difference)).toThrow('does not have');
  expect(() => withKeptRows({ tag: 'x', columns: decode(fullAnswer(a.slice(0, 1), 1)) }, difference)).toThrow('does not have');
  const tampered = decode(differenceAnswer(b, a, 2, 'x'));
  tampered.u32('paths.kept')[2] = 0;
  expect(() => withKeptRows(held, tampered)).toThrow('lack new rows');
});

test('the answers of two data sets are kept', () => {
  const answers = new GrowingAnswers<GrowingHeader>();
  const answer = { tag: 'a', columns: decode(fullAnswer([], 1)) };
  for (const key of ['0', '1', '2']) answers.set(key, answer);
  expect(['0', '1', '2'].map((key) => answers.get(key) !== null)).toEqual([false, true, true]);
  answers.set('2', null);
  expect(answers.get('2')).toBe(null);
});

afterEach(() => vi.unstubAllGlobals());

test('the page asks for new rows while data grow', async () => {
  const sets = [[1, 2, 3], [2, 3, 4], [2, 3, 4], [9]].map((keys) => keys.map(makePath));
  const asked: { since: string | null; known: string | null; cache: string }[] = [];
  const answers: (() => [status: number, body: ArrayBuffer | null, tag: string])[] = [
    () => [200, fullAnswer(sets[0]!, 1), 'one'],
    () => [200, differenceAnswer(sets[1]!, sets[0]!, 2, 'one'), 'two'],
    () => [304, null, 'two'],
    // The server was restarted.
    () => [200, fullAnswer(sets[3]!, 4), 'four'],
    // A faulty answer.
    () => [200, differenceAnswer(sets[1]!, sets[0]!, 2, 'unknown'), 'five'],
    () => [200, fullAnswer(sets[0]!, 6), 'six'],
  ];
  vi.stubGlobal('fetch', (path: string, init: RequestInit) => {
    const headers = new Headers(init.headers);
    asked.push({
      since: new URL(path, 'http://a').searchParams.get('since'),
      known: headers.get('If-None-Match'),
      cache: init.cache!,
    });
    const [status, body, tag] = answers[asked.length - 1]!();
    return Promise.resolve(new Response(body, { status, headers: { ETag: `"${tag}"` } }));
  });
  const ask = () => light.paths({ file: 77 }, { where: '', box: null, count: 5, among: 'all' });
  const full = [fullAnswer(sets[0]!, 1), fullAnswer(sets[1]!, 2), fullAnswer(sets[2]!, 2), fullAnswer(sets[3]!, 4)].map(decode);
  for (const expected of full) expect(content((await ask())!)).toEqual(content(expected));
  await expect(ask()).rejects.toThrow('does not have');
  await ask();
  expect(asked).toEqual([
    { since: null, known: null, cache: 'no-cache' },
    { since: 'one', known: '"one"', cache: 'no-store' },
    { since: 'two', known: '"two"', cache: 'no-store' },
    { since: 'two', known: '"two"', cache: 'no-store' },
    { since: 'four', known: '"four"', cache: 'no-store' },
    { since: null, known: null, cache: 'no-cache' },
  ]);
});
