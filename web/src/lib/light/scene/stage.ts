/**
 * Drawing of the scene view with three.js. This module is loaded when the view is opened. It draws on request: a still view costs
 * nothing. Positions are relative to the origin, so that single precision suffices.
 */

import {
  AmbientLight,
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  Color,
  DirectionalLight,
  DoubleSide,
  FrontSide,
  Group,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  PerspectiveCamera,
  Plane,
  Points as PointCloud,
  Scene,
  ShaderMaterial,
  SphereGeometry,
  Vector2,
  Vector3,
  Vector4,
  WebGLRenderer,
  WebGLRenderTarget,
  type Material,
  type Object3D,
} from 'three';
import type { Box } from '../boxes';
import { isWithin } from '../text';
import { placeOf, type Cut, type Eye } from './eye';
import type { Geometry, Vec3 } from './glb';
import type { Points, Segments, Voxels } from './records';
import { ELEMENTS, ELEMENT_VALUES, POINTS, SEGMENTS, VALUE_OFFSET, VOXELS } from './shaders';

/** Object under the pointer. */
export interface Hit {
  name: string;
}

export type { Box };

/** A box that cannot be dragged. */
export interface Outline {
  box: Box;
  /** Color as 0xrrggbb. */
  color: number;
}

/** Elements with their colors and values by vertex. */
export interface ShownSolution {
  /** Subtracted from all positions, m. */
  origin: Vec3;
  parts: readonly { positions: Float32Array; indices: Uint32Array; colors: Uint8Array; values: Float32Array }[];
}

/** Lines that are drawn over all else. */
export interface ShownLines {
  /** Subtracted from all positions, m. */
  origin: Vec3;
  /** Ends of the lines: six numbers for each, m. */
  ends: Float32Array;
}

/** A handle of the box: 0 to 5 are its faces (lower and upper x, y, z), 6 is its middle. */
export type Handle = number;

const BACKGROUNDS = { light: 0xaab1ba, dark: 0x4d545d };
const BOX_COLOR = 0x00c2a8;
const TARGET_COLOR = 0xff8c1a;
const HANDLE_PIXELS = 9;
/** Light that a highlighted object adds. */
const HIGHLIGHT = new Color(0, 0.13, 0.2);

/** No cut: everything is on the upper side of the plane. */
const NO_CUT = new Vector4(0, 0, 0, -1);

export class Stage {
  /** Number of drawn frames. */
  frames = 0;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera();
  private readonly headlight = new DirectionalLight(0xffffff, 1.7);
  private readonly surfaces = new Group();
  private readonly solution = new Group();
  private readonly targets = new LineSegments(
    new BufferGeometry(),
    new LineBasicMaterial({ color: TARGET_COLOR, depthTest: false, transparent: true }),
  );
  private readonly plane = new Plane();
  private readonly cut = { value: NO_CUT.clone() };
  private readonly resolution = { value: new Vector2(1, 1) };
  private readonly nearest = { value: 1e-3 };
  private readonly points: PointCloud<BufferGeometry, ShaderMaterial>;
  private readonly paths: Mesh<InstancedBufferGeometry, ShaderMaterial>;
  private readonly rays: Mesh<InstancedBufferGeometry, ShaderMaterial>;
  private readonly voxels: Mesh<InstancedBufferGeometry, ShaderMaterial>;
  private readonly box = new Group();
  private readonly outlines = new Group();
  private outlined: readonly Outline[] = [];
  private readonly handles: Mesh[] = [];
  private readonly names: string[] = [];
  private readonly target = new WebGLRenderTarget(1, 1);
  private request = 0;
  private origin: Vec3 = [0, 0, 0];
  private eye: Eye | null = null;
  private corners: Box | null = null;
  private radius = 1;
  /** Whether surfaces or elements are visible. */
  private areVisible = false;
  private width = 1;
  private height = 1;
  private pixelRatio = 1;

  /**
   * Throws where the browser has no WebGL2.
   * - `isSmooth`: whether edges are smooth and pixels fine, which graphics in software cannot afford.
   */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly isSmooth: boolean,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: isSmooth, powerPreference: 'low-power' });
    const { cut, resolution, nearest } = this;
    const shader = (of: { vertex: string; fragment: string }, uniforms: ShaderMaterial['uniforms']) =>
      new ShaderMaterial({ vertexShader: of.vertex, fragmentShader: of.fragment, uniforms: { cut, ...uniforms } });
    this.points = new PointCloud(new BufferGeometry(), shader(POINTS, { size: { value: 4 } }));
    const strip = (width: number, window: [number, number]) =>
      new Mesh(
        stripGeometry(),
        shader(SEGMENTS, { window: { value: new Vector2(...window) }, width: { value: width }, resolution, nearest }),
      );
    this.paths = strip(2, [0, 0]);
    this.rays = strip(1, [-1, 2]);
    for (const it of [this.paths, this.rays]) it.material.side = DoubleSide;
    this.voxels = new Mesh(voxelGeometry(), shader(VOXELS, { width: { value: 1 } }));
    for (const it of [this.points, this.paths, this.rays, this.voxels]) {
      it.frustumCulled = false;
      it.visible = false;
    }
    this.box.visible = false;
    this.makeBox();
    this.scene.add(new AmbientLight(0xffffff, 1.3), this.headlight, this.headlight.target);
    this.scene.add(this.surfaces, this.solution, this.voxels, this.points, this.rays, this.paths, this.box, this.outlines, this.targets);
    this.targets.frustumCulled = false;
    this.targets.renderOrder = 2;
    this.setTargets(null);
    canvas.addEventListener('webglcontextrestored', this.invalidate);
  }

  destroy() {
    cancelAnimationFrame(this.request);
    this.canvas.removeEventListener('webglcontextrestored', this.invalidate);
    this.clearSurfaces();
    this.setSolution(null);
    this.clearOutlines();
    this.targets.geometry.dispose();
    this.targets.material.dispose();
    for (const it of [this.points, this.paths, this.rays, this.voxels]) {
      it.geometry.dispose();
      it.material.dispose();
    }
    this.target.dispose();
    this.renderer.dispose();
  }

  readonly invalidate = () => {
    this.request ||= requestAnimationFrame(() => {
      this.request = 0;
      this.draw();
    });
  };

  /** Draws at once. */
  draw() {
    if (!this.eye || this.width < 2) return;
    cancelAnimationFrame(this.request);
    this.request = 0;
    this.placeHandles();
    this.renderer.setRenderTarget(null);
    this.renderer.render(this.scene, this.camera);
    this.frames++;
    this.canvas.dataset.frames = String(this.frames);
  }

  resize(width: number, height: number, pixelRatio: number) {
    this.width = width;
    this.height = height;
    this.pixelRatio = this.isSmooth ? Math.min(pixelRatio, 2) : 1;
    this.renderer.setPixelRatio(this.pixelRatio);
    this.renderer.setSize(width, height, false);
    this.resolution.value.set(width, height);
    this.paths.material.uniforms.width!.value = 2.4;
    this.rays.material.uniforms.width!.value = 1.1;
    this.points.material.uniforms.size!.value = 3.5 * this.pixelRatio;
    this.setCamera();
  }

  setTheme(isDark: boolean) {
    this.renderer.setClearColor(new Color(isDark ? BACKGROUNDS.dark : BACKGROUNDS.light), 1);
    this.invalidate();
  }

  /** - `radius`: half the extent of the scene, m. */
  setExtent(origin: Vec3, radius: number) {
    this.origin = origin;
    this.radius = radius;
    this.setCamera();
  }

  setEye(eye: Eye) {
    this.eye = eye;
    this.setCamera();
  }

  private setCamera() {
    const { eye, camera } = this;
    if (!eye) return;
    const [x, y, z] = this.local(placeOf(eye));
    const far = eye.distance + 6 * this.radius;
    camera.up.set(0, 0, 1);
    camera.position.set(x, y, z);
    camera.lookAt(new Vector3(...this.local(eye.target)));
    camera.fov = (eye.fov * 180) / Math.PI;
    camera.aspect = this.width / this.height;
    camera.near = Math.max(far * 2e-5, Math.min(eye.distance, this.radius) * 2e-3);
    camera.far = far;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    this.nearest.value = camera.near;
    // The light comes from beside the eye.
    this.headlight.position.copy(camera.localToWorld(new Vector3(0.4, 0.7, 1)));
    this.headlight.target.position.copy(camera.position);
    this.headlight.target.updateMatrixWorld();
    this.invalidate();
  }

  private local(at: Vec3): [number, number, number] {
    return [at[0] - this.origin[0], at[1] - this.origin[1], at[2] - this.origin[2]];
  }

  setCut(cut: Cut | null) {
    if (!cut) {
      this.cut.value.copy(NO_CUT);
      this.renderer.clippingPlanes = [];
    } else {
      const sign = cut.hidesAbove ? -1 : 1;
      const normal = new Vector3().setComponent(cut.axis, sign);
      const at = sign * (cut.at - this.origin[cut.axis]);
      this.cut.value.set(normal.x, normal.y, normal.z, at);
      this.plane.set(normal, -at);
      this.renderer.clippingPlanes = [this.plane];
    }
    this.invalidate();
  }

  // ---- Surfaces

  setGeometry(geometry: Geometry | null) {
    this.clearSurfaces();
    if (geometry) this.addSurfaces(geometry);
    this.invalidate();
  }

  private addSurfaces(geometry: Geometry) {
    const made = new Map<unknown, BufferGeometry>();
    const shift = this.local(geometry.origin);
    this.surfaces.position.set(...shift);
    geometry.objects.forEach((object) => {
      const matrix = new Matrix4().fromArray([...object.matrix]);
      for (const surface of object.surfaces) {
        let buffer = made.get(surface);
        if (!buffer) {
          buffer = new BufferGeometry();
          buffer.setAttribute('position', new BufferAttribute(surface.positions, 3));
          if (surface.normals) buffer.setAttribute('normal', new BufferAttribute(surface.normals, 3));
          buffer.setIndex(new BufferAttribute(surface.indices, 1));
          made.set(surface, buffer);
        }
        const { color, emissive, isDoubleSided } = geometry.materials[surface.material] ?? {
          color: [0.6, 0.6, 0.6, 1] as const,
          emissive: [0, 0, 0] as const,
          isDoubleSided: true,
        };
        const material = new MeshLambertMaterial({
          color: new Color(color[0], color[1], color[2]),
          emissive: new Color(emissive[0], emissive[1], emissive[2]),
          flatShading: surface.normals === null,
          side: isDoubleSided ? DoubleSide : FrontSide,
        });
        material.userData = { name: object.name, opacity: color[3], side: material.side, emissive: material.emissive.clone() };
        const mesh = new Mesh(buffer, material);
        mesh.matrixAutoUpdate = false;
        mesh.matrix.copy(matrix);
        mesh.userData.id = this.names.length + 1;
        this.surfaces.add(mesh);
      }
      this.names.push(object.name);
    });
  }

  // ---- Finite-element solution

  /** Shows elements instead of the surfaces; null: the surfaces. Picks find the surfaces in both cases. */
  setSolution(shown: ShownSolution | null) {
    for (const mesh of this.solution.children as Mesh<BufferGeometry, Material>[]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    this.solution.clear();
    this.solution.visible = shown !== null;
    this.surfaces.visible = this.areVisible && !this.solution.visible;
    if (shown) {
      this.solution.position.set(...this.local(shown.origin));
      for (const part of shown.parts) {
        const buffer = new BufferGeometry();
        buffer.setAttribute('position', new BufferAttribute(part.positions, 3));
        buffer.setAttribute('color', new BufferAttribute(part.colors, 3, true));
        buffer.setAttribute('quantity', new BufferAttribute(part.values, 1));
        buffer.setIndex(new BufferAttribute(part.indices, 1));
        this.solution.add(new Mesh(buffer, new ShaderMaterial({ ...ELEMENTS, vertexColors: true, clipping: true })));
      }
    }
    this.invalidate();
  }

  /** Draws the targets of paths. */
  setTargets(shown: ShownLines | null) {
    this.targets.visible = shown !== null;
    if (shown) {
      this.targets.position.set(...this.local(shown.origin));
      this.targets.geometry.dispose();
      this.targets.geometry = new BufferGeometry();
      this.targets.geometry.setAttribute('position', new BufferAttribute(shown.ends, 3));
    }
    this.invalidate();
  }

  /** Returns the value of the solution at a place of the canvas; null: no element is there. */
  valueAt(x: number, y: number): number | null {
    if (!this.solution.visible) return null;
    const meshes = this.solution.children as Mesh<BufferGeometry, Material>[];
    const before = meshes.map((mesh) => mesh.material);
    const material = new ShaderMaterial({ ...ELEMENT_VALUES, clipping: true });
    for (const mesh of meshes) mesh.material = material;
    const bytes = this.drawPixel(x, y, [this.surfaces]);
    meshes.forEach((mesh, i) => (mesh.material = before[i]!));
    material.dispose();
    const value = new DataView(bytes.buffer).getFloat32(0, true);
    return value > 0 ? value - VALUE_OFFSET : null;
  }

  private clearSurfaces() {
    for (const mesh of this.surfaces.children as Mesh<BufferGeometry, Material>[]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    this.surfaces.clear();
    this.names.length = 0;
  }

  /**
   * - `opacity`: 0 to 1.
   * - `hidesBacks`: whether surfaces that face away are invisible.
   */
  setSurfaces(isVisible: boolean, opacity: number, hidesBacks: boolean) {
    this.areVisible = isVisible && opacity > 0;
    this.surfaces.visible = this.areVisible && !this.solution.visible;
    for (const { material } of this.surfaces.children as Mesh<BufferGeometry, MeshLambertMaterial>[]) {
      material.opacity = opacity * material.userData.opacity;
      const isTransparent = material.opacity < 1;
      if (material.transparent !== isTransparent) material.needsUpdate = true;
      material.transparent = isTransparent;
      material.depthWrite = !isTransparent;
      material.side = hidesBacks ? FrontSide : material.userData.side;
    }
    this.invalidate();
  }

  /** Makes an object brighter, with all that it contains; null: none. */
  highlight(name: string | null) {
    for (const { material } of this.surfaces.children as Mesh<BufferGeometry, MeshLambertMaterial>[]) {
      const { userData } = material;
      material.emissive.copy(userData.emissive as Color);
      if (name !== null && isWithin(userData.name as string, name)) material.emissive.add(HIGHLIGHT);
    }
    this.invalidate();
  }

  // ---- Records

  setPoints(points: Points | null) {
    this.points.visible = points !== null && points.rows.length > 0;
    if (points) {
      const buffer = this.points.geometry;
      buffer.dispose();
      buffer.setAttribute('position', new BufferAttribute(points.positions, 3));
      buffer.setAttribute('color', new BufferAttribute(points.colors, 4, true));
      buffer.setDrawRange(0, points.rows.length);
    }
    this.invalidate();
  }

  setPaths(segments: Segments | null) {
    this.setSegments(this.paths, segments);
  }

  setRays(segments: Segments | null) {
    this.setSegments(this.rays, segments);
  }

  private setSegments(mesh: Mesh<InstancedBufferGeometry, ShaderMaterial>, segments: Segments | null) {
    mesh.visible = segments !== null && segments.count > 0;
    if (segments) {
      mesh.geometry.dispose();
      const next = stripGeometry();
      next.setAttribute('from', new InstancedBufferAttribute(segments.from, 3));
      next.setAttribute('to', new InstancedBufferAttribute(segments.to, 3));
      next.setAttribute('span', new InstancedBufferAttribute(segments.span, 2));
      next.setAttribute('color', new InstancedBufferAttribute(segments.colors, 4, true));
      next.instanceCount = segments.count;
      mesh.geometry = next;
    }
    this.invalidate();
  }

  /** Sets the visible window of lengths along the paths, m. */
  setWindow(begin: number, end: number) {
    this.paths.material.uniforms.window!.value.set(begin, end);
    this.invalidate();
  }

  setVoxels(voxels: Voxels | null) {
    this.voxels.visible = voxels !== null && voxels.count > 0;
    if (voxels) {
      this.voxels.geometry.dispose();
      const next = voxelGeometry();
      next.setAttribute('corner', new InstancedBufferAttribute(voxels.corners, 3));
      next.setAttribute('color', new InstancedBufferAttribute(voxels.colors, 4, true));
      next.instanceCount = voxels.count;
      this.voxels.geometry = next;
      this.voxels.material.uniforms.width!.value = voxels.width;
    }
    this.invalidate();
  }

  // ---- Picking

  /** Returns the object at a place of the canvas, in pixels of the page; null: none. */
  pick(x: number, y: number): Hit | null {
    if (!this.areVisible || !this.surfaces.children.length) return null;
    const number = this.pickNumber(x, y);
    const name = this.names[number - 1];
    return name === undefined ? null : { name };
  }

  /** Draws one pixel with the numbers of the objects as colors. */
  private pickNumber(x: number, y: number): number {
    const meshes = this.surfaces.children as Mesh<BufferGeometry, Material>[];
    const before = meshes.map((mesh) => mesh.material);
    const made = new Map<string, MeshBasicMaterial>();
    for (const mesh of meshes) {
      const { side } = mesh.material;
      const id = mesh.userData.id as number;
      const key = `${id} ${side}`;
      let material = made.get(key);
      if (!material) {
        material = new MeshBasicMaterial({ side });
        // The target has no color space: the components arrive as they are.
        material.color.setRGB((id & 255) / 255, ((id >> 8) & 255) / 255, ((id >> 16) & 255) / 255);
        made.set(key, material);
      }
      mesh.material = material;
    }
    this.surfaces.visible = true;
    const bytes = this.drawPixel(x, y, [this.solution]);
    this.surfaces.visible = this.areVisible && !this.solution.visible;
    meshes.forEach((mesh, i) => (mesh.material = before[i]!));
    for (const it of made.values()) it.dispose();
    return bytes[0]! + 256 * bytes[1]! + 65536 * bytes[2]!;
  }

  /**
   * Draws one pixel, without records and box, and returns its bytes.
   * - `without`: what else is invisible.
   */
  private drawPixel(x: number, y: number, without: readonly Object3D[]): Uint8Array {
    const others: Object3D[] = [this.points, this.paths, this.rays, this.voxels, this.box, this.outlines, this.targets, ...without];
    const shown = others.map((it) => it.visible);
    for (const it of others) it.visible = false;
    const bytes = new Uint8Array(4);
    const clear = this.renderer.getClearColor(new Color());
    this.camera.setViewOffset(this.width, this.height, x - 0.5, y - 0.5, 1, 1);
    this.renderer.setClearColor(0, 0);
    this.renderer.setRenderTarget(this.target);
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.renderer.readRenderTargetPixels(this.target, 0, 0, 1, 1, bytes);
    this.renderer.setRenderTarget(null);
    this.renderer.setClearColor(clear, 1);
    this.camera.clearViewOffset();
    others.forEach((it, i) => (it.visible = shown[i]!));
    return bytes;
  }

  /** Returns the place of a point on the canvas, and its depth; null: behind the eye. */
  project(at: Vec3): { x: number; y: number; z: number } | null {
    const [x, y, z] = this.local(at);
    const p = new Vector3(x, y, z).applyMatrix4(this.camera.matrixWorldInverse);
    if (p.z > -this.camera.near) return null;
    const depth = -p.z;
    p.applyMatrix4(this.camera.projectionMatrix);
    return { x: ((p.x + 1) / 2) * this.width, y: ((1 - p.y) / 2) * this.height, z: depth };
  }

  // ---- Box

  private makeBox() {
    const edges = new BufferGeometry();
    const ends: number[] = [];
    for (let a = 0; a < 8; a++) {
      for (const bit of [1, 2, 4]) {
        if (a & bit) continue;
        for (const corner of [a, a | bit]) ends.push(corner & 1, (corner >> 1) & 1, (corner >> 2) & 1);
      }
    }
    edges.setAttribute('position', new BufferAttribute(Float32Array.from(ends), 3));
    const lines = new LineSegments(edges, new LineBasicMaterial({ color: BOX_COLOR, depthTest: false, transparent: true }));
    lines.renderOrder = 2;
    this.box.add(lines);
    const ball = new SphereGeometry(1, 12, 8);
    for (let i = 0; i < 7; i++) {
      const color = i === 6 ? 0xffffff : [0xe0483e, 0x3fa535, 0x3b7dd8][i >> 1]!;
      const material = new MeshBasicMaterial({ color, depthTest: false, transparent: true });
      const handle = new Mesh(ball, material);
      handle.renderOrder = 3;
      this.handles.push(handle);
      this.box.add(handle);
    }
  }

  setBox(box: Box | null) {
    this.corners = box;
    this.box.visible = box !== null;
    this.invalidate();
  }

  /** Draws boxes without handles. */
  setOutlines(all: readonly Outline[]) {
    this.outlined = all;
    this.clearOutlines();
    const { geometry } = this.box.children[0] as LineSegments;
    for (const { color } of all) {
      const lines = new LineSegments(geometry, new LineBasicMaterial({ color, depthTest: false, transparent: true }));
      lines.renderOrder = 2;
      this.outlines.add(lines);
    }
    this.invalidate();
  }

  private clearOutlines() {
    for (const it of this.outlines.children) ((it as LineSegments).material as LineBasicMaterial).dispose();
    this.outlines.clear();
  }

  /** Moves the edges of a box to its place. */
  private placeEdges(lines: Object3D, box: Box) {
    lines.position.set(...this.local([box[0], box[1], box[2]]));
    lines.scale.set(box[3] - box[0], box[4] - box[1], box[5] - box[2]);
  }

  /** Returns the position of a handle in coordinates of the scene. */
  private handleAt(handle: Handle): Vec3 {
    const box = this.corners!;
    const at = [0, 1, 2].map((k) => (box[k]! + box[k + 3]!) / 2);
    if (handle < 6) at[handle >> 1] = box[(handle >> 1) + 3 * (handle & 1)]!;
    return at as unknown as Vec3;
  }

  private placeHandles() {
    this.outlines.children.forEach((lines, i) => this.placeEdges(lines, this.outlined[i]!.box));
    const box = this.corners;
    if (!box) return;
    this.placeEdges(this.box.children[0]!, box);
    const perPixel = (2 * Math.tan(this.eye!.fov / 2)) / this.height;
    this.handles.forEach((handle, i) => {
      handle.position.set(...this.local(this.handleAt(i)));
      handle.scale.setScalar(0.65 * HANDLE_PIXELS * perPixel * handle.position.distanceTo(this.camera.position));
    });
  }

  /** Returns the handle of the box at a place of the canvas. */
  handle(x: number, y: number, reach = HANDLE_PIXELS): Handle | null {
    if (!this.corners) return null;
    let best: Handle | null = null;
    let nearest = reach;
    for (let i = 0; i < 7; i++) {
      const at = this.project(this.handleAt(i));
      const away = at ? Math.hypot(at.x - x, at.y - y) : Infinity;
      if (away < nearest) [best, nearest] = [i, away];
    }
    return best;
  }

  /** Returns the box after a handle was dragged by pixels. A face moves along its axis, the middle in the plane of the screen. */
  dragged(box: Box, handle: Handle, dx: number, dy: number): Box {
    const next = [...box] as [number, number, number, number, number, number];
    const middle = this.handleAt(handle);
    const from = this.project(middle);
    if (!from) return box;
    if (handle === 6) {
      const perPixel = (2 * Math.tan(this.eye!.fov / 2) * from.z) / this.height;
      const { elements: m } = this.camera.matrixWorld;
      for (let k = 0; k < 3; k++) {
        const shift = perPixel * (dx * m[k]! - dy * m[4 + k]!);
        next[k] = box[k]! + shift;
        next[k + 3] = box[k + 3]! + shift;
      }
      return next;
    }
    const axis = handle >> 1;
    const step = 0.01 * this.radius;
    const beside = [...middle] as [number, number, number];
    beside[axis]! += step;
    const to = this.project(beside);
    const [ux, uy] = [(to?.x ?? from.x) - from.x, (to?.y ?? from.y) - from.y];
    const square = ux * ux + uy * uy;
    // An axis that points at the eye cannot be dragged.
    if (square < 1e-3) return box;
    const shift = (step * (dx * ux + dy * uy)) / square;
    const end = axis + 3 * (handle & 1);
    const other = box[axis + 3 * (1 - (handle & 1))]!;
    const least = 1e-3 * this.radius;
    next[end] = handle & 1 ? Math.max(box[end]! + shift, other + least) : Math.min(box[end]! + shift, other - least);
    return next;
  }
}

/** A strip of two triangles: x is the side, y the end. */
function stripGeometry(): InstancedBufferGeometry {
  const geometry = new InstancedBufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(Float32Array.of(-1, 0, 0, 1, 0, 0, 1, 1, 0, -1, 1, 0), 3));
  geometry.setIndex([0, 1, 2, 0, 2, 3]);
  geometry.instanceCount = 0;
  return geometry;
}

/** A cube from 0 to 1. */
function voxelGeometry(): InstancedBufferGeometry {
  const cube = new BoxGeometry(1, 1, 1).translate(0.5, 0.5, 0.5);
  const geometry = new InstancedBufferGeometry();
  geometry.setAttribute('position', cube.getAttribute('position'));
  geometry.setAttribute('normal', cube.getAttribute('normal'));
  geometry.setIndex(cube.getIndex());
  geometry.instanceCount = 0;
  return geometry;
}
