/**
 * Reader of the scene's geometry: binary glTF 2.0 as the farm writes it (triangles, colors, cameras). Textures, skins and animations are
 * ignored. The result is in coordinates of the scene minus its origin, with z up.
 */

export type Vec3 = readonly [number, number, number];
/** Column-major 4 x 4 matrix. */
export type Matrix = readonly number[];

export interface Surface {
  positions: Float32Array;
  /** Null: flat triangles. */
  normals: Float32Array | null;
  indices: Uint32Array;
  material: number;
}

export interface Material {
  name: string;
  /** Linear color, and opacity. */
  color: readonly [number, number, number, number];
  emissive: Vec3;
  isDoubleSided: boolean;
}

export interface SceneObject {
  /** Name, as in conditions. */
  name: string;
  matrix: Matrix;
  surfaces: readonly Surface[];
  /** Whether a box stands for the object. */
  isBoxed: boolean;
  /** Whether it moves while the shutter is open. */
  isMoving: boolean;
}

export interface SceneCamera {
  name: string;
  /** Pose: looks along -z, y up. */
  matrix: Matrix;
  /** Vertical angle of view in radians. */
  fov: number;
  aspect: number;
  /** Whether the job renders it. */
  isRendered: boolean;
}

export interface Geometry {
  /** Subtracted from all positions, m. */
  origin: Vec3;
  objects: readonly SceneObject[];
  materials: readonly Material[];
  cameras: readonly SceneCamera[];
  /** Bound of the distance between triangles and surfaces, m. */
  deviation: number;
  /** Number of objects that are boxes. */
  boxed: number;
}

const GLTF = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;
const BINARY_CHUNK = 0x004e4942;
export const IDENTITY: Matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export interface GltfDocument {
  scene?: number;
  scenes?: { nodes?: number[]; extras?: Record<string, unknown> }[];
  nodes?: GltfNode[];
  meshes?: { primitives: Primitive[] }[];
  materials?: GltfMaterial[];
  cameras?: { perspective?: { yfov: number; aspectRatio?: number } }[];
  accessors?: { bufferView: number; byteOffset?: number; componentType: number; count: number; type: string }[];
  bufferViews?: { byteOffset?: number; byteLength: number; byteStride?: number }[];
}
interface GltfNode {
  name?: string;
  mesh?: number;
  camera?: number;
  children?: number[];
  matrix?: number[];
  extras?: { object?: string; boxed?: boolean; moves?: boolean; rendered?: boolean; lamp?: boolean };
}
interface Primitive {
  attributes: Record<string, number>;
  indices?: number;
  material?: number;
  mode?: number;
}
interface GltfMaterial {
  name?: string;
  pbrMetallicRoughness?: { baseColorFactor?: number[] };
  emissiveFactor?: number[];
  doubleSided?: boolean;
}

/** Parses binary glTF; throws an `Error` with a description if it is invalid. */
export function parseGlb(buffer: ArrayBuffer): Geometry {
  const { document, binary } = chunks(buffer);
  const surfaces = new Map<number, Surface[]>();
  const surfacesOf = (mesh: number) => {
    let known = surfaces.get(mesh);
    if (!known) {
      const primitives = document.meshes?.[mesh]?.primitives.filter((it) => (it.mode ?? 4) === 4) ?? [];
      known = primitives.map((it) => surfaceOf(document, binary, it));
      surfaces.set(mesh, known);
    }
    return known;
  };
  const objects: SceneObject[] = [];
  const cameras: SceneCamera[] = [];
  const visit = (number: number) => {
    const node = document.nodes?.[number];
    if (!node) throw new Error(`the geometry has no node ${number}`);
    const { name = '', matrix = IDENTITY, extras } = node;
    if (node.mesh !== undefined) {
      objects.push({
        name: extras?.object ?? name,
        matrix,
        surfaces: surfacesOf(node.mesh),
        isBoxed: extras?.boxed ?? false,
        isMoving: extras?.moves ?? false,
      });
    }
    const perspective = node.camera === undefined ? undefined : document.cameras?.[node.camera]?.perspective;
    if (perspective) {
      const { yfov, aspectRatio = 1 } = perspective;
      cameras.push({ name, matrix, fov: yfov, aspect: aspectRatio, isRendered: extras?.rendered ?? false });
    }
  };
  const scene = document.scenes?.[document.scene ?? 0];
  // The root only turns the scene for other programs. Objects and cameras are its children.
  for (const root of scene?.nodes ?? []) {
    const children = document.nodes?.[root]?.children;
    (children ?? [root]).forEach(visit);
  }
  const { origin, deviation, boxed_objects } = scene?.extras ?? {};
  return {
    origin: Array.isArray(origin) && origin.length === 3 ? (origin as unknown as Vec3) : [0, 0, 0],
    objects,
    cameras,
    materials: (document.materials ?? []).map(materialOf),
    deviation: Number(deviation ?? 0),
    boxed: Number(boxed_objects ?? 0),
  };
}

/** Returns the document and the buffer of binary glTF. */
export function chunks(buffer: ArrayBuffer): { document: GltfDocument; binary: ArrayBuffer } {
  const view = new DataView(buffer);
  if (buffer.byteLength < 20 || view.getUint32(0, true) !== GLTF) throw new Error('the geometry is not binary glTF');
  if (view.getUint32(4, true) !== 2) throw new Error(`the geometry has version ${view.getUint32(4, true)} of glTF, not 2`);
  let document: GltfDocument | null = null;
  let binary = new ArrayBuffer(0);
  for (let at = 12; at + 8 <= buffer.byteLength; ) {
    const [length, kind] = [view.getUint32(at, true), view.getUint32(at + 4, true)];
    if (at + 8 + length > buffer.byteLength) throw new Error('the geometry ends early');
    if (kind === JSON_CHUNK) {
      document = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, at + 8, length))) as GltfDocument;
    } else if (kind === BINARY_CHUNK) binary = buffer.slice(at + 8, at + 8 + length);
    at += 8 + length;
  }
  if (!document) throw new Error('the geometry has no description');
  return { document, binary };
}

const TYPES = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array } as const;

/** Returns the numbers of an accessor, `width` for each vertex. */
export function accessor(document: GltfDocument, binary: ArrayBuffer, number: number, width: number) {
  const it = document.accessors?.[number];
  const part = it && document.bufferViews?.[it.bufferView];
  const Type = it && TYPES[it.componentType as keyof typeof TYPES];
  if (!it || !part || !Type) throw new Error(`the geometry has no numbers ${number}`);
  const start = (part.byteOffset ?? 0) + (it.byteOffset ?? 0);
  const length = it.count * width;
  if (start + length * Type.BYTES_PER_ELEMENT > binary.byteLength) throw new Error('the geometry ends early');
  const isPacked = part.byteStride === undefined || part.byteStride === width * Type.BYTES_PER_ELEMENT;
  if (!isPacked || start % Type.BYTES_PER_ELEMENT !== 0) throw new Error('the numbers of the geometry are not packed');
  return new Type(binary, start, length);
}

function surfaceOf(document: GltfDocument, binary: ArrayBuffer, { attributes, indices, material }: Primitive): Surface {
  const floats = (name: string) => {
    const number = attributes[name];
    if (number === undefined) return null;
    const values = accessor(document, binary, number, 3);
    if (!(values instanceof Float32Array)) throw new Error(`the geometry has another type of numbers for ${name}`);
    return values;
  };
  const positions = floats('POSITION') ?? new Float32Array();
  const all = indices === undefined ? Uint32Array.from({ length: positions.length / 3 }, (_, i) => i) : null;
  return {
    positions,
    normals: floats('NORMAL'),
    indices: all ?? Uint32Array.from(accessor(document, binary, indices!, 1)),
    material: material ?? -1,
  };
}

function materialOf({ name = '', pbrMetallicRoughness, emissiveFactor, doubleSided = false }: GltfMaterial): Material {
  const [r = 1, g = 1, b = 1, a = 1] = pbrMetallicRoughness?.baseColorFactor ?? [];
  const [er = 0, eg = 0, eb = 0] = emissiveFactor ?? [];
  return { name, color: [r, g, b, a], emissive: [er, eg, eb], isDoubleSided: doubleSided };
}

/** Transforms a point with a matrix. */
export function transform(m: Matrix, [x, y, z]: Vec3): Vec3 {
  return [
    m[0]! * x + m[4]! * y + m[8]! * z + m[12]!,
    m[1]! * x + m[5]! * y + m[9]! * z + m[13]!,
    m[2]! * x + m[6]! * y + m[10]! * z + m[14]!,
  ];
}
