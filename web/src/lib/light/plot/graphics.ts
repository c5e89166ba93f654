/** Graphics of the browser. */

import type { Scene } from './lines';

/** Drawing of the lines of a plot on a canvas. */
export interface Drawing {
  /** Shows a scene; draws only what has changed. */
  update(scene: Scene): void;
  destroy(): void;
}

/** `card`: WebGL2 with a graphics card; `software`: WebGL2 without one; `none`: no WebGL2. */
export type Graphics = 'card' | 'software' | 'none';

let known: Graphics | null = null;

/** Returns the graphics of the browser if they are known already. */
export const knownGraphics = (): Graphics | null => known;

/** Returns the graphics of the browser. */
export function graphics(): Graphics {
  if (known) return known;
  const gl = document.createElement('canvas').getContext('webgl2');
  if (!gl) return (known = 'none');
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension('WEBGL_lose_context')?.loseContext();
  return (known = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name) ? 'software' : 'card');
}
