/** The worker that looks at the graphics of the browser. */

import { graphicsOf } from './renderer';

postMessage(typeof OffscreenCanvas === 'function' ? graphicsOf(new OffscreenCanvas(1, 1)) : 'none');
