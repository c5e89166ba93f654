/** Renderer behind WebGL2. */

/** `card`: WebGL2 with a graphics card; `software`: WebGL2 without one; `none`: no WebGL2. */
export type Graphics = 'card' | 'software' | 'none';

/** Returns the graphics that a canvas has. */
export function graphicsOf(canvas: HTMLCanvasElement | OffscreenCanvas): Graphics {
  const gl = canvas.getContext('webgl2') as WebGL2RenderingContext | null;
  if (!gl) return 'none';
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name) ? 'software' : 'card';
}
