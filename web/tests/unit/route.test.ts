import { describe, expect, test } from 'vitest';
import {
  formatAddress,
  formatNumbers,
  formatQuery,
  parseAddress,
  parseNumbers,
  parsePath,
  parseQuery,
  pathOf,
  withValues,
  type Route,
} from '../../src/lib/route';

describe('addresses', () => {
  const pages: [string, Route][] = [
    ['/jobs', { page: 'jobs' }],
    ['/jobs/7', { page: 'job', job: 7, tab: 'frames' }],
    ['/jobs/7/picture', { page: 'job', job: 7, tab: 'picture' }],
    ['/workers', { page: 'workers' }],
    ['/audit', { page: 'audit' }],
    ['/login', { page: 'login' }],
  ];
  test.each(pages)('%s names a page, and the page names it', (path, route) => {
    expect(parsePath(path)).toEqual(route);
    expect(pathOf(route)).toBe(path);
  });
  test.each(['/jobs/x', '/jobs/7/nothing', '/jobs/7/tasks/3', '/etc/passwd', '/jobs/-1', '/jobs/99999999999999999'])(
    '%s is no page',
    (path) => {
      expect(parsePath(path)).toEqual({ page: 'unknown', path });
    },
  );
  test('the root is the list of jobs', () => expect(parsePath('/')).toEqual({ page: 'jobs' }));
});

describe('settings in the address', () => {
  test('they come back as they were, and stay legible', () => {
    const query = { frames: '1..4,7', task: '7/12.0/render.0/3', filter: 'owner:ann a&b=ü' };
    const text = formatQuery(query);
    expect(text).toContain('frames=1..4,7&task=7/12.0/render.0/3');
    expect(parseQuery(text)).toEqual(query);
  });
  test('null and nothing remove a value, others stay', () => {
    expect(withValues({ a: '1', b: '2' }, { a: null, c: 3, d: '' })).toEqual({ b: '2', c: '3' });
    expect(formatQuery({})).toBe('');
  });
});

describe('numbers', () => {
  test('ranges come back as they were', () => {
    const numbers = [1, 2, 3, 4, 7, 9, 10, 12];
    expect(formatNumbers(numbers)).toBe('1..4,7,9,10,12');
    expect(parseNumbers(formatNumbers(numbers))).toEqual(numbers);
  });
  test('what is no number is left out, and no range is without an end', () => {
    expect(parseNumbers('x,3,,5..4,-2, 8')).toEqual([3, 8]);
    expect(parseNumbers(undefined)).toEqual([]);
    expect(parseNumbers('1..9999999999').length).toBe(1 << 20);
  });
});

describe('long addresses', () => {
  test('thousands of jobs come back from an address, of which little is sent', () => {
    const query = { filter: 'owner:ann', jobs: formatNumbers(Array.from({ length: 3000 }, (_, i) => 2 * i + 1)) };
    const url = new URL(`http://farm/jobs${formatAddress(query)}`);
    expect(url.search).toBe('?filter=owner:ann');
    expect(parseAddress(url)).toEqual(query);
    expect(parseNumbers(parseAddress(url).jobs).length).toBe(3000);
  });
  test('a short selection stays in the query', () => {
    expect(formatAddress({ jobs: '1..2000' })).toBe('?jobs=1..2000');
    expect(formatAddress({})).toBe('');
  });
});
