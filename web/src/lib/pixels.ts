/** Decodes the pixels of a frame as the coordinator sends them (`application/vnd.femc.pixels`, version 1). */

import { halves } from './half';

export const MAGIC = 0x43584d46;
const NOT_A_NUMBER = 0x7e00;
/** Channels in which values may be missing. */
const UNKNOWN = new Set(['error', 'standard_error', 'freedom', 'depth', 'throughput', 'deviation']);

/** Pixels of a frame: planes of half floats, row by row from the top left. */
export class Pixels {
  constructor(
    readonly width: number,
    readonly height: number,
    readonly planes: ReadonlyMap<string, Uint16Array>,
  ) {}

  /** Checks whether the channel exists. */
  has(channel: string): boolean {
    return this.planes.has(channel);
  }

  /** Returns the value of a channel at a pixel; NaN if it is missing. */
  at(channel: string, x: number, y: number): number {
    const plane = this.planes.get(channel);
    if (!plane || x < 0 || y < 0 || x >= this.width || y >= this.height) return NaN;
    return halves()[plane[y * this.width + x]!]!;
  }

  /** Returns a channel as floats. */
  floats(channel: string): Float32Array | null {
    const plane = this.planes.get(channel);
    if (!plane) return null;
    const table = halves();
    const out = new Float32Array(plane.length);
    for (let i = 0; i < plane.length; i++) out[i] = table[plane[i]!]!;
    return out;
  }
}

/** Replaces missing values, which are sent as -1, by NaN. Negative half floats have the highest bit set. */
function forget(plane: Uint16Array) {
  for (let i = 0; i < plane.length; i++) if (plane[i]! > 0x8000) plane[i] = NOT_A_NUMBER;
}

/** Decodes the coordinator's answer; throws an `Error` with a description if it is invalid. */
export function decodePixels(buffer: ArrayBuffer): Pixels {
  const view = new DataView(buffer);
  let at = 0;
  const u32 = (what: string) => {
    if (at + 4 > buffer.byteLength) throw new Error(`the pixels end early, at ${what}`);
    at += 4;
    return view.getUint32(at - 4, true);
  };
  if (u32('the magic number') !== MAGIC) throw new Error('the answer does not contain the pixels of a frame');
  const version = u32('the version');
  if (version !== 1) throw new Error(`the pixels have version ${version}, but this page reads version 1: reload the page`);
  const [width, height, channels] = [u32('the width'), u32('the height'), u32('the number of channels')];
  if (channels > 64 || width * height > 2 ** 31)
    throw new Error(`a frame of ${width}x${height} pixels and ${channels} channels is too large`);
  const names: string[] = [];
  for (let i = 0; i < channels; i++) {
    const length = u32('a channel name');
    if (at + length > buffer.byteLength) throw new Error('the pixels end early, in a channel name');
    names.push(new TextDecoder().decode(new Uint8Array(buffer, at, length)));
    at += length;
  }
  const size = 2 * width * height;
  if (buffer.byteLength !== at + channels * size) {
    throw new Error(`the pixels have ${buffer.byteLength} bytes, expected ${at + channels * size}`);
  }
  const planes = new Map<string, Uint16Array>();
  for (const name of names) {
    // Copy the plane, because the names may leave it at an odd address.
    const plane = new Uint16Array(buffer.slice(at, at + size));
    if (UNKNOWN.has(name)) forget(plane);
    planes.set(name, plane);
    at += size;
  }
  return new Pixels(width, height, planes);
}
