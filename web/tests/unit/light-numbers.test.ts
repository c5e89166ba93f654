import { describe, expect, it } from 'vitest';
import type { Estimate, LightAmount, Summary } from '../../src/lib/light/api';
import { parseBox, parseBoxes, whereIn } from '../../src/lib/light/boxes';
import { lightChoices, variedLabels } from '../../src/lib/light/choices';
import { allRow, cellsOf, differenceOf, isMarked, rowsOf, toCsv } from '../../src/lib/light/numbers';
import { describeCube } from '../../src/lib/light/scene/loads.svelte';
import type { Job } from '../../src/lib/types';

const estimate = (value: number, standard_error: number | null = null): Estimate => ({ value, standard_error });
const amount = (light: number, error: number | null, energy: number | null = null): LightAmount => ({
  paths: 10,
  light: estimate(light, error),
  records: 30,
  per_path: estimate(3, 0.1),
  energy: energy === null ? null : estimate(energy, 0.5),
});
const summary = (groups: Partial<Summary['groups']>): Summary => ({
  tag: 't',
  text: null,
  samples: 1000,
  recorded: 100,
  share: 0.1,
  total: amount(8, 0.3),
  groups: { object: [], bounce: [], lamp: [], ...groups },
  left_out: { object: 0, bounce: 0, lamp: 0 },
});
const row = (name: string, light: number, error: number | null = 0.1) => ({ ...amount(light, error), name, where: `object == ${name}` });

describe('light in numbers', () => {
  it('compares two amounts: difference, ratio, and their errors', () => {
    const it = differenceOf(amount(8, 0.3), amount(4, 0.4), 'light')!;
    expect(it.value).toBe(4);
    expect(it.standard_error).toBeCloseTo(0.5, 12);
    expect(it.z).toBeCloseTo(8, 12);
    expect(it.ratio).toBe(2);
    const factor = Math.exp(1.96 * Math.hypot(0.3 / 8, 0.1));
    expect(it.bounds![0]).toBeCloseTo(2 / factor, 12);
    expect(it.bounds![1]).toBeCloseTo(2 * factor, 12);
    expect(isMarked(it)).toBe(true);
    expect(isMarked(differenceOf(amount(8, 0.3), amount(7, 0.4), 'light'))).toBe(false);
  });
  it('does not guess an error that is unknown', () => {
    const it = differenceOf(amount(8, 0.3), amount(4, null), 'light')!;
    expect([it.standard_error, it.bounds, it.z, isMarked(it)]).toEqual([null, null, null, false]);
    expect(differenceOf(amount(8, 0.3), amount(4, 0.4), 'energy')).toBeNull();
    const same = differenceOf(amount(8, 0), amount(8, 0), 'light')!;
    expect([same.value, same.z]).toEqual([0, null]);
  });
  it('joins rows by name, and a row that one set lacks is 0 there', () => {
    const [a, b] = [summary({ lamp: [row('x', 5), row('y', 3)] }), summary({ lamp: [row('y', 2), row('z', 1)] })];
    const rows = rowsOf('lamp', a, b);
    expect(rows.map((it) => [it.name, it.a.light.value, it.b!.light.value])).toEqual([['x', 5, 0], ['y', 3, 2], ['z', 0, 1]]);
    // Without any path in B, the difference is that of A alone.
    const only = differenceOf(rows[0]!.a, rows[0]!.b!, 'light')!;
    expect([only.value, only.standard_error, only.ratio]).toEqual([5, 0.1, null]);
    expect(rowsOf('lamp', a, null).map((it) => it.b)).toEqual([null, null]);
  });
  it('sorts bounces by their number, also those of B alone', () => {
    const bounces = (...names: string[]) => summary({ bounce: names.map((name) => row(name, 1)) });
    expect(rowsOf('bounce', bounces('camera', '0', '10'), bounces('0', '2')).map((it) => it.name)).toEqual(['camera', '0', '2', '10']);
  });
  it('writes CSV with the columns of femc paths --by', () => {
    const [a, b] = [summary({ object: [row('a "b", c', 5)] }), summary({})];
    const lines = toCsv([allRow(a, b), ...rowsOf('object', a, b)]).trim().split('\n');
    expect(lines[0]).toBe(
      'by,name,paths,light,light_error,records,per_path,per_path_error,energy,energy_error,' +
        'paths_there,light_there,light_error_there,records_there,per_path_there,per_path_error_there,energy_there,energy_error_there,' +
        'difference,difference_error,ratio,ratio_low,ratio_high,standard_errors,differs,' +
        'energy_difference,energy_difference_error,energy_ratio,energy_ratio_low,energy_ratio_high',
    );
    expect(lines[2]).toMatch(/^object,"a ""b"", c",10,5,0.196/);
    expect(Object.keys(cellsOf(allRow(a, null)))).toHaveLength(10);
  });
});

describe('boxes', () => {
  it('reads boxes, and refuses others', () => {
    expect(parseBox('0,0,0,1,2,3')).toEqual([0, 0, 0, 1, 2, 3]);
    expect(['', undefined, '1,2,3', '0,0,0,1,-1,1', '0,0,0,1,x,1'].map(parseBox)).toEqual([null, null, null, null, null]);
    expect(parseBoxes('0,0,0,1,1,1', 'no')).toEqual([[0, 0, 0, 1, 1, 1], null]);
  });
  it('restricts a selection to a box', () => {
    expect(whereIn('', [0, 0, 0, 1, 1, 1])).toBe('in box(0,0,0,1,1,1)');
    expect(whereIn('a == 1 or b == 2', [0, 0, 0, 1, 1, 1])).toBe('(a == 1 or b == 2) and in box(0,0,0,1,1,1)');
  });
  it('describes the cube of a difference', () => {
    const box = (x: number, size: number) => [[x, 0, 0], [x + size, 1, 1]] as const;
    const cube = [[0, 0, 0], [4, 4, 4]] as const;
    expect(describeCube(box(0, 1), box(0, 1), cube)).toBe('A and B have the same box: one cube of 4 m for both.');
    expect(describeCube(box(0, 1), box(0.5, 1), cube)).toContain('differ: the voxels divide one cube of 4 m around both');
    expect(describeCube(box(0, 1), box(3, 1), cube)).toContain('have no place in common');
  });
});

describe('choices', () => {
  const job = (number: number, name: string, labels: Record<string, string>, scene = 'fog.mgf') => ({ job: number, name, labels, scene }) as Job;
  const own = job(7, 'fog-sigma_s=0.05', { 'medium.fog.sigma_s': '0.05', project: 'x' });
  it('finds the variants of a sweep by the values of their labels', () => {
    expect(variedLabels(own, job(8, 'b', { 'medium.fog.sigma_s': '0.1', project: 'x' }))).toEqual(['medium.fog.sigma_s']);
    expect(variedLabels(own, job(8, 'b', { 'medium.fog.sigma_s': '0.05', project: 'x' }))).toBeNull();
    expect(variedLabels(own, job(8, 'b', { project: 'x' }))).toBeNull();
    expect(variedLabels(own, job(8, 'b', { 'medium.fog.sigma_s': '0.1', project: 'x' }, 'other.mgf'))).toBeNull();
  });
  it('lists frames, variants with their values, and other jobs', () => {
    const jobs = [own, job(8, 'fog-sigma_s=0.1', { 'medium.fog.sigma_s': '0.1', project: 'x' }), job(9, 'room', {}, 'room.mgf')];
    expect(lightChoices(own, jobs, [1, 2], [2]).map(({ value, label, group }) => [value, label, group])).toEqual([
      ['7/1', 'frame 1', 'frames of this job'],
      ['7/2', 'frame 2', 'frames of this job'],
      ['8/2', 'sigma_s=0.1, frame 2 (job 8)', 'variants of this sweep'],
      ['9/2', 'job 9 room, frame 2', 'other jobs'],
    ]);
  });
});
