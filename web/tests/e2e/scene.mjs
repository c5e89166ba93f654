/** The scene view of recorded light: over `femc view` without geometry, and over a farm with geometry. */
import { copyFileSync, mkdirSync, readdirSync } from 'node:fs';
import { join } from 'node:path';
import { chromium } from 'playwright-core';
import { Farm, pause, root, until } from './farm.mjs';
import { triangles, valueAlong } from './elements.mjs';
import { boxesAsGlb } from './glb.mjs';
import { view } from './light.mjs';

/** A browser that draws with WebGL2, in software. */
const GRAPHICS = ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const FLAGS = ['--no-sandbox', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'];
const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };
/** The camera of scenes/gallery.mgf. */
const CAMERA = { at: [0, -4.2, 1.7], target: [0, 0.4, 0.95], fov: (52 * Math.PI) / 180 };

/** Decodes `application/vnd.femc.columns`. */
function columns(bytes) {
  const length = bytes.readUInt32LE(8);
  const header = JSON.parse(bytes.toString('utf8', 12, 12 + length));
  const Types = { u8: Uint8Array, u32: Uint32Array, f32: Float32Array, f64: Float64Array };
  const of = Object.fromEntries(header.columns.map(({ name, type, length: n, offset }) => {
    const begin = bytes.byteOffset + 12 + length + offset;
    return [name, new Types[type](bytes.buffer.slice(begin, begin + n * Types[type].BYTES_PER_ELEMENT))];
  }));
  return { header, of };
}

class Scene {
  constructor(page, api, frames) {
    Object.assign(this, { page, api, frames });
  }
  get section() {
    return this.page.getByRole('region', { name: 'Scene', exact: true });
  }
  get canvas() {
    return this.section.locator('canvas');
  }
  get keys() {
    return this.page.getByRole('application', { name: 'Scene in three dimensions' });
  }
  query(key) {
    return new URL(this.page.url()).searchParams.get(key);
  }
  get where() {
    return this.query('where') ?? '';
  }
  eye() {
    return this.section.getAttribute('data-eye');
  }
  /** Waits until the eye differs, and the address has it. */
  async moved(before, what) {
    await until(async () => (await this.eye()) !== before, `${what}: the view moves`, 5);
    await until(async () => this.query('eye') === (await this.eye()), `${what}: the address has the view`, 5);
    return this.eye();
  }
  async ask(call, values = {}) {
    const query = new URLSearchParams({ ...(this.frames ? { frames: this.frames } : {}), ...values });
    const answer = await this.page.request.get(`${this.api}/${call}?${query}`);
    if (!answer.ok()) throw new Error(`${call} ${query}: ${answer.status()}`);
    return call === 'schema' ? answer.json() : columns(await answer.body());
  }
  async ready() {
    await this.page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
  }
  async middle(dx = 0, dy = 0) {
    await this.canvas.scrollIntoViewIfNeeded();
    const box = await this.canvas.boundingBox();
    return [box.x + box.width / 2 + dx, box.y + box.height / 2 + dy];
  }
  async drag(dx, dy, { shift = false } = {}) {
    const [x, y] = await this.middle(-0.3 * 200, -60);
    if (shift) await this.page.keyboard.down('Shift');
    await this.page.mouse.move(x, y);
    await this.page.mouse.down();
    await this.page.mouse.move(x + dx, y + dy, { steps: 5 });
    await this.page.mouse.up();
    if (shift) await this.page.keyboard.up('Shift');
  }
  layer(name) {
    return this.section.getByRole('group', { name: 'Layers' }).getByLabel(name, { exact: true });
  }
  /** Picture of the canvas, while nothing moves. */
  async picture() {
    await pause(600);
    return (await this.canvas.screenshot()).toString('base64');
  }
  async stop() {
    const button = this.section.getByRole('button', { name: 'Pause', exact: true });
    if (await button.count()) await button.click();
  }
  async clear() {
    if (!this.where) return;
    await this.page.locator('[aria-label=Selection]').getByRole('button', { name: 'Clear', exact: true }).click();
    await until(() => !this.where, 'the selection is cleared', 5);
  }
  /** Place on the canvas of a point that the camera of the render sees; null: beside the canvas. */
  async seen([x, y, z]) {
    const { width, height } = await this.canvas.boundingBox();
    const sub = (a, b) => a.map((v, i) => v - b[i]);
    const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
    const unit = (a) => a.map((v) => v / Math.hypot(...a));
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const ahead = unit(sub(CAMERA.target, CAMERA.at));
    const right = unit(cross(ahead, [0, 0, 1]));
    const up = cross(right, ahead);
    const d = sub([x, y, z], CAMERA.at);
    const film = 64 / 48;
    const t = Math.tan(CAMERA.fov / 2) * Math.max(1, film / (width / height));
    const [u, v] = [dot(d, right) / dot(d, ahead) / t, dot(d, up) / dot(d, ahead) / t];
    return [width / 2 + (u * height) / 2, height / 2 - (v * height) / 2];
  }
}

export async function scene({ step, open, claim, equal, accessible, current, shotsAt }) {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: [...FLAGS, ...GRAPHICS],
  });
  const farm = await Farm.start();
  const targets = {};
  let [job, server, begun, hasGeometry] = [0, null, null, false];
  const begin = () => (begun ??= prepare());
  async function prepare() {
    await farm.coordinator();
    farm.worker('scene-a');
    job = farm.submit('gallery.mgf', '--size', '64x48', '--spp', '64', '--stats');
    await until(() => farm.job(job).state === 'done', 'the job is done', 180);
    farm.femc('fetch', String(job), '-o', 'fetched');
    const name = readdirSync(join(farm.folder, 'fetched')).find((it) => it.endsWith('.paths'));
    copyFileSync(join(farm.folder, 'fetched', name), join(farm.folder, 'gallery.paths'));
    server = await view(farm, 'gallery.paths');
  }
  /** Geometry of the farm; boxes in its place if the farm makes none. */
  async function withGeometry(page, api, frames) {
    const it = new Scene(page, api, frames);
    await page.route('**/geometry?*', async (route) => {
      const answer = await route.fetch().catch(() => null);
      hasGeometry = answer?.status() === 200;
      if (hasGeometry) return route.fulfill({ response: answer });
      const { names } = await it.ask('schema');
      const { of } = await it.ask('paths', { count: 5000 });
      return route.fulfill({ contentType: 'model/gltf-binary', body: boxesAsGlb(names, of, CAMERA) });
    });
    return it;
  }
  const openings = {
    async view(options = {}) {
      const page = current(await open({ url: server.url }, { by: browser, ...options }));
      const address = server.address;
      await page.goto(address);
      await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
      return new Scene(page, '/api/v1/files/0/light', '');
    },
    async farm(options = {}) {
      const page = current(await open(farm, { by: browser, ...options }));
      const it = await withGeometry(page, `/api/v1/jobs/${job}/light`, '1');
      await page.goto(`/jobs/${job}/light`);
      await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
      return it;
    },
  };
  const home = (where) => (where === 'view' ? '/view' : `/jobs/${job}/light`);

  for (const where of ['view', 'farm']) {
    await step(`scene: ${where}: the button opens it, and its library is loaded only then`, async () => {
      await begin();
      const it = (targets[where] = await openings[where]());
      const { page } = it;
      const loaded = [];
      page.on('request', (request) => /SceneView/.test(request.url()) && loaded.push(request.url()));
      await page.reload();
      await page.locator('[data-totals]').waitFor();
      equal(loaded.length, 0, 'requests for the scene view before it is opened');
      await page.getByRole('button', { name: 'Scene', exact: true }).click();
      await it.ready();
      claim(loaded.some((url) => url.endsWith('.js')), 'the library is loaded');
      equal(it.query('scene'), 'open', 'the address');
      const note = page.locator('[data-geometry]');
      equal(await note.getAttribute('data-geometry'), where === 'view' ? 'none' : 'shown', 'geometry');
      if (where === 'view') claim(/no geometry of the scene/.test(await note.innerText()), 'the page says that there is no geometry');
      claim(Number(await it.canvas.getAttribute('data-frames')) > 0, 'frames are drawn');
      const { recorded, counts } = await it.ask('schema');
      const shown = Number((await page.locator('[data-points]').innerText()).replace(/\D/g, ''));
      claim(shown > 0 && shown <= counts.intersections, `${shown} intersections of ${recorded} paths`);
      console.log(`        first picture after ${await it.section.getAttribute('data-first-picture')} ms`);
    });
    const on = (name, run) => step(`scene: ${where}: ${name}`, async () => {
      await begin();
      const it = (targets[where] ??= await openings[where]());
      current(it.page);
      await it.page.goto(`${home(where)}?scene=open`);
      await it.ready();
      await run(it, it.page);
    });

    await on('turned and moved by mouse and keys, reset', async (it, page) => {
      const first = await it.eye();
      await it.drag(80, 20);
      const turned = await it.moved(first, 'a drag');
      await it.drag(40, 30, { shift: true });
      const shifted = await it.moved(turned, 'a drag with Shift');
      claim(shifted.split(',').slice(4).join() === turned.split(',').slice(4).join(), 'Shift moves and does not turn');
      await page.mouse.move(...(await it.middle()));
      await page.mouse.wheel(0, -100);
      const near = await it.moved(shifted, 'the wheel');
      claim(Number(near.split(',')[3]) < Number(shifted.split(',')[3]), 'the wheel brings the eye nearer');
      equal(it.where, '', 'drags select nothing');
      await it.keys.focus();
      let last = near;
      for (const key of ['ArrowLeft', 'ArrowUp', 'Shift+ArrowRight', '+', '-']) {
        await page.keyboard.press(key);
        last = await it.moved(last, key);
      }
      await page.keyboard.press('Home');
      await until(async () => (await it.eye()) === first, 'Home resets the view', 5);
      await until(() => it.query('eye') === null, 'the address has no view', 5);
      if (where === 'farm') {
        await page.keyboard.press('ArrowLeft');
        await it.moved(first, 'a key');
        await page.keyboard.press('c');
        await until(async () => (await it.eye()) === first, 'c goes to the camera of the render', 5);
      } else claim(await page.getByRole('button', { name: 'Camera', exact: true }).isDisabled(), 'no camera without geometry');
    });

    await on('bookmarks stay in the address', async (it, page) => {
      await it.drag(100, 10);
      await until(() => it.query('eye'), 'the address has the view', 5);
      const marked = await it.eye();
      await page.getByRole('button', { name: 'Bookmark', exact: true }).click();
      await page.getByRole('button', { name: 'Whole scene' }).click();
      await it.moved(marked, 'the whole scene');
      await page.reload();
      await it.ready();
      await page.getByRole('button', { name: 'View 1', exact: true }).click();
      await until(async () => (await it.eye()) === marked, 'the bookmark', 5);
      await page.getByRole('button', { name: 'Remove view 1' }).click();
      await until(() => it.query('eyes') === null, 'the bookmark is removed', 5);
    });

    await on('a section, colors by bounce, and layers', async (it, page) => {
      await it.layer('moving paths').uncheck();
      const whole = await it.picture();
      await page.getByLabel('Section across').selectOption('y');
      await page.getByLabel('Position of the section, m').focus();
      for (let i = 0; i < 4; i++) await page.keyboard.press('ArrowRight');
      await until(() => /^y>/.test(it.query('cut') ?? ''), 'the address has the section', 5);
      const open = await it.picture();
      claim(open !== whole, 'the section opens the scene');
      await page.getByRole('button', { name: 'Other side' }).click();
      await until(() => /^y</.test(it.query('cut') ?? ''), 'the other side', 5);
      claim((await it.picture()) !== open, 'the other side looks different');
      await page.getByLabel('Section across').selectOption('');
      await until(() => it.query('cut') === null, 'no section', 5);
      await page.getByLabel('Color of intersections and paths').selectOption('bounce');
      await it.section.getByRole('img', { name: /^Legend: .* bounce$/ }).waitFor();
      claim((await it.picture()) !== whole, 'other colors');
      await it.layer('intersections').uncheck();
      await until(async () => (await page.locator('[data-points]').count()) === 0, 'no intersections', 5);
      await it.layer('light records').check();
      await page.locator('[data-rays]').waitFor();
      const rays = await page.locator('[data-rays]').innerText();
      claim(/^[\d,]+ rays of [\d,]+ light records, [\d,]+ hidden/.test(rays) && !/^0 rays/.test(rays), rays);
    });

    await on('paths move, stop, and follow the scrubber', async (it, page) => {
      const time = () => it.section.getByLabel('Length that the light has traveled').inputValue().then(Number);
      const before = await time();
      await until(async () => (await time()) !== before, 'the paths move', 5);
      await it.stop();
      const [stopped, frames] = [await time(), await it.canvas.getAttribute('data-frames')];
      await pause(700);
      equal(await time(), stopped, 'time while it stands');
      claim(Number(await it.canvas.getAttribute('data-frames')) <= Number(frames) + 1, 'a still view draws nothing');
      const still = await it.picture();
      await it.section.getByLabel('Length that the light has traveled').focus();
      for (let i = 0; i < 40; i++) await page.keyboard.press('ArrowRight');
      claim((await time()) > stopped, 'the scrubber moves by keys');
      claim((await it.picture()) !== still, 'the segments follow');
      await it.keys.focus();
      await page.keyboard.press('Space');
      const later = await time();
      await until(async () => (await time()) !== later, 'space plays', 5);
      await it.section.getByLabel('Speed').selectOption('4');
      await it.section.getByLabel('Direction').selectOption('camera');
      await until(() => it.query('from') === 'camera', 'the direction is in the address', 5);
      await it.section.getByLabel('Largest number of moving paths and light records').selectOption('500');
      await page.getByText(/^500 of [\d,]+ paths move$/).waitFor();
      const [n, began] = [Number(await it.canvas.getAttribute('data-frames')), Date.now()];
      await pause(4000);
      const rate = (1000 * (Number(await it.canvas.getAttribute('data-frames')) - n)) / (Date.now() - began);
      console.log(`        ${rate.toFixed(1)} frames a second with 500 moving paths`);
    });

    await on('picks of the four modes by keys write the selection', async (it, page) => {
      const list = it.section.getByRole('region', { name: 'Objects of the scene' });
      const object = (name) => list.getByRole('button', { name, exact: true });
      const press = async (name, key = 'Enter') => {
        await object(name).focus();
        await page.keyboard.press(key);
      };
      const expect = async (text) => {
        await until(() => it.where === text, `${text}, not ${it.where}`, 5);
        const { header } = await it.ask('selection', { where: text });
        const counts = page.locator('[aria-label=Selection] [data-count=paths]').first();
        await until(async () => Number((await counts.innerText().catch(() => '-1')).replace(/\D/g, '')) === header.counts.paths, `${text}: ${header.counts.paths} paths`, 10);
      };
      await press('sphere');
      await expect('object == sphere');
      await press('vase');
      await expect('object == vase');
      await list.getByLabel('interaction').check();
      await press('sphere', 'Shift+Enter');
      await expect('object == vase and any(object == sphere)');
      await it.clear();
      await list.getByLabel('shadow').check();
      await press('pedestals');
      await expect('light(occluder == pedestals)');
      await it.clear();
      await list.getByLabel('A, then B').check();
      await press('sphere');
      await list.getByText(/From sphere: pick the next object/).waitFor();
      equal(it.where, '', 'one object is no order');
      await list.getByRole('button', { name: 'Cancel' }).click();
      await press('vase');
      await press('room');
      await expect('vase then room');
      await it.clear();
    });

    await on('a click and a tip name the object', async (it, page) => {
      await it.stop();
      const { names } = await it.ask('schema');
      const { of } = await it.ask('paths', { count: 5000 });
      // Without geometry, the eye of the address looks through the camera of the render, too.
      if (where === 'view') {
        const d = CAMERA.at.map((v, i) => v - CAMERA.target[i]);
        const eye = [...CAMERA.target, Math.hypot(...d), Math.atan2(d[1], d[0]), Math.asin(d[2] / Math.hypot(...d)), CAMERA.fov];
        await page.goto(`${home(where)}?scene=open&layers=points&eye=${eye.join(',')}`);
        await it.ready();
      }
      await it.canvas.scrollIntoViewIfNeeded();
      const box = await it.canvas.boundingBox();
      let [right, all] = [0, 0];
      const rows = of['paths.first.object'].length;
      for (let k = 0; all < 50 && k < 400; k++) {
        const row = (k * 7919 + 13) % rows;
        const name = names[of['paths.first.object'][row] - 1];
        if (!name) continue;
        const [x, y] = await it.seen(['x', 'y', 'z'].map((axis) => of[`paths.first.${axis}`][row]));
        if (x < 2 || y < 2 || x > box.width - 2 || y > box.height - 2) continue;
        all++;
        await page.mouse.move(box.x + x, box.y + y);
        right += (await until(async () => (await page.locator('[data-tip]').textContent({ timeout: 300 }).catch(() => null)) === name, '', 0.8).catch(() => false)) ? 1 : 0;
      }
      console.log(`        ${right} of ${all} first hits are named rightly (${where === 'view' ? 'intersections alone' : hasGeometry ? 'geometry' : 'boxes'})`);
      claim(all >= 40, `${all} first hits are on the canvas`);
      claim(right >= (where === 'farm' && hasGeometry ? 0.96 : 0.7) * all, `${right} of ${all} first hits are named rightly`);
      // A point in the middle of an object, not at its silhouette.
      const hits = (name) => [...of['paths.first.object'].keys()].filter((row) => names[of['paths.first.object'][row] - 1] === name);
      const click = async (name) => {
        const all = await Promise.all(hits(name).map((row) => it.seen(['x', 'y', 'z'].map((axis) => of[`paths.first.${axis}`][row]))));
        const mean = [0, 1].map((k) => all.reduce((sum, at) => sum + at[k], 0) / all.length);
        const [x, y] = all.sort((p, q) => Math.hypot(p[0] - mean[0], p[1] - mean[1]) - Math.hypot(q[0] - mean[0], q[1] - mean[1]))[0];
        await page.mouse.click(box.x + x, box.y + y);
      };
      const list = it.section.getByRole('region', { name: 'Objects of the scene' });
      const selects = async (text) => {
        await until(() => it.where === text, `a click selects ${text}, not ${it.where}`, 5);
        await it.clear();
        await it.canvas.scrollIntoViewIfNeeded();
        Object.assign(box, await it.canvas.boundingBox());
      };
      await click('sphere');
      await selects('object == sphere');
      for (const [mode, name, text] of [['interaction', 'sphere', 'any(object == sphere)'], ['shadow', 'vase', 'light(occluder == vase)']]) {
        await list.getByLabel(mode).check();
        Object.assign(box, await it.canvas.boundingBox());
        await click(name);
        await selects(text);
      }
      await list.getByLabel('A, then B').check();
      await click('sphere');
      await list.getByText(/From sphere: pick the next object/).waitFor();
      await click('vase');
      await selects('sphere then vase');
    });

    await on('voxels with a threshold, by bounce', async (it, page) => {
      await it.layer('voxels').check();
      const text = () => page.locator('[data-voxels]').innerText();
      const all = (await it.ask('voxels', { level: 5 })).of['voxels.index'].length;
      await until(async () => (await text()).endsWith(`of ${all.toLocaleString('en-US')} voxels`), `${all} voxels`, 10);
      const shown = async () => Number((await text()).split(' of ')[0].replace(/\D/g, ''));
      const half = await shown();
      claim(half > 0 && half < all, `${half} of ${all} voxels are above the threshold`);
      await page.getByLabel('Threshold of voxels').focus();
      for (let i = 0; i < 20; i++) await page.keyboard.press('ArrowRight');
      await until(async () => (await shown()) < half, 'fewer voxels above a higher threshold', 5);
      await page.getByLabel('Bounce of voxels').selectOption('1');
      const one = (await it.ask('voxels', { level: 5, bounce: 1 })).of['voxels.index'].length;
      await until(async () => (await text()).endsWith(`of ${one.toLocaleString('en-US')} voxels`), `${one} voxels of bounce 1`, 10);
    });

    await on('a box is a term of the selection: numbers and handles', async (it, page) => {
      await it.stop();
      await page.getByRole('button', { name: 'Whole scene' }).click();
      await page.getByRole('button', { name: 'Add a box' }).click();
      await until(() => /^any\(in box\(/.test(it.where), 'a term', 5);
      const numbers = () => it.where.match(/box\((.*?)\)/)[1].split(',').map(Number);
      const before = numbers();
      // The box is added in the middle of the view: its middle handle is there.
      const [x, y] = await it.middle();
      const eye = await it.eye();
      await page.mouse.move(x, y);
      await page.mouse.down();
      await page.mouse.move(x + 30, y + 5, { steps: 4 });
      await page.mouse.up();
      await until(() => JSON.stringify(numbers()) !== JSON.stringify(before), 'a drag of the middle moves the box', 5);
      const moved = numbers();
      for (let k = 0; k < 3; k++) claim(Math.abs(moved[k + 3] - moved[k] - (before[k + 3] - before[k])) < 0.02, `the size stays: ${moved}`);
      equal(await it.eye(), eye, 'the view while the box is dragged');
      const field = page.getByLabel('Box in the scene, upper z');
      await field.fill(String(moved[2] + 1));
      await field.press('Enter');
      await until(() => Math.abs(numbers()[5] - moved[2] - 1) < 0.002, 'a number moves a face', 5);
      const { header } = await it.ask('selection', { where: it.where });
      claim(header.counts.paths >= 0, 'the server understands the box');
      await page.getByRole('button', { name: 'Remove the box' }).click();
      await until(() => it.where === '', 'the box is removed', 5);
    });

    for (const theme of ['light', 'dark']) {
      await step(`scene: ${where}: axe in ${theme}, with all layers`, async () => {
        await begin();
        const it = await openings[where]({ colorScheme: theme });
        const { page } = it;
        await page.goto(`${home(where)}?scene=open&layers=surfaces,points,paths,lights,voxels&cut=y>-1&eyes=0,0,1,9,-1,0.4,0.7&where=any(in box(-1,-1,0,1,1,1))`);
        await it.ready();
        await accessible(`the scene view in ${theme}`, page);
        if (shotsAt) {
          await page.setViewportSize({ width: 1360, height: 1000 });
          await it.section.scrollIntoViewIfNeeded();
          await pause(1500);
          mkdirSync(shotsAt, { recursive: true });
          await it.section.screenshot({ path: join(shotsAt, `scene-${where}-${theme}.png`) });
        }
        await page.context().close();
      });
    }
    await step(`scene: ${where}: a small screen, turned and pinched by fingers`, async () => {
      await begin();
      const it = await openings[where]({ ...PHONE });
      const { page } = it;
      await page.goto(`${home(where)}?scene=open`);
      await it.ready();
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      claim(wide <= 0, `${wide} pixels too wide`);
      await it.stop();
      const [x, y] = await it.middle();
      const session = await page.context().newCDPSession(page);
      const send = (type, points) =>
        session.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
      const first = await it.eye();
      await send('touchStart', [[x, y]]);
      for (let i = 1; i <= 5; i++) await send('touchMove', [[x + 12 * i, y]]);
      await send('touchEnd', []);
      const turned = await it.moved(first, 'one finger');
      await send('touchStart', [[x - 30, y], [x + 30, y]]);
      for (let i = 1; i <= 5; i++) await send('touchMove', [[x - 30 - 8 * i, y], [x + 30 + 8 * i, y]]);
      await send('touchEnd', []);
      const near = await it.moved(turned, 'two fingers');
      claim(Number(near.split(',')[3]) < Number(turned.split(',')[3]), 'fingers that part bring the eye nearer');
      await it.canvas.scrollIntoViewIfNeeded();
      await page.touchscreen.tap(...(await it.middle()));
      await until(() => /^object == \w+$/.test(it.where), 'a tap in the scene picks', 5);
      const button = it.section.getByRole('button', { name: 'sphere', exact: true });
      await button.scrollIntoViewIfNeeded();
      await button.tap();
      await until(() => it.where === 'object == sphere', 'a tap picks', 5);
      await accessible('the scene view at 390 pixels', page);
      if (shotsAt) await it.section.screenshot({ path: join(shotsAt, `scene-${where}-small.png`) });
      await page.context().close();
    });
  }
  await step('scene: nothing moves by itself with reduced motion', async () => {
    await begin();
    const it = await openings.view({ reducedMotion: 'reduce' });
    const { page } = it;
    await page.goto(`${home('view')}?scene=open`);
    await it.ready();
    await it.section.getByRole('button', { name: 'Play', exact: true }).waitFor();
    await pause(500);
    const frames = await it.canvas.getAttribute('data-frames');
    await pause(1000);
    equal(await it.canvas.getAttribute('data-frames'), frames, 'frames while nothing moves');
    await it.section.getByRole('button', { name: 'Play', exact: true }).click();
    await until(async () => (await it.canvas.getAttribute('data-frames')) !== frames, 'it plays on demand', 5);
    await page.context().close();
  });

  await step('scene: two data sets, one by one and together, and the difference of their voxels', async () => {
    await begin();
    farm.femc('render', join(root, 'scenes', 'gallery.mgf'), '-o', 'dim.exr', '--size', '64x48', '--spp', '64', '--stats', '--set', 'material.lamp.ed=2000');
    const both = await view(farm, 'gallery.paths', 'dim.paths');
    try {
      const page = current(await open({ url: both.url }, { by: browser }));
      await page.goto(both.address);
      await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
      await page.getByRole('button', { name: 'Scene', exact: true }).click();
      const it = new Scene(page, '/api/v1/files/0/light', '');
      await it.ready();
      const sets = it.section.getByRole('group', { name: 'Data set of the scene' });
      const shown = async () => Number((await page.locator('[data-points]').innerText()).replace(/\D/g, ''));
      const a = await shown();
      await sets.getByRole('button', { name: 'B', exact: true }).click();
      await until(async () => (await shown()) !== a, 'the intersections of B', 10);
      const b = await shown();
      await sets.getByRole('button', { name: 'both', exact: true }).click();
      await until(async () => (await shown()) === a + b, `${a} and ${b} intersections`, 10);
      await it.section.getByText('A red, B blue').waitFor();
      await it.layer('voxels').check();
      await page.getByLabel('Voxels of').selectOption('difference');
      await it.section.getByText('voxels, A minus B').waitFor();
      await until(async () => /^[1-9][\d,]* of/.test(await page.locator('[data-voxels]').innerText()), 'voxels of the difference', 10);
      await accessible('two data sets in the scene', page);
      if (shotsAt) await it.section.screenshot({ path: join(shotsAt, 'scene-both.png') });
      await page.context().close();
    } finally {
      await farm.kill(both.child);
    }
  });

  await step('scene: the finite-element solution, and its value under the pointer', async () => {
    await begin();
    const solved = farm.submit('cornell.mgf', '--size', '64x64', '--spp', '4', '--stats', '--method', 'fem');
    await until(() => farm.job(solved).state === 'done', 'the job of finite elements is done', 240);
    const page = current(await open(farm, { by: browser }));
    await page.goto(`/jobs/${solved}/light?eye=0,-7.6,1.95,0,0,1.95,32&layers=surfaces`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await page.getByRole('button', { name: 'Scene', exact: true }).click();
    const it = new Scene(page, `/api/v1/jobs/${solved}/light`, '1');
    await it.ready();
    const shaded = await it.picture();
    const menu = it.section.getByLabel('Light on surfaces', { exact: true });
    for (const kind of ['colors', 'luminance', 'indirect', 'illuminance']) {
      await menu.selectOption(kind);
      await page.locator('[data-solution=shown]').waitFor({ timeout: 30_000 });
      claim((await it.picture()) !== shaded, `${kind}: the picture differs from the shading`);
      if (shotsAt) await it.section.screenshot({ path: join(shotsAt, `scene-elements-${kind}.png`) });
    }
    equal(it.query('elements'), 'illuminance', 'the address');
    const answer = await page.request.get(`/api/v1/jobs/${solved}/solution`);
    const all = triangles(await answer.body(), '_ILLUMINANCE');
    const box = await it.canvas.boundingBox();
    await it.canvas.scrollIntoViewIfNeeded();
    let read = 0;
    for (const [dx, dy] of [[0, 0.3], [0.1, 0.28], [-0.15, -0.05], [0.05, -0.1], [-0.08, 0.12]]) {
      const [left, top] = await it.middle(dx * box.height, dy * box.height);
      await page.mouse.move(left, top);
      // A ray of the camera, which looks along y with an angle of 32 degrees over the height.
      const tangent = 2 * Math.tan((16 * Math.PI) / 180);
      const value = valueAlong(all, [0, -7.6, 1.95], [dx * tangent, 1, -dy * tangent]);
      claim(value !== null && value > 0, `the ray at ${dx}, ${dy} meets an element`);
      const tip = page.locator('[data-tip]');
      await until(async () => {
        const text = (await tip.count()) ? await tip.innerText() : '';
        const shown = Number(/([\d.,]+) lx$/.exec(text)?.[1]?.replace(/,/g, ''));
        return Math.abs(shown / value - 1) < 0.05;
      }, `${value} lx under the pointer at ${dx}, ${dy}`, 10);
      read++;
    }
    equal(read, 5, 'values');
    await it.drag(40, 10);
    await menu.focus();
    await page.keyboard.press('Home');
    await until(() => it.query('elements') === null, 'the keyboard chooses the shading', 5);
    await menu.selectOption('colors');
    await accessible('the finite-element solution', page);
    await page.goto(`/jobs/${job}/light?elements=colors`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await page.getByRole('button', { name: 'Scene', exact: true }).click();
    await page.getByText('The job has no finite-element solution').waitFor({ timeout: 30_000 });
    await page.context().close();
  });

  await step('scene: the openings that guide paths, as outlines and in a list', async () => {
    await begin();
    const guided = farm.submit('door-ajar.mgf', '--size', '64x48', '--spp', '2', '--stats', '--method', 'femc');
    await until(() => farm.job(guided).state === 'done', 'the job of two passes is done', 240);
    const page = current(await open(farm, { by: browser }));
    await page.goto(`/jobs/${guided}/light?layers=surfaces`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await page.getByRole('button', { name: 'Scene', exact: true }).click();
    const it = new Scene(page, `/api/v1/jobs/${guided}/light`, '1');
    await it.ready();
    const without = await it.picture();
    const box = it.section.getByLabel('openings and patches', { exact: true });
    await box.check();
    const list = page.locator('[data-targets=shown]');
    await list.waitFor({ timeout: 30_000 });
    await until(async () => (await it.picture()) !== without, 'the openings are drawn', 10);
    equal(it.query('layers'), 'surfaces,targets', 'the address');
    const answer = await (await page.request.get(`/api/v1/jobs/${guided}/targets`)).json();
    const rows = await list.locator('tbody tr').allInnerTexts();
    equal(rows.length, answer.targets.length, 'rows');
    // The gap of the door is 5 cm wide, and 2 m high.
    const gap = rows.filter((row) => /^opening\s+0\.0\d+ m x [12](\.\d)? m/.test(row));
    claim(gap.length > 0, `the gap of the door is an opening: ${rows.join('; ')}`);
    if (shotsAt) await it.section.screenshot({ path: join(shotsAt, 'scene-openings.png') });
    await accessible('openings and patches', page);
    await box.uncheck();
    await until(async () => (await it.picture()) === without, 'the openings are hidden', 10);
    await page.goto(`/jobs/${job}/light?layers=targets`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await page.getByRole('button', { name: 'Scene', exact: true }).click();
    await page.getByText('The job has no targets').waitFor({ timeout: 30_000 });
    await page.context().close();
  });

  await step('scene: a browser without WebGL2 says so, and its list of objects works', async () => {
    await begin();
    const page = current(await open({ url: server.url }, { by: browser }));
    await page.addInitScript(() => {
      delete globalThis.Worker;
      for (const canvas of [HTMLCanvasElement, OffscreenCanvas]) {
        const { getContext } = canvas.prototype;
        canvas.prototype.getContext = function (name, ...more) {
          return name === 'webgl2' ? null : getContext.call(this, name, ...more);
        };
      }
    });
    await page.goto(server.address);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await page.getByRole('button', { name: 'Scene', exact: true }).click();
    const it = new Scene(page, '/api/v1/files/0/light', '');
    await page.getByText('This browser has no WebGL2, which the scene view needs').waitFor();
    await it.section.getByRole('button', { name: 'sphere', exact: true }).click();
    await until(() => it.where === 'object == sphere', 'a pick of the list', 5);
    await accessible('the scene without WebGL2', page);
    await page.context().close();
  });

  for (const { page } of Object.values(targets)) await page.context().close().catch(() => {});
  if (server) await farm.kill(server.child);
  await farm.end();
  await browser.close();
}
