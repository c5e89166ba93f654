import { expect, test } from 'vitest';
import { decodeColumns, hasBit } from '../../src/lib/light/columns';
import { encodeColumns } from './columns';

const sample = () =>
  encodeColumns({ tag: 't', recorded: 3, words: 'ä' }, [
    ['paths.mask', 'u8', [5]],
    ['paths.number', 'u32', [0, 0xffffffff]],
    ['paths.depth', 'f32', [1, 2.5, 3]],
    ['paths.0', 'f64', [0.1]],
  ]);

test('columns are views of their types', () => {
  const columns = decodeColumns<{ words: string }>(sample());
  expect(columns.header.words).toBe('ä');
  expect(columns.u8('paths.mask')).toEqual(Uint8Array.of(5));
  expect(columns.u32('paths.number')[1]).toBe(0xffffffff);
  expect(columns.f32('paths.depth')).toEqual(Float32Array.of(1, 2.5, 3));
  expect(columns.f64('paths.0')[0]).toBe(0.1);
  expect(columns.has('paths.1')).toBe(false);
  expect(() => columns.f32('paths.1')).toThrow('no column paths.1');
  expect(() => columns.f32('paths.0')).toThrow('another type');
});

test('damaged answers say what is wrong', () => {
  const whole = new Uint8Array(sample());
  const decode = (bytes: Uint8Array) => decodeColumns(bytes.slice().buffer);
  expect(() => decode(whole.slice(0, 8))).toThrow('header');
  expect(() => decode(whole.slice(0, 40))).toThrow('header');
  expect(() => decode(whole.slice(0, whole.length - 8))).toThrow('end early, in paths.0');
  const changed = (at: number, byte: number) => decode(whole.map((b, i) => (i === at ? byte : b)));
  expect(() => changed(0, 1)).toThrow('does not contain light data');
  expect(() => changed(4, 2)).toThrow('version 2');
  expect(() => changed(12, 1)).toThrow('not JSON');
  expect(() => decode(encode('u16'))).toThrow('unknown type');
});

function encode(type: string): Uint8Array {
  const json = new TextEncoder().encode(JSON.stringify({ columns: [{ name: 'a', type, length: 1, offset: 0 }] }).padEnd(84));
  const bytes = new Uint8Array(12 + json.length + 8);
  bytes.set([0x46, 0x4c, 0x43, 0x56, 1, 0, 0, 0, json.length]);
  bytes.set(json, 12);
  return bytes;
}

test('bits of a mask', () => {
  const mask = Uint8Array.of(0b101, 0x80);
  expect([0, 1, 2, 15, 16, 0xffffffff].map((n) => hasBit(mask, n))).toEqual([true, false, true, true, false, false]);
});
