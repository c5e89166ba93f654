/** Graphics of the browser. */

import type { Scene } from './lines';
import { graphicsOf, type Graphics } from './renderer';

/** Drawing of a part of a plot on a canvas. */
export interface Drawing {
  /** Shows a scene; draws only what has changed. */
  update(scene: Scene): void;
  destroy(): void;
}

/** Time after which the page itself looks at the graphics. */
const WORKER_TIMEOUT_MS = 3000;

/** Looks at the graphics in a worker, because the start of WebGL stops a thread for long; null if workers have no WebGL2. */
function graphicsOfWorker(): Promise<Graphics | null> {
  return new Promise((done) => {
    if (typeof Worker !== 'function') return done(null);
    const worker = new Worker(new URL('./graphics.worker.ts', import.meta.url), { type: 'module', name: 'femc graphics' });
    const end = (found: Graphics | null) => {
      clearTimeout(timer);
      worker.terminate();
      done(found === 'none' ? null : found);
    };
    const timer = setTimeout(end, WORKER_TIMEOUT_MS, null);
    worker.onmessage = ({ data }: MessageEvent<Graphics>) => end(data);
    worker.onerror = () => end(null);
  });
}

let found: Promise<Graphics> | null = null;

/** Returns the graphics of the browser. */
export const graphics = (): Promise<Graphics> =>
  (found ??= graphicsOfWorker().then((it) => it ?? graphicsOf(document.createElement('canvas'))));
