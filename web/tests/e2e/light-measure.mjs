/**
 * Times and memory of the light view in Chromium with graphics in software, as JSON lines:
 *
 *     node tests/e2e/light-measure.mjs FILE.paths [--lines 10000] [--steps 40]
 *
 * FEMC names the program, CHROMIUM the browser; FEMC_PAGES is a folder of built pages that take the place of those in the program.
 * Not a part of `run`.
 */
import { existsSync, readFileSync } from 'node:fs';
import { loadavg } from 'node:os';
import { join, resolve } from 'node:path';
import { chromium } from 'playwright-core';
import { Farm, pause, until } from './farm.mjs';
import { view } from './light.mjs';
import { Tasks } from './tasks.mjs';

const args = process.argv.slice(2);
const option = (name, other) => (args.includes(name) ? Number(args.splice(args.indexOf(name), 2)[1]) : other);
const [lines, steps] = [option('--lines', 10_000), option('--steps', 40)];
const file = resolve(args[0]);
const print = (it) => console.log(JSON.stringify(it));
const round = (v) => Math.round(v * 10) / 10;
const sorted = (list) => list.toSorted((a, b) => a - b);
const summary = (list) => ({
  count: list.length,
  median_ms: round(sorted(list)[list.length >> 1] ?? NaN),
  p90_ms: round(sorted(list)[Math.floor(0.9 * list.length)] ?? NaN),
  max_ms: round(Math.max(...list)),
});
/** Resident memory of a process in MiB. */
const resident = (pid) => round(Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, 'utf8'))?.[1]) / 1024);

const cpu = /model name\s*:\s*(.*)/.exec(readFileSync('/proc/cpuinfo', 'utf8'))?.[1];
const farm = await Farm.start();
const server = await view(farm, file);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync',
    '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'],
});
try {
  const page = await browser.newPage({ viewport: { width: 1360, height: 1000 } });
  const pages = process.env.FEMC_PAGES;
  if (pages)
    await page.route((url) => url.origin === server.url && !url.pathname.startsWith('/api/'), (route) => {
      if (route.request().method() !== 'GET') return route.continue();
      const path = join(pages, new URL(route.request().url()).pathname);
      return route.fulfill({ path: /\.\w+$/.test(path) && existsSync(path) ? path : join(pages, 'index.html') });
    });
  await page.addInitScript(() => {
    const it = (globalThis.measured = { drawn: 0, event: 0, up: 0 });
    // The last drawing of lines, by WebGL2 or by pixels; the pixels of a card are read, so that it has finished.
    const wrap = (prototype, name, after) => {
      const draw = prototype[name];
      prototype[name] = function (...more) {
        const out = draw.apply(this, more);
        if (this.canvas?.closest?.('[data-plot]')) {
          after?.(this);
          it.drawn = performance.now();
        }
        return out;
      };
    };
    wrap(CanvasRenderingContext2D.prototype, 'putImageData');
    wrap(WebGL2RenderingContext.prototype, 'drawArrays', (gl) => gl.finish());
    wrap(WebGL2RenderingContext.prototype, 'drawArraysInstanced', (gl) => gl.finish());
    addEventListener('pointermove', (event) => (it.event = event.timeStamp), true);
    addEventListener('pointerup', (event) => (it.up = event.timeStamp), true);
  });
  const began = Date.now();
  await page.goto(server.address);
  await page.locator('[data-plot=paths]').waitFor({ timeout: 60_000 });
  await page.goto('about:blank');
  const recorded = await Tasks.begin(browser, page);
  await page.goto(`${server.url}/view?n=${lines}`);
  await page.locator('[data-plot=lights]').waitFor({ timeout: 60_000 });
  /** Waits until the lines have not changed for a while; the time of the last change. */
  const quiet = (ms = 400) => page.evaluate(async (ms) => {
    const { measured } = globalThis;
    const from = performance.now();
    while (performance.now() - Math.max(measured.drawn, from) < ms) await new Promise((done) => setTimeout(done, 20));
    return measured.drawn;
  }, ms);
  await quiet(1500);
  const tasks = async (what) => print({ what: `tasks of the main thread: ${what}`, load: loadavg()[0], ...(await recorded.take()) });
  const axes = await page.locator('[data-plot=paths] .column').count();
  print({
    what: 'setting', file, cpu, cores: Number(readFileSync('/proc/cpuinfo', 'utf8').match(/^processor/gm).length), load: loadavg()[0],
    browser: browser.version(), axes, seconds_to_open: round((Date.now() - began) / 1000),
    totals: (await page.locator('[data-totals]').innerText()).replace(/\s+/g, ' '),
    gl: await page.evaluate(() => {
      const gl = document.createElement('canvas').getContext('webgl2');
      return gl && gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info')?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER);
    }),
  });
  await tasks('opening the page');

  const place = async (name) => {
    const column = page.locator('[data-plot=paths]').getByRole('group', { name, exact: true });
    const strip = column.locator('.strip');
    await strip.evaluate((it) => it.scrollIntoView({ block: 'center', inline: 'center' }));
    await pause(200);
    const [box, head] = [await strip.boundingBox(), await column.locator('.title').boundingBox()];
    return { x: head.x + head.width / 2, y: (height) => box.y + 10 + (1 - height) * (box.height - 20) };
  };
  const clear = async () => {
    await page.locator('[data-plot=paths]').getByRole('button', { name: 'Clear brushes' }).click();
    await until(() => !new URL(page.url()).search.includes('where'), 'cleared');
    await quiet();
  };

  // One step at a time: until the brush has moved on the screen, and until all lines show the new selection.
  let at = await place('pixel.x');
  await page.mouse.move(at.x, at.y(0.05));
  await page.mouse.down();
  const [frames, whole] = [[], []];
  for (let i = 1; i <= steps; i++) {
    const next = page.evaluate(() => new Promise((done) => {
      addEventListener('pointermove', (event) => requestAnimationFrame(() => {
        const { port1, port2 } = new MessageChannel();
        port1.onmessage = () => done([event.timeStamp, performance.now()]);
        port2.postMessage(0);
      }), { capture: true, once: true });
    }));
    await pause(20);
    await page.mouse.move(at.x, at.y(0.05 + (0.85 * i) / steps));
    const [event, painted] = await next;
    frames.push(painted - event);
    whole.push((await quiet()) - event);
  }
  await page.mouse.up();
  print({ what: 'brushing, from the event to the next frame', ...summary(frames) });
  print({ what: 'brushing, from the event to all lines of the new selection, with the answer of the server', ...summary(whole) });
  await tasks('brushing step by step');
  await clear();

  // A drag as a hand does it.
  at = await place('radiance.g');
  await page.mouse.move(at.x, at.y(0.2));
  await page.mouse.down();
  await page.evaluate(() => {
    const gaps = (globalThis.gaps = []);
    let last = performance.now();
    requestAnimationFrame(function tick(now) {
      gaps.push(now - last);
      last = now;
      if (globalThis.gaps === gaps) requestAnimationFrame(tick);
    });
  });
  for (let i = 1; i <= steps; i++) {
    await page.mouse.move(at.x, at.y(0.2 + (0.6 * i) / steps));
    await pause(16);
  }
  await page.mouse.up();
  const gaps = await page.evaluate(() => {
    const { gaps } = globalThis;
    globalThis.gaps = null;
    return gaps;
  });
  await quiet();
  print({ what: 'frames while a brush is dragged', ...summary(gaps.slice(1)) });
  await tasks('dragging a brush');
  await clear();

  // From the end of a brush to its counts.
  const counted = [];
  for (let i = 0; i < 20; i++) {
    const name = ['pixel.x', 'pixel.y', 'radiance.g', 'first.x'][i % 4];
    at = await place(name);
    const from = 0.1 + 0.03 * i;
    const took = page.evaluate(() => new Promise((done) => {
      const line = () => document.querySelector('[aria-label=Selection] .counts');
      addEventListener('pointerup', (event) => {
        // The page asks for the last selection within two frames. It may have the answer already.
        let frame = 0;
        requestAnimationFrame(function look() {
          if (++frame > 2 && line().ariaBusy === 'false' && line().textContent.trim()) done(performance.now() - event.timeStamp);
          else requestAnimationFrame(look);
        });
      }, { capture: true, once: true });
    }));
    await page.mouse.move(at.x, at.y(from));
    await page.mouse.down();
    await page.mouse.move(at.x, at.y(from + 0.1));
    await page.mouse.move(at.x, at.y(from + 0.25));
    await page.mouse.up();
    counted.push(await took);
    await clear();
  }
  print({ what: 'from the end of a brush to its counts', ...summary(counted) });
  await tasks('20 brushes');

  const session = await page.context().newCDPSession(page);
  const used = async () => {
    await session.send('HeapProfiler.collectGarbage');
    await session.send('Performance.enable');
    const { metrics } = await session.send('Performance.getMetrics');
    return round(metrics.find((it) => it.name === 'JSHeapUsedSize').value / 2 ** 20);
  };
  const whole_browser = await browser.newBrowserCDPSession();
  const { processInfo } = await whole_browser.send('SystemInfo.getProcessInfo');
  const renderers = processInfo.filter((it) => it.type === 'renderer').map((it) => resident(it.id));
  print({
    what: 'memory, MiB',
    js_heap: await used(),
    renderer_resident: Math.max(...renderers),
    gpu_process_resident: Math.max(0, ...processInfo.filter((it) => /gpu/i.test(it.type)).map((it) => resident(it.id))),
    server_resident: resident(server.child.pid),
  });
} finally {
  await browser.close();
  await farm.kill(server.child);
  await farm.end();
}
