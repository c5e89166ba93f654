/** Binary glTF of boxes around the recorded intersections of each object, as the farm writes geometry. */

/**
 * - `names`: of the schema.
 * - `of`: columns of representative paths.
 * - `camera`: position, target and vertical angle of view of the camera of the render.
 */
export function boxesAsGlb(names, of, camera) {
  const boxes = new Map();
  of['intersections.object'].forEach((value, row) => {
    const name = names[value - 1];
    if (!name) return;
    const at = ['x', 'y', 'z'].map((axis) => of[`intersections.position.${axis}`][row]);
    const box = boxes.get(name) ?? [[...at], [...at]];
    at.forEach((v, k) => {
      box[0][k] = Math.min(box[0][k], v);
      box[1][k] = Math.max(box[1][k], v);
    });
    boxes.set(name, box);
  });
  const indices = Uint32Array.from([0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3]);
  const parts = [indices];
  const nodes = [];
  const meshes = [];
  const accessors = [{ bufferView: 0, componentType: 5125, count: indices.length, type: 'SCALAR' }];
  for (const [name, [low, high]] of boxes) {
    const corners = Array.from({ length: 8 }, (_, i) => [0, 1, 2].map((k) => (i & (1 << k) ? high[k] : low[k]))).flat();
    parts.push(Float32Array.from(corners));
    accessors.push({ bufferView: accessors.length, componentType: 5126, count: 8, type: 'VEC3' });
    meshes.push({ primitives: [{ attributes: { POSITION: accessors.length - 1 }, indices: 0, material: 0, mode: 4 }] });
    nodes.push({ mesh: meshes.length - 1, name, extras: { object: name, boxed: false, moves: false } });
  }
  const sub = (a, b) => a.map((v, i) => v - b[i]);
  const unit = (a) => a.map((v) => v / Math.hypot(...a));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const back = unit(sub(camera.at, camera.target));
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  nodes.push({ camera: 0, name: 'main', matrix: [...right, 0, ...up, 0, ...back, 0, ...camera.at, 1], extras: { rendered: true, film: [64, 48] } });
  nodes.push({ name: 'scene', children: nodes.map((_, i) => i) });
  let at = 0;
  const bufferViews = parts.map((part) => {
    const view = { buffer: 0, byteOffset: at, byteLength: part.byteLength };
    at += part.byteLength;
    return view;
  });
  const document = {
    asset: { version: '2.0' },
    scene: 0,
    scenes: [{ nodes: [nodes.length - 1], extras: { origin: [0, 0, 0], deviation: 0, boxed_objects: 0 } }],
    nodes,
    meshes,
    materials: [{ name: 'gray', doubleSided: true, pbrMetallicRoughness: { baseColorFactor: [0.6, 0.6, 0.6, 1] } }],
    cameras: [{ type: 'perspective', perspective: { yfov: camera.fov, aspectRatio: 64 / 48, znear: 0.01 } }],
    accessors,
    bufferViews,
    buffers: [{ byteLength: at }],
  };
  const text = Buffer.from(JSON.stringify(document));
  const json = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 32)]);
  const binary = Buffer.concat(parts.map((part) => Buffer.from(part.buffer)));
  const words = (...all) => Buffer.from(Uint32Array.from(all).buffer);
  const whole = 28 + json.length + binary.length;
  return Buffer.concat([words(0x46546c67, 2, whole, json.length, 0x4e4f534a), json, words(binary.length, 0x004e4942), binary]);
}
