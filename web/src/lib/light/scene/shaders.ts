/**
 * Shaders of the scene view. Colors are bytes of the screen, with the size in place of the opacity. `cut` hides the points on the lower
 * side of a plane.
 */

const CUT = `
uniform vec4 cut;
bool isCut(vec3 at) { return dot(cut.xyz, at) < cut.w; }`;

export const POINTS = {
  vertex: `
attribute vec4 color;
uniform float size;
varying vec3 shade;
varying vec3 at;
void main() {
  shade = color.rgb;
  at = position;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_Position.z -= 2e-4 * gl_Position.w;
  gl_PointSize = size * color.a;
}`,
  fragment: `
varying vec3 shade;
varying vec3 at;
${CUT}
void main() {
  vec2 d = gl_PointCoord - 0.5;
  if (dot(d, d) > 0.25 || isCut(at)) discard;
  gl_FragColor = vec4(shade, 1.0);
}`,
};

/** Segments as strips with a width in pixels. The window of lengths along the path is visible. */
export const SEGMENTS = {
  vertex: `
attribute vec3 from;
attribute vec3 to;
attribute vec2 span;
attribute vec4 color;
uniform vec2 window;
uniform vec2 resolution;
uniform float width;
uniform float nearest;
varying vec3 shade;
varying vec3 at;
void main() {
  shade = color.rgb;
  float whole = max(span.y - span.x, 1e-12);
  float a = clamp((window.x - span.x) / whole, 0.0, 1.0);
  float b = clamp((window.y - span.x) / whole, 0.0, 1.0);
  vec3 begin = mix(from, to, a);
  vec3 end = mix(from, to, b);
  vec4 p = modelViewMatrix * vec4(begin, 1.0);
  vec4 q = modelViewMatrix * vec4(end, 1.0);
  // Ends behind the eye are moved before it.
  float near = -nearest;
  if (p.z > near && q.z < near) p = mix(p, q, (near - p.z) / (q.z - p.z));
  if (q.z > near && p.z < near) q = mix(q, p, (near - q.z) / (p.z - q.z));
  vec4 cp = projectionMatrix * p;
  vec4 cq = projectionMatrix * q;
  vec2 sp = cp.xy / cp.w * resolution;
  vec2 sq = cq.xy / cq.w * resolution;
  vec2 d = sq - sp;
  float size = length(d);
  vec2 n = size > 1e-6 ? vec2(-d.y, d.x) / size : vec2(0.0);
  bool isEnd = position.y > 0.5;
  vec4 c = isEnd ? cq : cp;
  at = isEnd ? end : begin;
  c.xy += n * (position.x * width * color.a) / resolution * c.w;
  c.z -= 3e-4 * c.w;
  gl_Position = b > a ? c : vec4(2.0, 2.0, 2.0, 1.0);
}`,
  fragment: `
varying vec3 shade;
varying vec3 at;
${CUT}
void main() {
  if (isCut(at)) discard;
  gl_FragColor = vec4(shade, 1.0);
}`,
};

export const VOXELS = {
  vertex: `
attribute vec3 corner;
attribute vec4 color;
uniform float width;
varying vec3 shade;
varying vec3 at;
void main() {
  at = corner + position * width;
  // The faces differ a little, so that neighbors can be told apart.
  vec3 side = abs(normal);
  shade = color.rgb * (1.0 * side.z + 0.9 * side.y + 0.8 * side.x);
  gl_Position = projectionMatrix * modelViewMatrix * vec4(at, 1.0);
}`,
  fragment: `
varying vec3 shade;
varying vec3 at;
${CUT}
void main() {
  if (isCut(at)) discard;
  gl_FragColor = vec4(shade, 1.0);
}`,
};

/** Elements of the finite-element solution, in the colors of their vertices. */
export const ELEMENTS = {
  vertexShader: `
varying vec3 shade;
#include <clipping_planes_pars_vertex>
void main() {
  shade = color;
  vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
  #include <clipping_planes_vertex>
  gl_Position = projectionMatrix * mvPosition;
}`,
  fragmentShader: `
varying vec3 shade;
#include <clipping_planes_pars_fragment>
void main() {
  #include <clipping_planes_fragment>
  gl_FragColor = vec4(shade, 1.0);
}`,
};

/** Added to the values, so that a value of 0 differs from the background. */
export const VALUE_OFFSET = 1e-6;

/** Values of the elements as the four bytes of a float, lowest first. */
export const ELEMENT_VALUES = {
  vertexShader: `
attribute float quantity;
varying float value;
#include <clipping_planes_pars_vertex>
void main() {
  value = quantity;
  vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
  #include <clipping_planes_vertex>
  gl_Position = projectionMatrix * mvPosition;
}`,
  fragmentShader: `
varying float value;
#include <clipping_planes_pars_fragment>
void main() {
  #include <clipping_planes_fragment>
  uint bits = floatBitsToUint(max(value, 0.0) + ${VALUE_OFFSET.toExponential()});
  gl_FragColor = vec4(uvec4(bits, bits >> 8u, bits >> 16u, bits >> 24u) & 255u) / 255.0;
}`,
};
