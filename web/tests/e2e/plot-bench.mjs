/**
 * Times of a plot of 10,000 made-up paths over 20 axes in Chromium, as JSON lines:
 *
 *     CHROMIUM=/usr/bin/chromium node tests/e2e/plot-bench.mjs [--shots FOLDER] [--rows N] [--sets N] [--limit MS] [--task MS]
 *
 * Exits with 1 if a frame of brushing takes longer than --limit, or a task of the main thread longer than --task.
 */
import { mkdirSync, mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { svelte } from '@sveltejs/vite-plugin-svelte';
import { chromium } from 'playwright-core';
import { build, preview } from 'vite';

const args = process.argv.slice(2);
const option = (name, other) => (args.includes(name) ? args[args.indexOf(name) + 1] : other);
const shots = option('--shots', null);
const rows = Number(option('--rows', 10_000));
const sets = Number(option('--sets', 1));
if (shots) mkdirSync(shots, { recursive: true });

const here = join(dirname(fileURLToPath(import.meta.url)), 'plot');
const outDir = mkdtempSync(join(tmpdir(), 'plot-bench-'));
const shared = { root: here, configFile: false, logLevel: 'error', plugins: [svelte({ compilerOptions: { css: 'external', runes: true } })] };
await build({ ...shared, build: { outDir, target: 'es2022', emptyOutDir: true } });
const server = await preview({ ...shared, build: { outDir }, preview: { port: 0, host: '127.0.0.1' } });
const { port } = server.httpServer.address();

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--disable-gpu', '--enable-unsafe-swiftshader', '--no-first-run', '--disable-background-networking'],
});
const print = (it) => console.log(JSON.stringify(it));
const sorted = (list) => list.toSorted((a, b) => a - b);
const median = (list) => sorted(list)[Math.floor(list.length / 2)];
let isBad = false;

export async function open(more = {}, query = '') {
  const context = await browser.newContext({ viewport: { width: 1440, height: 460 }, ...more });
  const page = await context.newPage();
  page.on('pageerror', (error) => {
    console.error(`error of a script: ${error.message}`);
    isBad = true;
  });
  page.on('console', (message) => {
    if (message.type() === 'error' && !message.text().includes('404')) console.error(message.text());
  });
  await page.addInitScript(() => {
    globalThis.tasks = [];
    new PerformanceObserver((list) => {
      const begin = performance.getEntriesByName('mount')[0]?.startTime ?? Infinity;
      for (const it of list.getEntries()) if (it.startTime >= begin - 5) globalThis.tasks.push(it.duration);
    }).observe({
      type: 'longtask',
      buffered: true,
    });
  });
  await page.goto(`http://127.0.0.1:${port}/?rows=${rows}&sets=${sets}${query}`);
  await page.waitForFunction(() => globalThis.plot?.drawn().length > 0, null, { timeout: 60_000, polling: 50 });
  return page;
}

try {
  const page = await open();
  print({
    what: 'setting',
    rows,
    sets,
    browser: browser.version(),
    gl: await page.evaluate(() => {
      const gl = document.createElement('canvas').getContext('webgl2');
      return gl && gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info')?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER);
    }),
  });
  await page.waitForTimeout(500);
  if (shots) await page.screenshot({ path: join(shots, 'plot.png') });
  print({ what: 'tasks of the start', longest: Math.round(Math.max(0, ...(await page.evaluate(() => globalThis.tasks.splice(0))))) });

  // A brush grows over an axis; each step waits until all lines are on the screen.
  for (const [what, axis, from, to] of [
    ['brushing few lines', 0, 0, 90],
    ['brushing most lines', 0, 300, 959],
    ['brushing all lines', 1, 530, 539],
  ]) {
    const times = await page.evaluate(
      async ([axis, from, to]) => {
        const times = [];
        for (let i = 0; i <= 12; i++) {
          const high = Math.round(from + ((to - from) * i) / 12);
          times.push(await plot.brush([{ axis, ranges: [[0, high]], categories: [], inverted: false }]));
        }
        return times;
      },
      [axis, from, to],
    );
    const tasks = await page.evaluate(() => globalThis.tasks.splice(0));
    const [most, longest] = [Math.max(...times), Math.max(0, ...tasks)];
    print({ what, median_ms: Math.round(median(times)), max_ms: Math.round(most), longest_task_ms: Math.round(longest) });
    if (most > Number(option('--limit', Infinity)) || longest > Number(option('--task', Infinity))) isBad = true;
  }

  // A drag by the mouse: frames of the page while it goes on.
  await page.evaluate(() => plot.brush([]));
  const box = await page.locator('.field').boundingBox();
  const spacing = (box.width - 110) / 19;
  const x = box.x + 58 + 2 * spacing;
  await page.evaluate(() => {
    globalThis.gaps = [];
    let last = performance.now();
    const tick = (now) => {
      globalThis.gaps?.push(now - last);
      last = now;
      if (globalThis.gaps) requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  });
  const before = await page.evaluate(() => plot.events());
  await page.mouse.move(x, box.y + 200);
  await page.mouse.down();
  for (let i = 0; i <= 40; i++) {
    await page.mouse.move(x, box.y + 200 - 2.5 * i);
    await page.waitForTimeout(16);
  }
  await page.mouse.up();
  const { gaps, tasks, events } = await page.evaluate(() => {
    const gaps = globalThis.gaps;
    globalThis.gaps = null;
    return { gaps, tasks: globalThis.tasks.splice(0), events: plot.events() };
  });
  print({
    what: 'drag by the mouse',
    frames: gaps.length,
    median_ms: Math.round(median(gaps)),
    max_ms: Math.round(Math.max(...gaps)),
    events: events - before,
    longest_task_ms: Math.round(Math.max(0, ...tasks)),
  });
  if (Math.max(0, ...tasks) > Number(option('--task', Infinity))) isBad = true;
  await page.waitForTimeout(600);
  if (shots) await page.screenshot({ path: join(shots, 'plot-brushed.png') });
} finally {
  await browser.close();
  await new Promise((done) => server.httpServer.close(done));
  rmSync(outDir, { recursive: true, force: true });
}
process.exit(isBad ? 1 : 0);
