/**
 * Lines of a plot in WebGL2. Lines are counted, not blended: each pixel of a layer has the numbers of lines of A and of B.
 * A last pass over the pixels makes colors of the counts, so the order of the lines, the opacity and the colors do not need
 * a new drawing of the lines. The layer of all lines is kept while a selection changes.
 *
 * Lines are drawn in blocks. A frame has as many of them as the graphics processor finishes in time, so slow processors
 * show a part first and remain responsive. Heights are copied to the graphics processor in the frames before, one axis after another. Without a graphics card, pixels.ts draws the same picture.
 */

import type { PlotSet } from './contract';
import { addDensity, COLUMNS, ROWS } from './density';
import type { Drawing } from './graphics';
import type { Layout } from './layout';
import type { Palette } from './ratio';
import { heightsOf, type AxisScale } from './scale';

/** An axis on the screen. */
export interface ShownAxis {
  index: number;
  scale: AxisScale;
  flipped: boolean;
}

/** Everything that the lines depend on. Lengths are in CSS pixels. */
export interface Scene extends Layout {
  /** Device pixels per CSS pixel. */
  ratio: number;
  axes: readonly ShownAxis[];
  sets: readonly PlotSet[];
  opacity: number;
  showDensity: boolean;
  palette: Palette;
}

/** Rows of a line of the texture of heights. */
const WIDTH = 1024;
/** Lines of a block. */
const BLOCK = 2500;
/** Milliseconds of a frame for copies of heights and densities. */
const PREPARE_MS = 6;

/** Opacity of the density, and its value for full opacity, times 5. */
export const DENSITY = 0.55;
export const DENSEST = 160;
/** Opacity of lines outside the selection. */
export const REST = 0.5;
/** Part of the deep tone in the color of very many lines. */
export const DEEP = 0.6;

const LINES = `#version 300 es
precision highp float;
uniform highp sampler2D heights;
uniform ivec3 at;
uniform vec2 flipped;
uniform vec4 place;
void main() {
  int row = gl_VertexID >> 1;
  bool isRight = (gl_VertexID & 1) == 1;
  float y = texelFetch(heights, ivec2(row & ${WIDTH - 1}, (isRight ? at.y : at.x) * at.z + (row >> 10)), 0).r;
  float f = isRight ? flipped.y : flipped.x;
  y = mix(y, 1.0 - y, f);
  gl_Position = vec4(isRight ? place.y : place.x, mix(place.z, place.w, y), 0.0, 1.0);
}`;

const COUNT = `#version 300 es
precision mediump float;
uniform vec4 weight;
out vec4 color;
void main() { color = weight; }`;

const SCREEN = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

const COLORS = `#version 300 es
precision highp float;
uniform highp sampler2D all;
uniform highp sampler2D chosen;
uniform highp sampler2D density;
uniform vec4 strips;
uniform vec2 area;
uniform vec3 scaling;
uniform vec3 palette[5];
uniform vec4 options;
uniform vec4 deep;
out vec4 color;
vec3 tint(vec2 n) {
  if (options.z < 0.5) return palette[3];
  float t = (n.x - n.y) / max(n.x + n.y, 1e-20);
  return mix(palette[1], t < 0.0 ? palette[2] : palette[0], abs(t));
}
float cover(float x) { return x / (1.0 + x); }
vec4 over(vec4 below, vec3 tone, float alpha) { return vec4(tone * alpha, alpha) + below * (1.0 - alpha); }
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 c = vec4(0.0);
  float s = (gl_FragCoord.x - strips.x) / strips.y;
  float v = (gl_FragCoord.y - area.x) / area.y;
  if (options.w > 0.0 && s >= 0.0 && s < strips.z && v >= 0.0 && v <= 1.0) {
    float u = floor(s) * ${COLUMNS}.0 + clamp(fract(s) * ${COLUMNS}.0, 0.5, ${COLUMNS - 0.5});
    vec2 d = texture(density, vec2(u / (strips.z * ${COLUMNS}.0), v)).rg;
    float m = options.z < 0.5 ? d.x : 0.5 * (d.x + d.y);
    float alpha = options.w * min(log(1.0 + 5.0 * m) / log(${DENSEST}.0), 1.0);
    c = over(c, options.z < 0.5 ? palette[4] : tint(d), alpha);
  }
  vec2 n = texelFetch(all, at, 0).rg * scaling.z;
  if (options.y > 0.5) {
    c = over(c, palette[4], ${REST} * cover(options.x * (n.x + n.y)));
    n = texelFetch(chosen, at, 0).rg * scaling.z;
  }
  float x = options.x * (n.x + n.y);
  if (x > 0.0) {
    vec3 tone = mix(tint(n * scaling.xy), deep.rgb, deep.w * clamp(log2(1.0 + x) / 5.0 - 0.25, 0.0, 1.0));
    c = over(c, tone, cover(x));
  }
  color = c;
}`;

interface Layer {
  texture: WebGLTexture;
  target: WebGLFramebuffer;
  /** Buffer with several samples a pixel that is copied to the texture. */
  samples: WebGLFramebuffer | null;
  renderbuffer: WebGLRenderbuffer | null;
  /** Keys of the strips in the layer. */
  keys: string[];
  isStale: boolean;
}

interface SetBuffers {
  texture: WebGLTexture;
  axes: number;
  blocks: number;
  /** Heights in the texture, by axis. */
  columns: (Float32Array | undefined)[];
  array: WebGLVertexArrayObject;
  elements: WebGLBuffer;
  selected: Uint8Array | null;
  count: number;
}

interface Work {
  layer: 0 | 1;
  block: number;
  strip: number;
  set: number;
}

const numbers = new WeakMap<object, number>();
let lastNumber = 0;
/** Returns a number that identifies an object. */
export function identity(it: object | null | undefined): number {
  if (!it) return 0;
  let number = numbers.get(it);
  if (number === undefined) numbers.set(it, (number = ++lastNumber));
  return number;
}

/** Returns a text that changes with the heights of an axis. */
export const shape = ({ index, scale, flipped }: ShownAxis): string => `${index} ${flipped} ${scale.key}`;

/** Drawing of the lines on a canvas. */
export class LineDrawing implements Drawing {
  private gl: WebGL2RenderingContext;
  private lines!: WebGLProgram;
  private colors!: WebGLProgram;
  private uniforms = new Map<string, WebGLUniformLocation | null>();
  private layers: Layer[] = [];
  private sets: SetBuffers[] = [];
  private density: WebGLTexture | null = null;
  private densityKeys: string[] = [];
  private densityWork: number[] = [];
  /** Axes whose heights are not copied yet. */
  private uploads: { set: number; place: number }[] = [];
  private work: Work[] = [];
  private scene: Scene | null = null;
  private size = '';
  private frame = 0;
  private fence: WebGLSync | null = null;
  private submitted = { at: 0, segments: 0 };
  private began = 0;
  private isStale = false;
  private isFloat = false;
  private samples = 0;
  /** Segments of lines that a frame may draw. */
  private budget = 200_000;
  private isLost = false;

  /**
   * Begins to draw on a canvas; throws an error without WebGL2.
   * - `ondrawn`: called with the milliseconds since the change when everything is on the screen
   */
  constructor(
    private canvas: HTMLCanvasElement,
    private ondrawn?: (milliseconds: number) => void,
  ) {
    const gl = canvas.getContext('webgl2', { alpha: true, antialias: false, depth: false, powerPreference: 'high-performance' });
    if (!gl) throw new Error('no WebGL2');
    this.gl = gl;
    canvas.addEventListener('webglcontextlost', this.lose);
    canvas.addEventListener('webglcontextrestored', this.restore);
    this.begin();
  }

  private lose = (event: Event) => {
    event.preventDefault();
    this.isLost = true;
    cancelAnimationFrame(this.frame);
    this.frame = 0;
  };

  private restore = () => {
    this.isLost = false;
    this.begin();
    if (this.scene) this.update(this.scene);
  };

  private begin() {
    const { gl } = this;
    this.isFloat = gl.getExtension('EXT_color_buffer_float') !== null;
    this.budget = 200_000;
    this.uniforms.clear();
    this.lines = this.program(LINES, COUNT);
    this.colors = this.program(SCREEN, COLORS);
    [this.layers, this.sets, this.work, this.densityWork, this.uploads] = [[], [], [], [], []];
    [this.density, this.densityKeys, this.fence, this.size] = [null, [], null, ''];
  }

  private program(vertex: string, fragment: string): WebGLProgram {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [type, text] of [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ] as const) {
      const shader = gl.createShader(type)!;
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(`cannot link a program of the plot: ${gl.getProgramInfoLog(program)}`);
    return program;
  }

  private uniform(program: WebGLProgram, name: string): WebGLUniformLocation | null {
    const key = `${program === this.lines} ${name}`;
    if (!this.uniforms.has(key)) this.uniforms.set(key, this.gl.getUniformLocation(program, name));
    return this.uniforms.get(key)!;
  }

  private texture(filter: number): WebGLTexture {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }

  private layer(width: number, height: number): Layer {
    const { gl } = this;
    const format = this.isFloat ? gl.RG16F : gl.RG8;
    const texture = this.texture(gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    const target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    let [samples, renderbuffer]: [WebGLFramebuffer | null, WebGLRenderbuffer | null] = [null, null];
    if (this.samples > 1) {
      renderbuffer = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, renderbuffer);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, this.samples, format, width, height);
      samples = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, samples);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, renderbuffer);
      gl.clear(gl.COLOR_BUFFER_BIT);
    }
    return { texture, target, samples, renderbuffer, keys: [], isStale: false };
  }

  private dropLayers() {
    const { gl } = this;
    for (const { texture, target, samples, renderbuffer } of this.layers) {
      gl.deleteFramebuffer(target);
      gl.deleteFramebuffer(samples);
      gl.deleteRenderbuffer(renderbuffer);
      gl.deleteTexture(texture);
    }
    this.layers = [];
  }

  /** Shows a scene; draws only what has changed. */
  update(scene: Scene) {
    this.scene = scene;
    const { gl } = this;
    if (this.isLost || gl.isContextLost()) return;
    this.began ||= performance.now();
    const [width, height] = [scene.width, scene.height].map((it) => Math.max(1, Math.round(it * scene.ratio))) as [
      number,
      number,
    ];
    const hasSelection = scene.sets.some((it) => it.selected);
    const size = `${width} ${height}`;
    if (this.size !== size) {
      this.size = size;
      [this.canvas.width, this.canvas.height] = [width, height];
      this.dropLayers();
      this.work = [];
      // Pixels of fine screens are smaller than what samples within pixels improve.
      const most = scene.ratio > 1.5 ? 0 : 4;
      const offered = gl.getInternalformatParameter(gl.RENDERBUFFER, this.isFloat ? gl.RG16F : gl.RG8, gl.SAMPLES);
      this.samples = Math.min(most, (offered as Int32Array | null)?.[0] ?? 0);
      this.layers = [this.layer(width, height), this.layer(width, height)];
    }
    this.upload(scene);
    this.plan(scene, hasSelection);
    this.isStale = true;
    this.frame ||= requestAnimationFrame(this.tick);
  }

  /** Copies selections that have changed, and notes the axes whose heights have to be copied. */
  private upload(scene: Scene) {
    const { gl } = this;
    this.uploads = [];
    scene.sets.forEach((set, number) => {
      const axes = set.values.length;
      const blocks = Math.max(1, Math.ceil(set.rows / WIDTH));
      let own = this.sets[number];
      if (!own || own.axes !== axes || own.blocks !== blocks) {
        if (own) gl.deleteTexture(own.texture);
        const texture = this.texture(gl.NEAREST);
        gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32F, WIDTH, blocks * axes);
        const array = own?.array ?? gl.createVertexArray();
        const elements = own?.elements ?? gl.createBuffer();
        gl.bindVertexArray(array);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, elements);
        own = { texture, axes, blocks, columns: [], array, elements, selected: null, count: 0 };
        this.sets[number] = own;
      }
      for (const place of scene.axes.keys()) this.uploads.push({ set: number, place });
      if (set.selected && own.selected !== set.selected) {
        const elements = new Uint32Array(2 * set.rows);
        let n = 0;
        for (let i = 0; i < set.rows; i++) {
          if (!set.selected[i]) continue;
          elements[n++] = 2 * i;
          elements[n++] = 2 * i + 1;
        }
        own.count = n / 2;
        gl.bindVertexArray(own.array);
        gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, elements.subarray(0, n), gl.DYNAMIC_DRAW);
      }
      own.selected = set.selected;
    });
  }

  /** Copies the heights of an axis if they have changed. */
  private uploadAxis(scene: Scene, { set: number, place }: { set: number; place: number }) {
    const { gl } = this;
    const [set, own, axis] = [scene.sets[number], this.sets[number], scene.axes[place]];
    const values = axis && set?.values[axis.index];
    if (!set || !own || !values) return;
    const heights = heightsOf(values, axis.scale);
    if (own.columns[axis.index] === heights) return;
    own.columns[axis.index] = heights;
    const padded = new Float32Array(WIDTH * own.blocks);
    padded.set(heights.subarray(0, set.rows));
    gl.bindTexture(gl.TEXTURE_2D, own.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, axis.index * own.blocks, WIDTH, own.blocks, gl.RED, gl.FLOAT, padded);
  }

  /** Position of an axis in device pixels. */
  private column(scene: Scene, place: number): number {
    return Math.round((scene.left + place * scene.spacing) * scene.ratio);
  }

  /** Notes the strips between axes that have to be drawn. */
  private plan(scene: Scene, hasSelection: boolean) {
    const { gl } = this;
    const { axes, sets } = scene;
    const strips = Math.max(axes.length - 1, 0);
    const keys = Array.from({ length: strips }, (_, i) => {
      const [a, b] = [axes[i]!, axes[i + 1]!];
      const data = sets.map((it) => `${it.rows} ${identity(it.values[a.index])} ${identity(it.values[b.index])}`);
      return `${this.column(scene, i)} ${shape(a)} ${shape(b)} ${scene.top} ${scene.bottom} ${data.join(' ')}`;
    });
    this.layers.forEach((layer, number) => {
      const chosen = number === 1 ? sets.map((it) => identity(it.selected)).join(' ') : '';
      if (number === 1 && !hasSelection) {
        layer.keys = [];
        this.work = this.work.filter((it) => it.layer !== 1);
        return;
      }
      const stale: number[] = [];
      for (let i = 0; i < Math.max(strips, layer.keys.length); i++) {
        const key = i < strips ? `${keys[i]} ${chosen}` : undefined;
        if (key !== undefined && key === layer.keys[i]) continue;
        if (key !== undefined) stale.push(i);
      }
      const isAll = stale.length === strips || layer.keys.length !== strips;
      const again = isAll ? Array.from({ length: strips }, (_, i) => i) : stale;
      if (again.length === 0 && !isAll) return;
      this.work = this.work.filter((it) => it.layer !== number || !again.includes(it.strip));
      gl.bindFramebuffer(gl.FRAMEBUFFER, layer.samples ?? layer.target);
      gl.clearColor(0, 0, 0, 0);
      if (isAll) gl.clear(gl.COLOR_BUFFER_BIT);
      else {
        gl.enable(gl.SCISSOR_TEST);
        for (const i of again) {
          const from = this.column(scene, i);
          gl.scissor(from, 0, this.column(scene, i + 1) - from, this.canvas.height);
          gl.clear(gl.COLOR_BUFFER_BIT);
        }
        gl.disable(gl.SCISSOR_TEST);
      }
      layer.isStale = true;
      layer.keys = keys.map((key) => `${key} ${chosen}`);
      sets.forEach((set, index) => {
        const rows = number === 1 ? (set.selected ? this.sets[index]!.count : 0) : set.rows;
        for (let block = 0; block * BLOCK < rows; block++)
          for (const strip of again) this.work.push({ layer: number as 0 | 1, block, strip, set: index });
      });
    });
    // Each block is drawn between all axes before the next one.
    this.work.sort((a, b) => a.layer - b.layer || a.block - b.block || a.strip - b.strip);

    if (!scene.showDensity || strips === 0) return;
    const dense = Array.from({ length: strips }, (_, i) => {
      const [a, b] = [axes[i]!, axes[i + 1]!];
      return `${shape(a)} ${shape(b)} ${sets.map((it) => identity(it.pair(a.index, b.index))).join()}`;
    });
    if (dense.length !== this.densityKeys.length) {
      if (this.density) gl.deleteTexture(this.density);
      this.density = this.texture(gl.LINEAR);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RG16F, COLUMNS * strips, ROWS);
      this.densityKeys = [];
    }
    for (let i = 0; i < strips; i++)
      if (dense[i] !== this.densityKeys[i] && !this.densityWork.includes(i)) this.densityWork.push(i);
    this.densityWork = this.densityWork.filter((i) => i < strips);
    this.densityKeys = dense;
  }

  private tick = () => {
    this.frame = 0;
    const { gl, scene } = this;
    if (!scene || this.isLost || gl.isContextLost()) return;
    if (this.fence) {
      if (gl.getSyncParameter(this.fence, gl.SYNC_STATUS) !== gl.SIGNALED) {
        this.frame = requestAnimationFrame(this.tick);
        return;
      }
      gl.deleteSync(this.fence);
      this.fence = null;
      const { at, segments } = this.submitted;
      if (segments > 0) {
        const factor = 20 / Math.max(performance.now() - at, 1);
        const wasFull = segments > 0.7 * this.budget;
        if (wasFull || factor < 1) this.budget *= Math.min(Math.max(factor, 0.5), 2);
        this.budget = Math.min(Math.max(this.budget, 15_000), 5_000_000);
      }
      if (!this.isStale && this.work.length === 0 && this.densityWork.length === 0 && this.uploads.length === 0) {
        this.ondrawn?.(performance.now() - this.began);
        this.began = 0;
        return;
      }
    }
    const end = performance.now() + PREPARE_MS;
    while (this.uploads.length > 0 && performance.now() < end) this.uploadAxis(scene, this.uploads.shift()!);
    if (this.uploads.length > 0) {
      this.frame = requestAnimationFrame(this.tick);
      return;
    }
    while (this.densityWork.length > 0 && performance.now() < end) this.drawDensity(scene, this.densityWork.shift()!);
    const segments = this.drawLines(scene);
    this.composite(scene);
    this.isStale = false;
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.submitted = { at: performance.now(), segments };
    this.frame = requestAnimationFrame(this.tick);
  };

  private drawDensity(scene: Scene, strip: number) {
    const { gl } = this;
    const [a, b] = [scene.axes[strip], scene.axes[strip + 1]];
    if (!a || !b || !this.density) return;
    const pixels = new Float32Array(2 * COLUMNS * ROWS);
    scene.sets.slice(0, 2).forEach((set, number) => {
      const counts = set.pair(a.index, b.index);
      if (counts) addDensity(counts, { ...a.scale, flipped: a.flipped }, { ...b.scale, flipped: b.flipped }, pixels, 2, number);
    });
    gl.bindTexture(gl.TEXTURE_2D, this.density);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, COLUMNS * strip, 0, COLUMNS, ROWS, gl.RG, gl.FLOAT, pixels);
  }

  /** Draws blocks of lines up to the budget; returns the number of segments. */
  private drawLines(scene: Scene): number {
    const { gl, lines } = this;
    const { width, height } = this.canvas;
    let segments = 0;
    if (this.work.length === 0) return 0;
    gl.useProgram(lines);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    gl.enable(gl.SCISSOR_TEST);
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(this.uniform(lines, 'heights'), 0);
    const unit = this.isFloat ? 1 : 1 / 255;
    const y = (css: number) => 1 - (2 * css) / scene.height;
    let [layer, set] = [-1, -1];
    let taken = 0;
    for (const it of this.work) {
      if (segments >= this.budget) break;
      taken++;
      const [a, b, own] = [scene.axes[it.strip], scene.axes[it.strip + 1], this.sets[it.set]];
      const rows = it.layer === 1 ? own?.count : scene.sets[it.set]?.rows;
      if (!a || !b || !own || !rows) continue;
      if (layer !== it.layer) {
        layer = it.layer;
        const target = this.layers[layer]!;
        target.isStale = true;
        gl.bindFramebuffer(gl.FRAMEBUFFER, target.samples ?? target.target);
      }
      if (set !== it.set) {
        set = it.set;
        gl.bindVertexArray(own.array);
        gl.bindTexture(gl.TEXTURE_2D, own.texture);
        gl.uniform4f(this.uniform(lines, 'weight'), set === 0 ? unit : 0, set === 0 ? 0 : unit, 0, 0);
      }
      const [from, to] = [this.column(scene, it.strip), this.column(scene, it.strip + 1)];
      gl.scissor(from, 0, to - from, height);
      gl.uniform3i(this.uniform(lines, 'at'), a.index, b.index, own.blocks);
      gl.uniform2f(this.uniform(lines, 'flipped'), Number(a.flipped), Number(b.flipped));
      gl.uniform4f(this.uniform(lines, 'place'), (2 * from) / width - 1, (2 * to) / width - 1, y(scene.bottom), y(scene.top));
      const count = Math.min(BLOCK, rows - it.block * BLOCK);
      if (count <= 0) continue;
      if (it.layer === 0) gl.drawArrays(gl.LINES, 2 * BLOCK * it.block, 2 * count);
      else gl.drawElements(gl.LINES, 2 * count, gl.UNSIGNED_INT, 8 * BLOCK * it.block);
      segments += count;
    }
    this.work.splice(0, taken);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
    return segments;
  }

  /** Makes colors of the counts. */
  private composite(scene: Scene) {
    const { gl, colors } = this;
    const { width, height } = this.canvas;
    const { ratio, palette, sets } = scene;
    for (const layer of this.layers) {
      if (!layer.isStale || !layer.samples) continue;
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, layer.samples);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, layer.target);
      gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
      layer.isStale = false;
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.useProgram(colors);
    const at = (name: string) => this.uniform(colors, name);
    [this.layers[0]!.texture, this.layers[1]!.texture, this.density].forEach((texture, i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(at(['all', 'chosen', 'density'][i]!), i);
    });
    const strips = Math.max(scene.axes.length - 1, 0);
    gl.uniform4f(at('strips'), scene.left * ratio, scene.spacing * ratio, strips, 0);
    gl.uniform2f(at('area'), height - scene.bottom * ratio, (scene.bottom - scene.top) * ratio);
    gl.uniform3f(at('scaling'), 1 / (sets[0]?.rows || 1), 1 / (sets[1]?.rows || 1), this.isFloat ? 1 : 255);
    const tones = [palette.a, palette.equal, palette.b, palette.single, palette.rest];
    gl.uniform3fv(at('palette'), tones.flatMap((it) => it.map((v) => v / 255)));
    const hasSelection = sets.some((it) => it.selected);
    const dense = scene.showDensity && this.density && strips > 0 ? DENSITY : 0;
    gl.uniform4f(at('options'), Math.min(Math.max(scene.opacity, 0), 0.999), Number(hasSelection), Number(sets.length > 1), dense);
    gl.uniform4f(at('deep'), ...(palette.deep.map((v) => v / 255) as [number, number, number]), DEEP);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.activeTexture(gl.TEXTURE0);
  }

  /** Frees everything on the graphics processor. */
  destroy() {
    cancelAnimationFrame(this.frame);
    this.canvas.removeEventListener('webglcontextlost', this.lose);
    this.canvas.removeEventListener('webglcontextrestored', this.restore);
    this.scene = null;
    this.gl.getExtension('WEBGL_lose_context')?.loseContext();
  }
}
