/** Files of a job, at the addresses of docs/http.md. */

import type { Frame, Output } from './types';

export interface FileLink {
  label: string;
  /** What the file is, in a few words. */
  title: string;
  href: string;
  bytes: number;
}

/** Roles of the files of a frame: label, last part of the address, and what they are. */
const FRAME_FILES: readonly [role: string, label: string, path: string, title: string][] = [
  ['image', 'EXR', 'image.exr', 'the image, linear'],
  ['preview', 'PNG', 'preview.png', 'the image under its own exposure'],
  ['still', 'Still', 'still.png', 'PNG under the exposure of all frames'],
  ['painted', 'Painted', 'painted.png', 'the painted picture, PNG'],
  ['layer-image', 'Layers', 'layers.exr', 'the layers of the image, EXR'],
  ['statistics', 'Statistics', 'statistics.paths', 'light statistics, for femc paths'],
];

/** The address of a file. A player that is given `digest` loads the file again after it has changed. */
export const fileAddress = (job: number, path: string, digest?: string): string =>
  `/api/v1/jobs/${job}/${path}${digest ? `?v=${digest.slice(0, 12)}` : ''}`;

/** The output of a role that a frame has, or that the whole job has for it. */
function outputOf(role: string, frame: Frame, place: number, whole: Frame | null): Output | undefined {
  // The whole job lists these in the order of frames.
  if (role === 'still' || role === 'painted') return whole?.outputs.filter((output) => output.role === role)[place];
  return frame.outputs.find((output) => output.role === role);
}

/**
 * The files of a frame that are finished.
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

/** The files of the whole job that are finished. */
export function jobFiles(job: number, whole: Frame | null): FileLink[] {
  const files: [string, string, string, string][] = [
    ['clip', 'Clip', 'clip', 'all frames as a clip'],
    ['sheet', 'Contact sheet', 'sheet.png', 'all frames on one PNG'],
  ];
  return files.flatMap(([role, label, path, title]) => {
    const output = whole?.outputs.find((it) => it.role === role);
    return output ? [{ label, title, href: fileAddress(job, path), bytes: output.bytes }] : [];
  });
}
