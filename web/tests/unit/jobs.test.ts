import { describe, expect, test } from 'vitest';
import { lines, matches, parseOrder, sorted } from '../../src/lib/jobs';
import { noLog } from '../../src/lib/logs';
import { fraction, secondsLeft } from '../../src/lib/progress';
import { refusal } from '../../src/lib/rights';
import { Attempts } from '../../src/lib/attempts';
import { layout } from '../../src/lib/timeline';
import type { Me, Role } from '../../src/lib/types';
import { attempt, job } from './fixtures';

const active = (frame: number, round: number, rounds: number, tiles_done: number, tiles: number) => ({
  frame,
  stage: 'render',
  round,
  rounds,
  tiles_done,
  tiles,
  running: 1,
  samples: 0,
  relative_error: null,
});

describe('filters', () => {
  const it = job(12, {
    name: 'Drive',
    owner: 'ann',
    state: 'failed',
    comment: 'before the Change',
    labels: { shot: '12', 'medium.fog.sigma_s': '0.02' },
  });
  test.each(['', 'drive', 'ann', '12', 'owner:a', 'state:failed,done', 'name:riv state:failed', '-state:done', 'change', 'label:shot=12',
    'label:shot', 'label:medium.fog.sigma_s=0.02 -label:take'])(
    '%s fits',
    (filter) => {
      expect(matches(it, filter)).toBe(true);
    },
  );
  test.each(['1', 'bob', 'owner:nn', 'state:done', 'drive -ann', 'drive bob', 'label:shot=1', 'label:sho', 'label:12'])('%s does not fit', (filter) => {
    expect(matches(it, filter)).toBe(false);
  });
});

describe('order and groups', () => {
  const jobs = [
    job(1, { name: 'b', scene: 'b', owner: 'eve' }),
    job(2, { name: 'a', scene: 'a' }),
    // A variant of a sweep.
    job(3, { name: 'b-ed=100', scene: 'b' }),
  ];
  test('the newest first, unless the address says otherwise', () => {
    expect(sorted(jobs, parseOrder(undefined)).map((it) => it.job)).toEqual([3, 2, 1]);
    expect(sorted(jobs, parseOrder('name')).map((it) => it.job)).toEqual([2, 1, 3]);
    expect(parseOrder('nonsense')).toEqual({ key: 'job', descending: true });
  });
  test('by age: the one submitted last is the youngest, and so counts one of which nobody knows', () => {
    const aged = [
      job(1, { submitted: 10 }),
      job(2, { submitted: 5, submitted_date: 30 }),
      job(3),
      job(4, { submitted: 20 }),
    ];
    expect(sorted(aged, parseOrder('age')).map((it) => it.job)).toEqual([3, 2, 4, 1]);
    expect(sorted(aged, parseOrder('-age')).map((it) => it.job)).toEqual([1, 4, 2, 3]);
  });
  test('groups stand where their first job would; one that is closed hides its jobs', () => {
    const all = lines(jobs, 'scene', new Set(['a']));
    expect(all.map((line) => (line.kind === 'group' ? line.key : line.job.job))).toEqual(['b', 1, 3, 'a']);
    expect(lines(jobs, 'none', new Set()).length).toBe(3);
  });
});

describe('progress', () => {
  test("finished frames and rounds of those in work count, the job's own stages do not", () => {
    const it = job(1, { frames: 4, frames_done: 1, active: [active(2, 1, 1, 5, 10), active(0, 1, 1, 1, 1)] });
    expect(fraction(it)).toBeCloseTo(1.5 / 4);
    expect(fraction(job(1, { frames: 1, active: [active(1, 3, 4, 0, 10)] }))).toBe(0.5);
    expect(fraction(job(1, { state: 'done', frames_done: 4 }))).toBe(1);
  });
  test('nobody tells the time left of what does not run', () => {
    expect(secondsLeft(job(1, { frames_done: 2, seconds: 30 }))).toBe(30);
    expect(secondsLeft(job(1, { frames_done: 2, state: 'paused' }))).toBeNull();
    expect(secondsLeft(job(1, { frames_done: 2, workers: 0 }))).toBeNull();
    expect(secondsLeft(job(1))).toBeNull();
  });
});

describe('rights', () => {
  const me = (role: Role | null): Me => ({
    name: 'ann',
    role,
    secured: role !== null,
    version: '1',
    engine: 'e',
    farm_time: 0,
  });
  const may = (role: Role | null, right: Parameters<typeof refusal>[2], readOnly = false) =>
    refusal(me(role), readOnly, right) === null;
  test('the table of the manual', () => {
    const roles: (Role | null)[] = ['viewer', 'submitter', 'operator', 'admin', null];
    expect(roles.map((role) => may(role, { kind: 'job', owner: 'ann' }))).toEqual([false, true, true, true, true]);
    expect(roles.map((role) => may(role, { kind: 'job', owner: 'bob' }))).toEqual([false, false, true, true, true]);
    expect(roles.map((role) => may(role, { kind: 'workers' }))).toEqual([false, false, true, true, true]);
    expect(roles.map((role) => may(role, { kind: 'audit' }))).toEqual([false, false, false, true, true]);
  });
  test('read-only refuses every change, and nothing that only looks', () => {
    expect(may('admin', { kind: 'workers' }, true)).toBe(false);
    expect(may('admin', { kind: 'audit' }, true)).toBe(true);
    expect(refusal(null, false, { kind: 'workers' })).not.toBeNull();
  });
});

describe('the timeline', () => {
  test('attempts side by side on a worker have lanes of their own, one after another share one', () => {
    const plan = layout([
      attempt('a', 0, 4),
      attempt('b', 1, 2),
      attempt('c', 4, 6),
      attempt('d', 0, 9, { worker: 'node-0' }),
    ]);
    expect(plan.bands).toEqual([
      { worker: 'node-0', first: 0, lanes: 1 },
      { worker: 'node-1', first: 1, lanes: 2 },
    ]);
    expect(Object.fromEntries(plan.bars.map((bar) => [bar.attempt.task, bar.lane]))).toEqual({
      d: 0,
      a: 1,
      b: 2,
      c: 1,
    });
    expect([plan.begin, plan.end]).toEqual([0, 9]);
  });
  test('pages are read once each, whatever the coordinator says of the next one', () => {
    const read = new Attempts();
    expect(read.add({ attempts: [attempt('a', 0, 1)], next: 5 })).toBe(true);
    expect(read.add({ attempts: [attempt('a', 0, 1)], next: 5 })).toBe(false);
    expect(read.add({ attempts: [], next: null })).toBe(false);
    expect(read.cursor).toBe(5);
    expect(read.all().length).toBe(1);
  });
});

describe('the reason why a task has no log', () => {
  const ended = (...endings: string[]) => noLog(endings.map((ending, at) => attempt('1/1.0/render.0/0', at, at + 1, { ending })));

  test('names short-lived logs of good tiles for tasks that are done alone', () => {
    expect(ended('done')).toContain('short-lived');
    for (const endings of [['failed'], ['lost'], ['revoked'], ['cancelled'], ['done', 'failed'], ['lost', 'done']]) {
      expect(ended(...endings), String(endings)).not.toContain('short-lived');
    }
  });

  test('is the worker that was lost, the failure, or the lease that was taken back', () => {
    expect(ended('lost')).toContain('lost before');
    expect(ended('lost', 'failed')).toContain('failed attempt');
    expect(ended('revoked')).toContain('lease was revoked');
    expect(ended()).toContain('No attempt has ended');
    expect(noLog(null)).toBe('Loading.');
  });
});
