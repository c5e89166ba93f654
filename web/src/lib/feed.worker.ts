/** The shared worker that holds the feed for all pages of a browser. */

import { Hub, type Port } from './hub';

const hub = new Hub();

addEventListener('connect', (event) => {
  const [port] = (event as MessageEvent).ports;
  if (port) hub.connect(port as unknown as Port);
});
