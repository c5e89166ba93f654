import { describe, expect, test } from 'vitest';
import { NONE } from '../../src/lib/light/api';
import { chipsOrNull } from '../../src/lib/light/data';
import {
  around,
  eyeOf,
  formatCut,
  formatEye,
  formatEyes,
  isKept,
  moved,
  nearer,
  parseCut,
  parseEye,
  parseEyes,
  placeOf,
  sides,
  turned,
} from '../../src/lib/light/scene/eye';
import { IDENTITY, parseGlb, type Geometry } from '../../src/lib/light/scene/glb';
import { differenceOf, parseLayers } from '../../src/lib/light/scene/loads.svelte';
import { findBox, roundBox, termOf, withBox, withPick } from '../../src/lib/light/scene/pick';
import { parseTargets, sizeText } from '../../src/lib/light/scene/targets';
import { colorsOf, parseSolution, solutionScale, valuesOf } from '../../src/lib/light/scene/solution';
import { viridis } from '../../src/lib/color';
import {
  bounceScale,
  energyScale,
  joinPaths,
  joinPoints,
  connectedBoxes,
  lampPlaces,
  objectAt,
  plainPaint,
  pointsOf,
  raysOf,
  scalePaint,
  segmentsOf,
  sparse,
  triangleHit,
  voxelsOf,
  type Records,
} from '../../src/lib/light/scene/records';

const near = (values: ArrayLike<number>, expected: readonly number[]) => {
  expect(values.length).toBe(expected.length);
  expected.forEach((v, i) => expect(values[i]).toBeCloseTo(v, 4));
};

/** Binary glTF of a triangle (object `room.wall`, moved by 1 along x) and a camera at (0, -4, 1) that looks along y. */
function glb(change: (document: Record<string, unknown>) => void = () => {}): ArrayBuffer {
  const positions = Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0);
  const indices = Uint32Array.of(0, 1, 2);
  const document = {
    asset: { version: '2.0' },
    scene: 0,
    scenes: [{ nodes: [2], extras: { origin: [10, 0, 0], deviation: 0.5, boxed_objects: 1 } }],
    nodes: [
      {
        mesh: 0,
        name: 'room_wall',
        matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1],
        extras: { object: 'room.wall', boxed: true, moves: false },
      },
      { camera: 0, name: 'main', matrix: [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, -4, 1, 1], extras: { rendered: true } },
      { name: 'scene', children: [0, 1], rotation: [-0.7071, 0, 0, 0.7071], translation: [0, 0, 10] },
    ],
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1, material: 0, mode: 4 }] }],
    materials: [
      { name: 'lamp', doubleSided: true, emissiveFactor: [1, 0.5, 0], pbrMetallicRoughness: { baseColorFactor: [0.1, 0.2, 0.3, 1] } },
    ],
    cameras: [{ type: 'perspective', perspective: { yfov: 1, aspectRatio: 1.5, znear: 0.01 } }],
    accessors: [
      { bufferView: 0, componentType: 5126, count: 3, type: 'VEC3' },
      { bufferView: 1, componentType: 5125, count: 3, type: 'SCALAR' },
    ],
    bufferViews: [
      { buffer: 0, byteOffset: 0, byteLength: 36 },
      { buffer: 0, byteOffset: 36, byteLength: 12 },
    ],
    buffers: [{ byteLength: 48 }],
  };
  change(document);
  return glbFile(document, [positions, indices]);
}

/** Binary glTF of a document and its numbers. */
function glbFile(document: object, numbers: readonly (Float32Array | Uint32Array)[]): ArrayBuffer {
  const text = new TextEncoder().encode(JSON.stringify(document));
  const padded = Math.ceil(text.length / 4) * 4;
  const length = numbers.reduce((sum, it) => sum + it.byteLength, 0);
  const buffer = new ArrayBuffer(12 + 8 + padded + 8 + length);
  const [view, bytes] = [new DataView(buffer), new Uint8Array(buffer)];
  [0x46546c67, 2, buffer.byteLength, padded, 0x4e4f534a].forEach((word, i) => view.setUint32(4 * i, word, true));
  bytes.fill(32, 20, 20 + padded);
  bytes.set(text, 20);
  view.setUint32(20 + padded, length, true);
  view.setUint32(24 + padded, 0x004e4942, true);
  let at = 28 + padded;
  for (const it of numbers) {
    bytes.set(new Uint8Array(it.buffer), at);
    at += it.byteLength;
  }
  return buffer;
}

describe('geometry', () => {
  test('objects, materials and cameras of binary glTF', () => {
    const it = parseGlb(glb());
    expect(it.origin).toEqual([10, 0, 0]);
    expect(it).toMatchObject({ deviation: 0.5, boxed: 1 });
    expect(it.objects).toHaveLength(1);
    expect(it.objects[0]).toMatchObject({ name: 'room.wall', isBoxed: true, isMoving: false });
    expect(it.objects[0]!.surfaces[0]!.normals).toBeNull();
    expect([...it.objects[0]!.surfaces[0]!.indices]).toEqual([0, 1, 2]);
    expect(it.materials[0]).toEqual({ name: 'lamp', color: [0.1, 0.2, 0.3, 1], emissive: [1, 0.5, 0], isDoubleSided: true });
    expect(it.cameras[0]).toMatchObject({ name: 'main', fov: 1, aspect: 1.5, isRendered: true });
  });

  test('what is damaged is refused', () => {
    expect(() => parseGlb(new ArrayBuffer(4))).toThrow('not binary glTF');
    expect(() => parseGlb(glb().slice(0, 60))).toThrow('ends early');
    expect(() => parseGlb(glb((it) => ((it.nodes as { children?: number[] }[])[2]!.children = [7])))).toThrow('no node 7');
    const short = (it: Record<string, unknown>) => ((it.accessors as { count: number }[])[0]!.count = 99);
    expect(() => parseGlb(glb(short))).toThrow('ends early');
  });
});

describe('eye', () => {
  const eye = { target: [1, 2, 3] as const, yaw: 0, pitch: 0, distance: 10, fov: 0.7 };

  test('turns about its target and moves with the screen', () => {
    near(placeOf(eye), [11, 2, 3]);
    near(placeOf(turned(eye, Math.PI / 2, 0)), [1, 12, 3]);
    expect(turned(eye, 0, 9).pitch).toBeLessThan(Math.PI / 2);
    near(sides(eye).right, [0, 1, 0]);
    near(sides(eye).up, [0, 0, 1]);
    const up = moved(eye, 0, 1);
    near(up.target, [1, 2, 3 + 20 * Math.tan(0.35)]);
    expect(nearer(eye, 0.5).distance).toBe(5);
  });

  test('the camera of the render: position, direction and the whole film in a narrow view', () => {
    const { cameras, origin } = parseGlb(glb());
    const wide = eyeOf(cameras[0]!, origin, 4, 2);
    near(placeOf(wide), [10, -4, 1]);
    near(wide.target, [10, 0, 1]);
    expect(wide.fov).toBe(1);
    const narrow = eyeOf(cameras[0]!, origin, 4, 0.75);
    expect(Math.tan(narrow.fov / 2) * 0.75).toBeCloseTo(Math.tan(0.5) * 1.5, 6);
  });

  test('a narrow view sees the whole scene from farther away', () => {
    const [wide, narrow] = [around([0, 0, 0], [2, 2, 2], 1.5), around([0, 0, 0], [2, 2, 2], 0.5)];
    near(wide.target, [1, 1, 1]);
    expect(wide.distance * Math.sin(wide.fov / 2)).toBeCloseTo(Math.sqrt(3), 5);
    expect(narrow.distance).toBeGreaterThan(1.8 * wide.distance);
  });

  test('addresses', () => {
    const text = formatEye({ ...eye, yaw: 1.23456, target: [0.12345, -7, 1e-9] });
    expect(text).toBe('0.123,-7,0,10,1.2346,0,0.7');
    near(placeOf(parseEye(text)!), placeOf({ ...eye, yaw: 1.2346, target: [0.123, -7, 0] }) as unknown as number[]);
    for (const bad of ['', undefined, '1,2,3', '1,2,3,0,0,0,0.7', '1,2,3,4,5,6,x', '1,2,3,4,5,6,9', '1,2,3,4,5,1,0.7,8']) {
      expect(parseEye(bad)).toBeNull();
    }
    expect(parseEyes(formatEyes([eye, around([0, 0, 0], [1, 1, 1], 1.5)]))).toHaveLength(2);
    expect(parseEyes('x;1,2')).toEqual([]);
    expect(parseCut('y<-0.25')).toEqual({ axis: 1, at: -0.25, hidesAbove: true });
    expect(formatCut({ axis: 2, at: 1.5, hidesAbove: false })).toBe('z>1.5');
    expect(parseCut('w>1')).toBeNull();
    expect([isKept(parseCut('x>0'), [1, 0, 0]), isKept(parseCut('x<0'), [1, 0, 0]), isKept(null, [1, 0, 0])]).toEqual([true, false, true]);
    expect([...parseLayers(undefined)]).toEqual(['surfaces', 'points', 'paths']);
    expect([...parseLayers('none')]).toEqual([]);
    expect([...parseLayers('voxels,lights')]).toEqual(['lights', 'voxels']);
  });
});

/** Two paths: one of three intersections along x, 1 m apart, and one that branches. */
const records: Records = {
  position: [Float32Array.of(1, 2, 3, 0, 0, 0), Float32Array.of(0, 0, 0, 1, 2, 1), Float32Array.of(0, 0, 0, 0, 0, 2)],
  energy: Float32Array.of(1, 10, 100, 0, 5, 7),
  bounce: Float32Array.of(0, 1, 2, 0, 1, 1),
  object: Float32Array.of(1, 2, 0, 1, 1, 1),
  material: Float32Array.of(5, 6, 0, 5, 5, 5),
  path: Uint32Array.of(0, 0, 0, 1, 1, 1),
  parent: Uint32Array.of(NONE, 0, 1, NONE, 3, 3),
  pathEnergy: Float32Array.of(4, 8),
  light: {
    path: Uint32Array.of(0, 0, 1, 1),
    intersection: Uint32Array.of(0, 1, 3, 4),
    lamp: Float32Array.of(3, 3, 3, 4),
    occluder: Float32Array.of(0, 2, 0, 0),
    found: Float32Array.of(3, 3, 1, 3),
  },
  names: ['ball', 'room.wall', 'room.wall/lamp', 'gone/lamp', 'chrome', 'lamp'],
  kinds: ['object', 'object', 'light', 'light', 'material', 'material'],
  sampled: new Set([3]),
};

describe('records', () => {
  test('points are the shown rows, relative to the origin', () => {
    const points = pointsOf(records, scalePaint(energyScale(records.energy), 'energy'), [1, 0, 0], (row) => row !== 1);
    expect([...points.rows]).toEqual([0, 2, 3, 4, 5]);
    expect([...points.positions.subarray(0, 6)]).toEqual([0, 0, 0, 2, 0, 0]);
    // More energy is lighter.
    const lightness = (i: number) => points.colors[4 * i]! + points.colors[4 * i + 1]! + points.colors[4 * i + 2]!;
    expect(lightness(1)).toBeGreaterThan(lightness(0));
    expect(energyScale([1e-30, 1e-3, 1, 2])).toEqual({ low: 2e-5, high: 2, logarithmic: true });
    expect(bounceScale(records.bounce)).toMatchObject({ low: 0, high: 2 });
    expect([objectAt(records, 0), objectAt(records, 2)]).toEqual(['ball', null]);
  });

  const style = { paint: scalePaint(bounceScale(records.bounce), 'bounce'), origin: [0, 0, 0] as const };
  test('segments have the length along the path, from the camera', () => {
    const it = segmentsOf(records, [0, 1], { ...style, camera: [0, 0, 0], withLight: false });
    expect(it.count).toBe(6);
    expect(it.length).toBe(3);
    expect([...it.span.subarray(0, 6)]).toEqual([0, 1, 1, 2, 2, 3]);
    // Both branches begin at their common intersection.
    near(it.span.subarray(8, 12), [1, 2, 1, 3]);
    expect([...it.from.subarray(15, 18)]).toEqual([0, 1, 0]);
  });

  test('with the light, paths begin at their ends', () => {
    const it = segmentsOf(records, [0], { ...style, camera: [0, 0, 0], withLight: true });
    expect([...it.span]).toEqual([2, 3, 1, 2, 0, 1]);
    expect([...it.from.subarray(6, 9)]).toEqual([3, 0, 0]);
    expect([...it.to.subarray(6, 9)]).toEqual([2, 0, 0]);
  });

  test('without a camera, paths begin at their first intersection', () => {
    const it = segmentsOf(records, [0], { ...style, camera: null, withLight: false });
    expect(it.count).toBe(2);
    expect([...it.span.subarray(0, 4)]).toEqual([0, 1, 1, 2]);
  });

  test('two data sets have their own colors', () => {
    const [red, blue] = [plainPaint([255, 0, 0]), plainPaint([0, 0, 255], 100)];
    const points = joinPoints(
      pointsOf(records, red, [0, 0, 0], (row) => row < 2),
      pointsOf(records, blue, [0, 0, 0], (row) => row === 2),
    );
    expect([...points.rows]).toEqual([0, 1, 2]);
    expect([...points.colors]).toEqual([255, 0, 0, 255, 255, 0, 0, 255, 0, 0, 255, 100]);
    expect([...points.positions.subarray(6)]).toEqual([3, 0, 0]);
    const way = { origin: [0, 0, 0] as const, camera: null, withLight: false };
    const paths = joinPaths(segmentsOf(records, [0], { paint: red, ...way }), segmentsOf(records, [1], { paint: blue, ...way }));
    expect(paths.count).toBe(4);
    expect([...paths.from.subarray(6, 9)]).toEqual([0, 1, 0]);
    expect([...paths.colors.subarray(8, 12)]).toEqual([0, 0, 255, 100]);
  });

  test('a sparse set is spread over all', () => {
    expect(sparse([1, 2], 5)).toEqual([1, 2]);
    expect(sparse([0, 1, 2, 3, 4, 5, 6, 7], 4)).toEqual([0, 2, 4, 6]);
  });

  const wall = (positions: number[]): Geometry => ({
    origin: [0, 0, 0],
    objects: [
      {
        name: 'room.wall',
        matrix: IDENTITY,
        isBoxed: false,
        isMoving: false,
        surfaces: [{ positions: Float32Array.from(positions), normals: null, indices: Uint32Array.of(0, 1, 2), material: 0 }],
      },
    ],
    materials: [{ name: 'lamp', color: [0, 0, 0, 1], emissive: [1, 1, 1], isDoubleSided: true }],
    cameras: [],
    deviation: 0,
    boxed: 0,
  });

  test('a lamp is at the parts of its geometry, or at the intersections with it', () => {
    expect(lampPlaces(records, null).get('room.wall/lamp')).toEqual([[2, 0, 0]]);
    expect(lampPlaces(records, wall([0, 0, 8, 2, 0, 8, 0, 2, 8])).get('room.wall/lamp')).toEqual([[1, 1, 8]]);
    expect(lampPlaces(records, null).has('gone/lamp')).toBe(false);
    // Triangles with a common corner are one part, others are not.
    const corners = Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0, 9, 9, 9, 8, 9, 9, 9, 8, 9);
    const boxes = connectedBoxes(corners, Uint32Array.of(0, 1, 2, 3, 4, 5, 6, 7, 8));
    expect(boxes).toEqual([
      { low: [0, 0, 0], high: [1, 1, 0] },
      { low: [8, 8, 9], high: [9, 9, 9] },
    ]);
  });

  test('the hidden part of a ray is black, from the object that hides it', () => {
    // The wall crosses the plane x = 3 and is the lamp, too: its center is at (3, 1, 0).
    const it = raysOf(records, wall([3, -8, -8, 3, 10, -8, 3, 1, 8]), [0, 0, 0], () => true);
    expect(it).toMatchObject({ total: 2, hidden: 1, lost: 1 });
    expect(it.count).toBe(3);
    expect([...it.colors.subarray(8, 11)]).toEqual([0, 0, 0]);
    expect(it.colors[0]).toBeGreaterThan(200);
    near(it.to.subarray(3, 6), [3, 1, 0]);
    // Without geometry, the whole ray is black.
    const bare = raysOf(records, null, [0, 0, 0], () => true);
    expect(bare.count).toBe(2);
    expect([...bare.colors.subarray(4, 7)]).toEqual([0, 0, 0]);
  });

  test('a ray hits a triangle from both sides, and not beside it', () => {
    const triangle = Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0);
    expect(triangleHit(triangle, 0, [0.2, 0.2, -1], [0, 0, 2])).toBeCloseTo(0.5);
    expect(triangleHit(triangle, 0, [0.2, 0.2, 1], [0, 0, -2])).toBeCloseTo(0.5);
    expect(triangleHit(triangle, 0, [0.9, 0.9, -1], [0, 0, 2])).toBe(Infinity);
    expect(triangleHit(triangle, 0, [0, 0, 1], [1, 0, 0])).toBe(Infinity);
  });
});

describe('voxels', () => {
  const answer = {
    cube: [[0, 0, 0], [4, 4, 4]] as const,
    level: 1,
    index: Uint32Array.of(0, 5, 7),
    energy: Float32Array.of(1, 10, 100),
  };
  test('those above the threshold, at their places', () => {
    const it = voxelsOf(answer, { low: 1, high: 100, logarithmic: true }, 0.5, () => [1, 2, 3], [1, 0, 0]);
    expect(it).toMatchObject({ count: 2, width: 2 });
    expect([...it.corners]).toEqual([1, 0, 2, 1, 2, 2]);
    expect([...it.colors]).toEqual([1, 2, 3, 255, 1, 2, 3, 255]);
  });
  test('differences have a sign, and equal voxels none', () => {
    const other = { ...answer, index: Uint32Array.of(5, 6, 7), energy: Float32Array.of(30, 2, 100) };
    const it = differenceOf(answer, other);
    expect([...it.index]).toEqual([0, 5, 6]);
    expect([...it.sign!]).toEqual([1, -1, -1]);
    expect([...it.energy]).toEqual([1, 20, 2]);
  });
});

describe('picks', () => {
  test('the four modes', () => {
    expect(termOf('object', 'ball', null)).toBe('object == ball');
    expect(termOf('interaction', 'ball', null)).toBe('any(object == ball)');
    expect(termOf('shadow', 'and', null)).toBe('light(occluder == "and")');
    expect(termOf('path', 'room.wall', 'ball')).toBe('ball then room.wall');
  });
  test('a pick replaces the one before, and keeps the rest of the selection', () => {
    const first = withPick('depth >= 3', termOf('object', 'ball', null), null);
    expect(first).toBe('depth >= 3 and object == ball');
    expect(withPick(first, 'object == room', 'object == ball')).toBe('depth >= 3 and object == room');
    expect(withPick(first, 'any(object == room)', null)).toBe('depth >= 3 and object == ball and any(object == room)');
    expect(withPick('', 'ball then room', 'object == ball')).toBe('ball then room');
  });
  test('a box is one chip, which is moved and removed', () => {
    const text = 'depth >= 3 and any(in box(0,0,0,1,1,1))';
    const chips = chipsOrNull(text)!;
    expect(findBox(chips)).toEqual({ at: 1, box: [0, 0, 0, 1, 1, 1] });
    const next = withBox(chips, [0, 0, 0, 2, 1, 1]);
    expect(findBox(next)!.box[3]).toBe(2);
    expect(findBox(withBox(next, null))).toBeNull();
    expect(findBox(withBox(chipsOrNull('depth >= 3')!, [1, 1, 1, 2, 2, 2]))!.at).toBe(1);
    expect(roundBox([0.12345, 0, 0, 1, 1, 1], 5)).toEqual([0.123, 0, 0, 1, 1, 1]);
  });
});

describe('targets of paths', () => {
  const document = {
    format: 'femc targets 1',
    origin: [10, 0, 0],
    targets: [
      { kind: 'opening', light: 0.31, shape: 'parallelogram', corner: [1, 2, 0], edges: [[0.05, 0, 0], [0, 0, 2]] },
      { kind: 'patch', light: 0.1, shape: 'ball', center: [0, 0, 3], radius: 0.25 },
    ],
  };
  const file = (change: (it: typeof document) => void = () => {}) => {
    const copy = structuredClone(document);
    change(copy);
    return new TextEncoder().encode(JSON.stringify(copy)).buffer as ArrayBuffer;
  };

  test('have outlines around the origin, and centers in the scene', () => {
    const { origin, targets, ends } = parseTargets(file());
    expect(origin).toEqual([10, 0, 0]);
    expect(targets.map(({ kind, light, center }) => ({ kind, light, center }))).toEqual([
      { kind: 'opening', light: 0.31, center: [11.025, 2, 1] },
      { kind: 'patch', light: 0.1, center: [10, 0, 3] },
    ]);
    expect(targets.map(sizeText)).toEqual(['0.05 m x 2 m', 'radius 0.25 m']);
    expect(ends.length).toBe(6 * (4 + 3 * 24));
    expect([...ends.slice(0, 6)]).toEqual([1, 2, 0, Math.fround(1.05), 2, 0]);
    const circles = ends.slice(24);
    for (let i = 0; i < circles.length; i += 3) {
      expect(Math.hypot(circles[i]!, circles[i + 1]!, circles[i + 2]! - 3)).toBeCloseTo(0.25, 5);
    }
  });

  test('are refused if they are invalid', () => {
    expect(() => parseTargets(file((it) => (it.format = 'femc targets 2')))).toThrow('unknown format of targets: femc targets 2');
    expect(() => parseTargets(file((it) => (it.targets[0]!.edges = [[0, 1, 0]])))).toThrow('no edges');
    expect(() => parseTargets(file((it) => (it.targets[1]!.center = [0, 1])))).toThrow('a position of a target is invalid');
    expect(() => parseTargets(file((it) => (it.targets[0]!.kind = 'door')))).toThrow('invalid target');
    expect(() => parseTargets(file((it) => delete it.targets[1]!.radius))).toThrow('no radius');
  });
});

describe('finite-element solution', () => {
  /** A triangle of an element and one of a lamp. */
  function solutionFile(change: (document: Record<string, unknown>) => void = () => {}): ArrayBuffer {
    const numbers = Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0, /* radiance */ 1, 1, 1, 2, 0, 0, 0, 3, 0, /* lx */ 10, 20, 0, /* direct */ 4, 25, 0);
    const indices = Uint32Array.of(0, 1, 2);
    const attributes = { POSITION: 0, _RADIANCE: 1, _ILLUMINANCE: 2, _DIRECT: 3 };
    const lengths = [36, 36, 12, 12, 12];
    const document = {
      asset: { version: '2.0' },
      scenes: [{ nodes: [2], extras: { origin: [10, 0, 0], full_triangles: 2, max_triangles: 5 } }],
      nodes: [
        { mesh: 0, name: 'gray', extras: { lamp: false } },
        { mesh: 0, name: 'glow', extras: { lamp: true } },
        { name: 'scene', children: [0, 1] },
      ],
      meshes: [{ primitives: [{ attributes, indices: 4, mode: 4 }] }],
      accessors: ['VEC3', 'VEC3', 'SCALAR', 'SCALAR', 'SCALAR'].map((type, i) => ({
        bufferView: i,
        componentType: i === 4 ? 5125 : 5126,
        count: 3,
        type,
      })),
      bufferViews: lengths.map((byteLength, i) => ({ buffer: 0, byteLength, byteOffset: lengths.slice(0, i).reduce((a, b) => a + b, 0) })),
      buffers: [{ byteLength: 108 }],
    };
    change(document);
    return glbFile(document, [numbers, indices]);
  }

  test('is read with its light, and lamps are marked', () => {
    const { origin, parts, triangles, limit } = parseSolution(solutionFile());
    expect([origin, triangles, limit]).toEqual([[10, 0, 0], 2, 5]);
    expect(parts.map((it) => it.isLamp)).toEqual([false, true]);
    near(parts[0]!.radiance, [1, 1, 1, 2, 0, 0, 0, 3, 0]);
    near(valuesOf(parts[0]!, 'illuminance'), [10, 20, 0]);
    // Direct light that exceeds all light by rounding leaves none.
    near(valuesOf(parts[0]!, 'indirect'), [6, 0, 0]);
    near(valuesOf(parts[0]!, 'luminance'), [1, 0.4252, 2.1456]);
    const noDirect = (it: Record<string, unknown>) =>
      delete (it.meshes as { primitives: { attributes: Record<string, number> }[] }[])[0]!.primitives[0]!.attributes._DIRECT;
    expect(() => parseSolution(solutionFile(noDirect))).toThrow('no numbers for _DIRECT');
  });

  test('has a scale of its elements by area, without lamps', () => {
    const solution = parseSolution(solutionFile());
    const [element, lamp] = solution.parts;
    const bright = { ...lamp!, illuminance: Float32Array.of(1e6, 1e6, 1e6) };
    expect(solutionScale({ ...solution, parts: [element!, bright] }, 'illuminance')).toEqual({ low: 10, high: 20, logarithmic: true });
    // A thousandth of the area is outside the scale.
    const tiny = {
      ...element!,
      positions: element!.positions.map((it) => 0.03 * it),
      illuminance: Float32Array.of(1e-6, 1e6, 1),
    };
    expect(solutionScale({ ...solution, parts: [element!, tiny] }, 'illuminance')).toEqual({ low: 10, high: 20, logarithmic: true });
    // Backs of walls in a room are nearly black: the scale has at most three decades.
    const dark = { ...element!, illuminance: Float32Array.of(1e-6, 1e-6, 1e-6) };
    const { low, high } = solutionScale({ ...solution, parts: [element!, dark] }, 'illuminance');
    expect(low / high).toBeCloseTo(1e-3, 9);
    expect(solutionScale({ ...solution, parts: [] }, 'colors')).toEqual({ low: 1, high: 1, logarithmic: true });
  });

  test('has the colors of the scale, or its own', () => {
    const [element] = parseSolution(solutionFile()).parts;
    const scale = { low: 1, high: 10, logarithmic: true };
    const colors = colorsOf(element!, 'illuminance', scale);
    expect([...colors.slice(0, 6)]).toEqual([...viridis(1), ...viridis(1)].map((c) => Math.trunc(c)));
    expect([...colors.slice(6)]).toEqual(viridis(0).map((c) => Math.trunc(c)));
    // 0.1 and 0.2 of white by the transfer function of sRGB.
    expect([...colorsOf(element!, 'colors', scale).slice(0, 6)]).toEqual([89, 89, 89, 124, 0, 0]);
  });
});
