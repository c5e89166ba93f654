/**
 * Times of a plot of 10,000 made-up paths over 20 axes in Chromium, as JSON lines:
 *
 *     CHROMIUM=/usr/bin/chromium node tests/e2e/plot-bench.mjs [--shots FOLDER] [--rows N] [--sets N] [--limit MS] [--task MS] [--check]
 *
 * With --check, the hands on the plot too: brushes, menus, keys, touch, order, other graphics, axe.
 *
 * Exits with 1 if a frame of brushing takes longer than --limit, or a task of the main thread longer than --task.
 */
import { mkdirSync, mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { svelte } from '@sveltejs/vite-plugin-svelte';
import axe from 'axe-core';
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
const claim = (holds, what) => {
  if (holds) return;
  isBad = true;
  console.error(`failed: ${what}`);
};
const same = (is, due, what) => claim(JSON.stringify(is) === JSON.stringify(due), `${what}: ${JSON.stringify(is)}, not ${JSON.stringify(due)}`);

async function open(more = {}, query = '', graphics = null) {
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
  // A browser with a graphics card, or without WebGL2.
  if (graphics)
    await page.addInitScript((graphics) => {
      // The page itself looks at the graphics.
      delete globalThis.Worker;
      const { getContext } = HTMLCanvasElement.prototype;
      if (graphics === 'none')
        HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
          return kind === 'webgl2' ? null : getContext.call(this, kind, ...more);
        };
      const { getParameter } = WebGL2RenderingContext.prototype;
      WebGL2RenderingContext.prototype.getParameter = function (name) {
        return name === 0x9246 ? 'a card' : getParameter.call(this, name);
      };
    }, graphics);
  await page.goto(`http://127.0.0.1:${port}/?${query}&rows=${rows}&sets=${sets}`);
  await page.waitForFunction(
    (isDrawn) => globalThis.plot && (!isDrawn || globalThis.plot.drawn().length > 0),
    graphics !== 'none',
    { timeout: 60_000, polling: 50 },
  );
  return page;
}

async function shoot(page, name) {
  if (shots) await page.screenshot({ path: join(shots, `${name}.png`) });
}

/** Checks that axe finds nothing. */
async function audit(page, what) {
  await page.evaluate(axe.source);
  const found = await page.evaluate(async () =>
    (await globalThis.axe.run(document, { rules: { 'page-has-heading-one': { enabled: false }, region: { enabled: false } } })).violations.map(
      (it) => `${it.id}: ${it.nodes.slice(0, 3).map((node) => `${node.target} ${node.failureSummary}`).join(' | ')}`,
    ),
  );
  same(found, [], `axe, ${what}`);
}

/** Uses the plot with the mouse, the keyboard and a finger. */
async function check() {
  const brushes = (page) => page.evaluate(() => plot.brushes());
  const order = (page) => page.evaluate(() => plot.views().map((it) => it.index));
  const column = (page, name) => page.getByRole('group', { name, exact: true });
  const title = (page, name) => page.getByRole('button', { name, exact: true });
  const menu = (page, name) => page.getByRole('dialog', { name: `Axis ${name}` });
  /** Middle of an axis: x, and the y of a height. */
  const place = async (page, name) => {
    const box = await column(page, name).locator('.strip').boundingBox();
    const head = await title(page, name).boundingBox();
    return { x: head.x + head.width / 2, y: (height) => box.y + 10 + (1 - height) * (box.height - 20) };
  };
  const drag = async (page, from, to) => {
    await page.mouse.move(...from);
    await page.mouse.down();
    for (let i = 1; i <= 6; i++) await page.mouse.move(from[0] + ((to[0] - from[0]) * i) / 6, from[1] + ((to[1] - from[1]) * i) / 6);
    await page.mouse.up();
  };

  let page = await open({}, '');
  let at = await place(page, 'pixel.x');
  await drag(page, [at.x, at.y(0.2)], [at.x, at.y(0.4)]);
  await drag(page, [at.x, at.y(0.6)], [at.x, at.y(0.8)]);
  let [brush] = await brushes(page);
  claim(brush?.ranges.length === 2 && Math.abs(brush.ranges[0][0] - 192) < 12, `two ranges: ${JSON.stringify(brush)}`);
  await drag(page, [at.x, at.y(0.3)], [at.x, at.y(0.35)]);
  const moved = (await brushes(page))[0];
  claim(moved.ranges[0][1] - moved.ranges[0][0] === brush.ranges[0][1] - brush.ranges[0][0], 'a moved range keeps its size');
  claim(Math.abs(moved.ranges[0][0] - brush.ranges[0][0] - 48) < 12, `a moved range: ${JSON.stringify(moved)}`);
  await drag(page, [at.x, at.y(0.8)], [at.x, at.y(0.9)]);
  const grown = (await brushes(page))[0];
  claim(Math.abs(grown.ranges[1][1] - 864) < 14 && grown.ranges[1][0] === brush.ranges[1][0], `a moved end: ${JSON.stringify(grown)}`);
  // Keys move ends.
  const end = page.getByRole('slider', { name: 'Upper end of range 2 of pixel.x' });
  await end.focus();
  await page.keyboard.press('ArrowUp');
  same((await brushes(page))[0].ranges[1][1], grown.ranges[1][1] + 1, 'an end moved by a key');
  claim((await end.getAttribute('aria-valuenow')) === String(grown.ranges[1][1] + 1), 'the value of the slider');
  await audit(page, 'with brushes');
  await page.mouse.dblclick(at.x, at.y(0.05));
  same(await brushes(page), [], 'a double click clears');

  // Categories, inversion.
  at = await place(page, 'end');
  await page.mouse.click(at.x - 20, at.y(0.9));
  brush = (await brushes(page))[0];
  same(brush?.categories.length, 1, 'a category by a click');
  await title(page, 'end').click();
  await menu(page, 'end').getByRole('button', { name: 'Invert' }).click();
  same((await brushes(page))[0].inverted, true, 'an inverted brush');
  await page.waitForTimeout(400);
  await shoot(page, 'plot-menu');
  await audit(page, 'with a menu');
  await menu(page, 'end').getByRole('checkbox').nth(1).click();
  same((await brushes(page))[0].categories.length, 2, 'two categories');
  await page.keyboard.press('Escape');
  await page.waitForTimeout(200);
  same(await page.evaluate(() => document.activeElement.getAttribute('aria-label')), 'end', 'the focus after a menu');
  await page.getByRole('button', { name: 'Clear brushes' }).click();
  same(await brushes(page), [], 'no brushes');

  // All by keys: a range, log, hide, show, order.
  await title(page, 'radiance.g').focus();
  await page.keyboard.press('Enter');
  await menu(page, 'radiance.g').getByLabel('Lower end of a new range').fill('1');
  await menu(page, 'radiance.g').getByLabel('Upper end of a new range').fill('100');
  await page.keyboard.press('Enter');
  same((await brushes(page))[0]?.ranges, [[1, 100]], 'a range by numbers');
  await shoot(page, 'plot-range');
  await page.evaluate(() =>
    plot.brush([
      { axis: 3, ranges: [[0, 0.1], [10, 1000]], categories: [], inverted: true },
      { axis: 8, ranges: [[2, 6]], categories: [], inverted: false },
    ]),
  );
  await shoot(page, 'plot-inverted');
  await menu(page, 'radiance.g').getByRole('button', { name: 'Logarithmic' }).click();
  same(await page.evaluate(() => plot.views()[3].log), false, 'a linear axis');
  await page.waitForTimeout(300);
  await menu(page, 'radiance.g').getByRole('button', { name: 'Hide' }).click();
  same(await page.evaluate(() => plot.views()[3].hidden), true, 'a hidden axis');
  await page.getByRole('button', { name: 'Hidden axes (1)' }).click();
  await page.getByRole('button', { name: 'Show radiance.g' }).click();
  same(await page.evaluate(() => plot.views()[3].hidden), false, 'a shown axis');
  await title(page, 'depth').focus();
  // Keys in quick succession, as events of one frame.
  await page.evaluate(() => {
    for (let i = 0; i < 2; i++)
      document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowLeft', altKey: true, bubbles: true, cancelable: true }));
  });
  same((await order(page)).slice(5, 10), [5, 8, 6, 7, 9], 'an axis moved by keys in one frame');
  same(await page.evaluate(() => document.activeElement.getAttribute('aria-label')), 'depth', 'the focus after the moves');
  await Promise.all([page.keyboard.press('Alt+ArrowRight'), page.keyboard.press('Alt+ArrowLeft'), page.keyboard.press('Alt+ArrowLeft')]);
  await page.waitForTimeout(60);
  same((await order(page)).slice(4, 9), [4, 8, 5, 6, 7], 'an axis moved by keys');
  await page.keyboard.press('Alt+ArrowRight');
  const from = await title(page, 'depth').boundingBox();
  const to = await title(page, 'pixel.y').boundingBox();
  await drag(page, [from.x + 20, from.y + 10], [to.x + 20, to.y + 10]);
  same((await order(page)).slice(0, 4), [0, 8, 1, 2], 'an axis moved by the mouse');
  claim((await page.getByRole('dialog').count()) === 0, 'a drag opens no menu');
  await page.evaluate(() => plot.brush([]));
  at = await place(page, 'first.x');
  await page.mouse.move(at.x + 30, at.y(0.5));
  await page.waitForTimeout(400);
  claim((await page.locator('.chip').count()) === 20, 'values of the nearest line');
  await shoot(page, 'plot-line');
  await page.mouse.move(at.x + 3, at.y(0.5));
  await page.waitForTimeout(200);
  claim(await page.locator('.tip').isVisible(), 'a tip over an axis');
  await shoot(page, 'plot-tip');
  await page.context().close();

  // A finger on a small dark screen.
  page = await open({ viewport: { width: 390, height: 700 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2, colorScheme: 'dark' }, '&theme=dark&sets=2');
  const touch = await page.context().newCDPSession(page);
  const finger = async (...points) => {
    const send = (type, list) => touch.send('Input.dispatchTouchEvent', { type, touchPoints: list.map(([x, y]) => ({ x, y })) });
    await send('touchStart', [points[0]]);
    const [a, b] = [points[0], points.at(-1)];
    for (let i = 1; i <= 8; i++) await send('touchMove', [[a[0] + ((b[0] - a[0]) * i) / 8, a[1] + ((b[1] - a[1]) * i) / 8]]);
    await send('touchEnd', []);
    await page.waitForTimeout(100);
  };
  at = await place(page, 'pixel.y');
  await finger([at.x, at.y(0.3)], [at.x, at.y(0.7)]);
  brush = (await brushes(page))[0];
  claim(Math.abs(brush?.ranges[0]?.[1] - 378) < 12, `a range by a finger: ${JSON.stringify(brush)}`);
  const knob = await page.getByRole('slider', { name: 'Upper end of range 1 of pixel.y' }).boundingBox();
  claim(knob.width >= 44 && knob.height >= 44, 'ends have 44 pixels for fingers');
  await finger([knob.x + 22, knob.y + 8], [knob.x + 22, knob.y - 30]);
  claim((await brushes(page))[0].ranges[0][1] > brush.ranges[0][1] + 20, 'an end by a finger');
  const spacing = (await place(page, 'radiance.r')).x - at.x;
  claim(spacing >= 64, 'axes are 64 pixels apart');
  await finger([at.x + 180, at.y(0.5)], [at.x, at.y(0.5)]);
  await page.waitForTimeout(300);
  claim((await page.locator('.scroll').evaluate((it) => it.scrollLeft)) > 50, 'a finger scrolls the axes');
  await page.waitForTimeout(500);
  await shoot(page, 'plot-phone');
  await audit(page, 'dark');
  await page.context().close();

  page = await open({}, '&sets=2');
  await shoot(page, 'plot-two');
  await page.evaluate(() => plot.brush([{ axis: 9, ranges: [], categories: [4], inverted: false }]));
  await shoot(page, 'plot-two-brushed');
  await page.context().close();
  page = await open({ colorScheme: 'dark' }, '&sets=2&theme=dark&opacity=0.02');
  await page.evaluate(() => plot.brush([{ axis: 9, ranges: [], categories: [4], inverted: false }]));
  await page.waitForTimeout(300);
  await shoot(page, 'plot-two-dark');
  await page.context().close();

  // The shaders, and a lost context.
  page = await open({}, '&sets=2', 'card');
  await page.waitForTimeout(300);
  await shoot(page, 'plot-card-two');
  await page.context().close();
  page = await open({ colorScheme: 'dark' }, '&theme=dark&opacity=0.03', 'card');
  await shoot(page, 'plot-card-dark');
  await page.context().close();
  page = await open({}, '&rows=3000', 'card');
  await page.evaluate(() => plot.brush([{ axis: 1, ranges: [[0, 200]], categories: [], inverted: false }]));
  await shoot(page, 'plot-card');
  await page.evaluate(async () => {
    const lose = document.querySelector('.field canvas').getContext('webgl2').getExtension('WEBGL_lose_context');
    lose.loseContext();
    await new Promise((done) => setTimeout(done, 300));
    lose.restoreContext();
    await new Promise((done) => setTimeout(done, 1500));
  });
  await shoot(page, 'plot-card-restored');
  await page.context().close();

  page = await open({}, '', 'none');
  await page.getByText('This browser has no WebGL2').waitFor();
  await page.waitForTimeout(300);
  await shoot(page, 'plot-none');
  await page.context().close();
  print({ what: 'checks', ok: !isBad });
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
  await page.context().close();
  if (args.includes('--check')) await check();
} finally {
  await browser.close();
  await new Promise((done) => server.httpServer.close(done));
  rmSync(outDir, { recursive: true, force: true });
}
process.exit(isBad ? 1 : 0);
