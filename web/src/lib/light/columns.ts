/** Decodes columns of numbers as the coordinator sends them (`application/vnd.femc.columns`, version 1). */

/** `FLCV`, read as a little-endian number. */
export const MAGIC = 0x56434c46;
const VERSION = 1;

const BYTES = { u8: 1, u32: 4, f32: 4, f64: 8 } as const;
export type ColumnType = keyof typeof BYTES;

interface Column {
  name: string;
  type: ColumnType;
  /** Number of values. */
  length: number;
  /** Position in bytes from the first byte after the header. */
  offset: number;
}

interface Arrays {
  u8: Uint8Array;
  u32: Uint32Array;
  f32: Float32Array;
  f64: Float64Array;
}

/** Columns of numbers with a header. The columns are views of the answer: nothing is copied. */
export class Columns<H = Record<string, unknown>> {
  constructor(
    readonly header: H & { tag: string; recorded: number },
    private readonly arrays: ReadonlyMap<string, Arrays[ColumnType]>,
  ) {}

  /** Checks whether the column exists. */
  has(name: string): boolean {
    return this.arrays.has(name);
  }

  u8 = (name: string): Uint8Array => this.get(name, Uint8Array);
  u32 = (name: string): Uint32Array => this.get(name, Uint32Array);
  f32 = (name: string): Float32Array => this.get(name, Float32Array);
  f64 = (name: string): Float64Array => this.get(name, Float64Array);

  private get<T extends Arrays[ColumnType]>(name: string, type: abstract new (...args: never[]) => T): T {
    const array = this.arrays.get(name);
    if (!array) throw new Error(`the light data have no column ${name}`);
    if (!(array instanceof type)) throw new Error(`the column ${name} of the light data has another type of numbers`);
    return array;
  }
}

/** Decodes the coordinator's answer; throws an `Error` with a description if it is invalid. */
export function decodeColumns<H = Record<string, unknown>>(buffer: ArrayBuffer): Columns<H> {
  const view = new DataView(buffer);
  if (buffer.byteLength < 12) throw new Error('the light data end early, in their header');
  if (view.getUint32(0, true) !== MAGIC) throw new Error('the answer does not contain light data');
  const version = view.getUint32(4, true);
  if (version !== VERSION) {
    throw new Error(`the light data have version ${version}, but this page reads version ${VERSION}: reload the page`);
  }
  const begin = 12 + view.getUint32(8, true);
  if (begin > buffer.byteLength) throw new Error('the light data end early, in their header');
  if (begin % 8 !== 0) throw new Error('the light data begin at an odd address');
  let header: H & { tag: string; recorded: number; columns: Column[] };
  try {
    header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 12, begin - 12))) as typeof header;
  } catch {
    throw new Error('the header of the light data is not JSON');
  }
  const arrays = new Map<string, Arrays[ColumnType]>();
  for (const { name, type, length, offset } of header.columns ?? []) {
    const size = BYTES[type];
    if (!size) throw new Error(`the column ${name} of the light data has the unknown type ${type}: reload the page`);
    if (!(length >= 0) || !(offset >= 0) || offset % size !== 0) throw new Error(`the column ${name} is damaged`);
    if (begin + offset + length * size > buffer.byteLength) throw new Error(`the light data end early, in ${name}`);
    const Type = { u8: Uint8Array, u32: Uint32Array, f32: Float32Array, f64: Float64Array }[type];
    arrays.set(name, new Type(buffer, begin + offset, length));
  }
  return new Columns<H>(header, arrays);
}

/** Checks bit `number` of a mask. Numbers outside are not set. */
export const hasBit = (mask: Uint8Array, number: number): boolean => ((mask[number >>> 3] ?? 0) >>> (number & 7)) % 2 === 1;
