/** The finite-element solution as a file, read independently of the page. */

const sub = (a, b) => a.map((v, i) => v - b[i]);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** Returns the triangles of binary glTF: corners in coordinates of the scene, and the numbers of an attribute at the corners. */
export function triangles(bytes, attribute) {
  const length = bytes.readUInt32LE(12);
  const document = JSON.parse(bytes.toString('utf8', 20, 20 + length));
  const start = 28 + length;
  const { origin } = document.scenes[0].extras;
  const words = (number, read) => {
    const { byteOffset, byteLength } = document.bufferViews[document.accessors[number].bufferView];
    return Array.from({ length: byteLength / 4 }, (_, i) => bytes[read](start + byteOffset + 4 * i));
  };
  return (document.meshes ?? []).flatMap(({ primitives: [{ attributes, indices }] }) => {
    const at = words(attributes.POSITION, 'readFloatLE');
    const values = words(attributes[attribute], 'readFloatLE');
    const corners = words(indices, 'readUInt32LE');
    return Array.from({ length: corners.length / 3 }, (_, i) => {
      const own = corners.slice(3 * i, 3 * i + 3);
      return { corners: own.map((v) => [0, 1, 2].map((k) => at[3 * v + k] + origin[k])), values: own.map((v) => values[v]) };
    });
  });
}

/** Returns the value where a ray meets the first triangle from its front; null: it meets none. */
export function valueAlong(all, from, direction) {
  let [nearest, value] = [Infinity, null];
  for (const { corners: [a, b, c], values } of all) {
    const [u, v] = [sub(b, a), sub(c, a)];
    const normal = cross(u, v);
    const facing = dot(normal, direction);
    if (facing >= 0) continue;
    const distance = dot(normal, sub(a, from)) / facing;
    if (distance <= 0 || distance >= nearest) continue;
    const at = sub(from.map((x, k) => x + distance * direction[k]), a);
    const square = dot(normal, normal);
    const second = dot(cross(at, v), normal) / square;
    const third = dot(cross(u, at), normal) / square;
    if (second < 0 || third < 0 || second + third > 1) continue;
    [nearest, value] = [distance, values[0] * (1 - second - third) + values[1] * second + values[2] * third];
  }
  return value;
}
