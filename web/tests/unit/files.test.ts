import { expect, test } from 'vitest';
import { frameFiles, jobFiles } from '../../src/lib/files';
import type { Frame } from '../../src/lib/types';

const output = (role: string, bytes: number) => ({ role, digest: 'ab'.repeat(32), bytes });
const frame = (frame: number, outputs: Frame['outputs']) => ({ frame, outputs }) as Frame;

test('a frame has links to what is finished of it, and the whole job lists stills in the order of frames', () => {
  const frames = [
    frame(3, [output('image', 10), output('preview', 5), output('sums', 1), output('readings', 4)]),
    frame(5, []),
  ];
  const whole = frame(0, [output('still', 7), output('still', 8), output('clip', 9)]);
  const links = (number: number, whole: Frame | null) =>
    frameFiles(7, number, frames, whole).map(({ href, bytes }) => [href, bytes]);
  expect(links(3, null)).toEqual([
    ['/api/v1/jobs/7/frames/3/image.exr', 10],
    ['/api/v1/jobs/7/frames/3/preview.png', 5],
    ['/api/v1/jobs/7/frames/3/readings.json', 4],
  ]);
  expect(links(3, whole)).toContainEqual(['/api/v1/jobs/7/frames/3/still.png', 7]);
  expect(links(5, whole)).toEqual([['/api/v1/jobs/7/frames/5/still.png', 8]]);
  expect(links(4, whole)).toEqual([]);
  expect(jobFiles(7, whole).map(({ href }) => href)).toEqual(['/api/v1/jobs/7/clip']);
  expect(jobFiles(7, null)).toEqual([]);
});
