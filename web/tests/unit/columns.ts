/** Encoder of columns, for tests. */

import { MAGIC, type ColumnType } from '../../src/lib/light/columns';

const VERSION = 1;
const BYTES = { u8: 1, u32: 4, f32: 4, f64: 8 } as const;

/** Encodes columns as the coordinator does; the counterpart of `decodeColumns`. */
export function encodeColumns(header: object, columns: [string, ColumnType, ArrayLike<number>][]): ArrayBuffer {
  let offset = 0;
  const described = columns.map(([name, type, values]) => {
    const column = { name, type, length: values.length, offset };
    offset += Math.ceil((values.length * BYTES[type]) / 8) * 8;
    return column;
  });
  const json = new TextEncoder().encode(JSON.stringify({ ...header, columns: described }));
  const begin = Math.ceil((12 + json.length) / 8) * 8;
  const buffer = new ArrayBuffer(begin + offset);
  const bytes = new Uint8Array(buffer);
  bytes.fill(32, 12, begin);
  bytes.set(json, 12);
  const view = new DataView(buffer);
  [MAGIC, VERSION, begin - 12].forEach((word, i) => view.setUint32(4 * i, word, true));
  columns.forEach(([, type, values], i) => {
    const Type = { u8: Uint8Array, u32: Uint32Array, f32: Float32Array, f64: Float64Array }[type];
    new Type(buffer, begin + described[i]!.offset, values.length).set(values);
  });
  return buffer;
}
