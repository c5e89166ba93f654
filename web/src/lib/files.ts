/** Files of a job, at the URLs of docs/http.md. */

import type { Frame, Output } from './types';

export interface FileLink {
  label: string;
  /** Short description of the file. */
  title: string;
  href: string;
  bytes: number;
}

/** Roles of the files of a frame: label, last part of the URL, and description. */
const FRAME_FILES: readonly [role: string, label: string, path: string, title: string][] = [
  ['image', 'EXR', 'image.exr', 'the linear image, EXR'],
  ['preview', 'PNG', 'preview.png', 'the image with its own exposure, PNG'],
  ['still', 'Still', 'still.png', 'the image with the exposure of all frames, PNG'],
  ['painted', 'Painted', 'painted.png', 'the painted picture, PNG'],
  ['layer-image', 'Layers', 'layers.exr', 'the layers of the image, EXR'],
  ['statistics', 'Statistics', 'statistics.paths', 'light statistics, for femc paths'],
  ['readings', 'Readings', 'readings.json', 'the measured light, JSON'],
];

/** Returns the URL of a file. With `digest` in the URL, a player reloads the file after it has changed. */
export const fileAddress = (job: number, path: string, digest?: string): string =>
  `/api/v1/jobs/${job}/${path}${digest ? `?v=${digest.slice(0, 12)}` : ''}`;

/** Returns a frame's output of a role, or the whole job's output for this frame. */
function outputOf(role: string, frame: Frame, place: number, whole: Frame | null): Output | undefined {
  // The whole job lists these outputs in the order of frames.
  if (role === 'still' || role === 'painted') return whole?.outputs.filter((output) => output.role === role)[place];
  return frame.outputs.find((output) => output.role === role);
}

/**
 * Returns the finished files of a frame.
 * - `frames`: all frames of the job, ascending.
 * - `whole`: results of the whole job.
 */
export function frameFiles(job: number, number: number, frames: readonly Frame[], whole: Frame | null): FileLink[] {
  const place = frames.findIndex((frame) => frame.frame === number);
  const frame = frames[place];
  if (!frame) return [];
  return FRAME_FILES.flatMap(([role, label, path, title]) => {
    const output = outputOf(role, frame, place, whole);
    return output
      ? [{ label, title, href: fileAddress(job, `frames/${number}/${path}`), bytes: output.bytes }]
      : [];
  });
}

/** Returns the finished files of the whole job. */
export function jobFiles(job: number, whole: Frame | null): FileLink[] {
  const files: [string, string, string, string][] = [
    ['clip', 'Clip', 'clip', 'all frames as a clip'],
    ['sheet', 'Contact sheet', 'sheet.png', 'all frames in one PNG'],
  ];
  return files.flatMap(([role, label, path, title]) => {
    const output = whole?.outputs.find((it) => it.role === role);
    return output ? [{ label, title, href: fileAddress(job, path), bytes: output.bytes }] : [];
  });
}
