/** Channels of an OpenEXR file as femc writes it: one part, scan lines, ZIP, 32-bit channels. */
import { inflateSync } from 'node:zlib';

const LINES = 16;

/** Width, height, and the channels by name, row by row. */
export function readExr(bytes) {
  let at = 8;
  const text = () => {
    const end = bytes.indexOf(0, at);
    const found = bytes.toString('latin1', at, end);
    at = end + 1;
    return found;
  };
  const attributes = new Map();
  while (bytes[at] !== 0) {
    const name = text();
    text();
    const size = bytes.readUInt32LE(at);
    attributes.set(name, bytes.subarray(at + 4, at + 4 + size));
    at += 4 + size;
  }
  at++;
  const box = attributes.get('dataWindow');
  const [x0, y0, x1, y1] = [0, 4, 8, 12].map((i) => box.readInt32LE(i));
  const [width, height] = [x1 - x0 + 1, y1 - y0 + 1];
  const list = attributes.get('channels');
  const channels = [];
  for (let i = 0; list[i] !== 0;) {
    const end = list.indexOf(0, i);
    const whole = list.readUInt32LE(end + 1) === 0;
    channels.push({ name: list.toString('latin1', i, end), whole, values: new Float64Array(width * height) });
    i = end + 17;
  }
  for (let block = 0; block < Math.ceil(height / LINES); block++) {
    const from = Number(bytes.readBigUInt64LE(at + 8 * block));
    const first = bytes.readInt32LE(from) - y0;
    const lines = Math.min(LINES, height - first);
    const packed = bytes.subarray(from + 8, from + 8 + bytes.readInt32LE(from + 4));
    const size = 4 * lines * width * channels.length;
    const data = packed.length === size ? packed : unpack(inflateSync(packed));
    let i = 0;
    for (let y = first; y < first + lines; y++) {
      for (const { whole, values } of channels) {
        for (let x = 0; x < width; x++, i += 4) {
          values[y * width + x] = whole ? data.readUInt32LE(i) : data.readFloatLE(i);
        }
      }
    }
  }
  return { width, height, channels: new Map(channels.map(({ name, values }) => [name, values])) };
}

/** Undoes the differences of bytes and the split into even and odd ones. */
function unpack(data) {
  for (let i = 1; i < data.length; i++) data[i] = (data[i - 1] + data[i] - 128) & 255;
  const half = Math.ceil(data.length / 2);
  return Buffer.from(data.map((_, i) => data[i % 2 ? half + (i >> 1) : i >> 1]));
}
