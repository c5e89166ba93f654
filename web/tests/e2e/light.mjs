/** The recorded light: the tab of a job over a farm of two workers, and `femc view` over files. */
import { execFileSync, spawn } from 'node:child_process';
import { copyFileSync, existsSync, mkdirSync, readdirSync, readFileSync, symlinkSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { chromium } from 'playwright-core';
import { Farm, pause, program, root, until } from './farm.mjs';

const TABLES = ['paths', 'intersections', 'lights'];
/** Keys of the axes of a table in the address. */
const AXES = { paths: 'pa', intersections: 'ia', lights: 'la' };
/** A browser that draws with WebGL2, in software. */
const GRAPHICS = ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const FLAGS = ['--no-sandbox', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'];

const clean = (text) => text.replace(/\s+/g, ' ').trim();
const number = (text) => Number(text.replace(/[^\d.e+-]/g, ''));

/** Header of `application/vnd.femc.columns`. */
function header(bytes) {
  if (bytes.toString('latin1', 0, 4) !== 'FLCV') throw new Error(`not columns: ${bytes.toString('utf8', 0, 80)}`);
  return JSON.parse(bytes.toString('utf8', 12, 12 + bytes.readUInt32LE(8)));
}

/** `femc view` and the latest address that it prints. Each address signs in one browser context. */
export async function view(farm, ...inputs) {
  const name = `view-${Math.random().toString(36).slice(2, 8)}`;
  const child = farm.launch(name, ['view', ...inputs, '--no-browser']);
  const log = join(farm.folder, `${name}.log`);
  const latest = () => (existsSync(log) && readFileSync(log, 'utf8').match(/^http:\S+$/gm)?.at(-1)) || null;
  const address = await until(() => {
    if (child.exitCode !== null) throw new Error(`femc view ended: ${existsSync(log) ? readFileSync(log, 'utf8') : ''}`);
    return latest();
  }, 'femc view prints an address');
  return {
    child,
    get address() {
      return latest();
    },
    url: new URL(address).origin,
  };
}

/** A page with recorded light, and where its numbers can be checked. */
class Light {
  /**
   * - `api`: path of its data set, and `frames` in the query.
   * - `folder`, `file`: the statistics file on this machine.
   */
  constructor(page, { api, frames = '', folder, file }) {
    Object.assign(this, { page, api, frames, folder, file });
  }

  query(key) {
    const { search, hash } = new URL(this.page.url());
    return new URLSearchParams(search).get(key) ?? new URLSearchParams(hash.slice(1)).get(key);
  }
  get where() {
    return this.query('where') ?? '';
  }
  /** Waits until a change has reached the address, which follows after a while. */
  async settled() {
    let [before, same] = [null, 0];
    await until(async () => {
      const now = JSON.stringify([this.page.url(), await this.field.inputValue()]);
      same = now === before ? same + 1 : 0;
      before = now;
      return same >= 2;
    }, 'the address is settled', 10);
  }
  get field() {
    return this.page.getByLabel('Text of the selection');
  }

  async ask(call, values = {}) {
    const query = new URLSearchParams({ ...(this.frames ? { frames: this.frames } : {}), ...values });
    const answer = await this.page.request.get(`${this.api}/${call}?${query}`);
    const body = await answer.body();
    if (!answer.ok()) throw new Error(`${call} ${query}: ${answer.status()} ${body.toString('utf8', 0, 300)}`);
    return call === 'schema' ? JSON.parse(body.toString()) : header(body);
  }

  /** Waits until the plots are drawn. */
  async shown() {
    await this.page.locator('[data-totals]').waitFor();
    for (const table of TABLES) await this.page.locator(`[data-plot=${table}]`).waitFor();
  }

  /** Counts on the screen; null while they are old. */
  async counts(at = 0) {
    const line = this.page.locator('[aria-label=Selection] .counts > span').nth(at);
    return line.evaluate((it) => it.classList.contains('busy') ? null : Object.fromEntries(
      [...it.querySelectorAll('[data-count]')].map((of) => [of.dataset.count, Number(of.textContent.replace(/\D/g, ''))]),
    ), null, { timeout: 2000 }).catch(() => null);
  }

  /** Selected records by the command line. */
  command(where, file = this.file) {
    const lines = (table) => execFileSync(program(), ['paths', file, '--where', where, '--table', table, '--csv'], {
      cwd: this.folder, encoding: 'utf8', maxBuffer: 1 << 28, stdio: ['ignore', 'pipe', 'ignore'],
    }).trim().split('\n').length - 1;
    return Object.fromEntries(TABLES.map((table) => [table, lines(table)]));
  }

  /** Checks that the page, the call and the command line select the same number of records; the numbers. */
  async agree(claim, what, { commandToo = true } = {}) {
    await this.settled();
    const { where } = this;
    claim(where, `${what}: there is a selection`);
    const { counts } = await this.ask('selection', { where });
    let seen = null;
    await until(async () => JSON.stringify((seen = await this.counts())) === JSON.stringify({
      paths: counts.paths, intersections: counts.intersections, lights: counts.lights,
    }), 'x', 15).catch(() => claim(false, `${what}: the page shows ${JSON.stringify(seen)} for ${where}, not ${JSON.stringify(counts)}`));
    await until(async () => (await this.field.inputValue()) === where, `${what}: the text is in the field`, 5);
    if (commandToo) {
      const listed = this.command(where);
      for (const table of TABLES)
        claim(listed[table] === counts[table], `${what}: femc paths lists ${listed[table]} ${table} for ${where}, the page ${counts[table]}`);
    }
    return counts;
  }

  /** Sets the text as a person does. */
  async type(text) {
    await this.field.fill(text);
    await this.field.press('Enter');
    await until(() => this.where === text, `the text ${text} is in the address`, 5);
  }

  plot(table) {
    return this.page.locator(`[data-plot=${table}]`);
  }
  column(table, name) {
    return this.plot(table).getByRole('group', { name, exact: true });
  }
  title(table, name) {
    return this.column(table, name).getByRole('button', { name, exact: true });
  }
  menu(name) {
    return this.page.getByRole('dialog', { name: `Axis ${name}` });
  }
  /** Position of an axis: x, and y of a height from 0 to 1. */
  async place(table, name) {
    const strip = this.column(table, name).locator('.strip');
    await strip.evaluate((it) => it.scrollIntoView({ block: 'center', inline: 'center' }));
    await pause(120);
    const [box, head] = [await strip.boundingBox(), await this.title(table, name).boundingBox()];
    return { x: head.x + head.width / 2, y: (height) => box.y + 10 + (1 - height) * (box.height - 20) };
  }
  async drag(...points) {
    const [first, ...rest] = points;
    await this.page.mouse.move(...first);
    await this.page.mouse.down();
    for (const point of rest) await this.page.mouse.move(...point, { steps: 6 });
    await this.page.mouse.up();
    await pause(150);
  }
  async brush(table, name, from, to) {
    const at = await this.place(table, name);
    await this.drag([at.x, at.y(from)], [at.x, at.y(to)]);
  }
  /** Clicks a category of an axis. */
  async category(table, name, index = 0) {
    await this.place(table, name);
    const label = this.column(table, name).locator('.label').nth(index);
    const box = await label.boundingBox();
    await this.page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    await pause(150);
    return clean(await label.textContent());
  }
  /** Names of the axes of a plot from left to right. */
  order(table) {
    return this.plot(table).locator('.column').evaluateAll((all) =>
      all.toSorted((a, b) => parseFloat(a.style.left) - parseFloat(b.style.left)).map((it) => it.ariaLabel));
  }
  chips() {
    return this.page.locator('[aria-label=Selection] .line').first().locator(':scope > .chips > .chip');
  }
  chip(text) {
    return this.page.locator('[aria-label=Selection]').getByRole('group', { name: text, exact: true });
  }
  /** Sum of the bytes of a canvas: changes with what is on it. */
  canvas(selector) {
    return this.page.locator(selector).first().evaluate((canvas) => {
      const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
      let sum = 0;
      for (let i = 0; i < data.length; i++) sum = (sum * 31 + data[i]) | 0;
      return sum;
    });
  }
  async clear() {
    if (!this.where) return;
    await this.page.locator('[aria-label=Selection]').getByRole('button', { name: 'Clear', exact: true }).click();
    await until(() => !this.where, 'the selection is cleared', 5);
  }
}

export async function light({ step, open, claim, equal, accessible, current, browser: plain, shotsAt }) {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    ignoreDefaultArgs: ['--disable-back-forward-cache'],
    args: [...FLAGS, ...GRAPHICS],
  });
  const farm = await Farm.start();
  const shown = async (of, options = {}) => current(await open(of, { by: browser, ...options }));
  const images = shotsAt && (async (page, name, options = {}) => {
    // Lines are drawn bit by bit.
    await pause(name === 'light-growing' ? 900 : 5000);
    await page.screenshot({ path: join(shotsAt, `${name}.png`), ...options });
  });
  const jobs = {};
  const files = { gallery: 'gallery.paths', pendant: 'pendant.paths' };
  let server;
  /** The pages over files and over the farm. */
  const targets = {};

  let begun;
  /** The files and the jobs that the steps look at. */
  const begin = () => (begun ??= prepare());
  async function prepare() {
    const render = (scene, spp, out) =>
      farm.femc('render', join(root, 'scenes', `${scene}.mgf`), '-o', out, '--size', '64x48', '--spp', String(spp), '--stats');
    render('gallery', 64, 'gallery.exr');
    render('pendant', 16, 'pendant.exr');
    await farm.coordinator();
    for (const name of ['light-a', 'light-b']) farm.worker(name);
    jobs.gallery = farm.submit('gallery.mgf', '--size', '64x48', '--spp', '64', '--stats');
    jobs.pendant = farm.submit('pendant.mgf', '--size', '64x48', '--spp', '16', '--stats');
    jobs.plain = farm.submit('cornell.mgf', '--size', '16x16', '--spp', '2');
    for (const job of Object.values(jobs)) await until(() => farm.job(job).state === 'done', `job ${job} is done`, 180);
    for (const name of ['gallery', 'pendant']) {
      farm.femc('fetch', String(jobs[name]), '-o', `fetched-${name}`);
      const fetched = readdirSync(join(farm.folder, `fetched-${name}`)).find((it) => it.endsWith('.paths'));
      claim(fetched, `femc fetch writes the statistics of ${name}`);
      files[`farm-${name}`] = join(`fetched-${name}`, fetched);
    }
    server = await view(farm, files.gallery, files.pendant);
  }
  const gone = async () => {
    for (const { page } of Object.values(targets)) await page.context().close().catch(() => {});
    if (server) await farm.kill(server.child);
    await farm.end();
    await browser.close();
  };

  const openings = {
    async view() {
      const page = await shown({ url: server.url });
      await page.goto(server.address);
      const it = new Light(page, { api: '/api/v1/files/0/light', folder: farm.folder, file: files.gallery });
      await it.shown();
      return it;
    },
    async farm() {
      const page = await shown(farm);
      await page.goto(`/jobs/${jobs.gallery}/light`);
      const api = `/api/v1/jobs/${jobs.gallery}/light`;
      const it = new Light(page, { api, frames: '1', folder: farm.folder, file: files['farm-gallery'] });
      await it.shown();
      return it;
    },
  };
  const target = async (where) => {
    await begin();
    return (targets[where] ??= await openings[where]());
  };

  await step('light: the address of femc view opens the page, and the token leaves it', async () => {
    const { page } = await target('view');
    equal(new URL(page.url()).pathname, '/view', 'page');
    const compared = clean(await page.getByText('bins are red where A has the larger share').innerText());
    claim(compared.startsWith('A is gallery.paths, B is pendant.paths'), `both files: ${compared}`);
    claim(!page.url().includes('token') && !page.url().includes('femc_'), `no token in ${page.url()}`);
    await page.goBack().catch(() => {});
    claim(!page.url().includes('femc_'), `no token in the history: ${page.url()}`);
  });
  await step('light: the tab of a job', async () => {
    const it = await target('farm');
    const { page } = it;
    await page.goto(`/jobs/${jobs.gallery}`);
    await page.getByRole('link', { name: 'Light' }).or(page.getByRole('tab', { name: 'Light' })).first().click();
    await it.shown();
    equal(new URL(page.url()).pathname, `/jobs/${jobs.gallery}/light`, 'page');
    await page.keyboard.press('1');
    await until(() => !page.url().includes('/light'), 'another view by a key', 5);
    await page.keyboard.press('8');
    await it.shown();
  });

  for (const where of ['view', 'farm']) {
    const home = () => (where === 'view' ? '/view' : `/jobs/${jobs.gallery}/light`);
    const on = (name, run) => step(`light: ${where}: ${name}`, async () => {
      const it = await target(where);
      current(it.page);
      await it.page.goto(home());
      await it.shown();
      await run(it, it.page);
    });
    await on('totals are those of the schema', async (it, page) => {
      const schema = await it.ask('schema');
      const rows = await it.ask('paths', { count: 5000 });
      const text = clean(await page.locator('[data-totals]').innerText());
      claim(text.includes(`${schema.recorded.toLocaleString('en-US')} paths recorded`), `recorded paths: ${text}`);
      claim(text.includes(`${rows.set.toLocaleString('en-US')} lines for ${rows.candidates.toLocaleString('en-US')} paths`), `lines: ${text}`);
      claim(!text.includes('so far'), `nothing grows: ${text}`);
      claim(text.includes('All counts are of recorded paths'), `what is counted: ${text}`);
      const samples = Number(/([\d.]+) k samples/.exec(text)?.[1]);
      claim(Math.abs(samples * 1000 - schema.samples) < 600, `samples: ${text}`);
      const d = Number(/D ([\d.e-]+)/.exec(text)?.[1]);
      claim(Math.abs(d - rows.d) <= 0.006 * rows.d + 1e-9, `D: ${text}, not ${rows.d}`);
      const most = { paths: 20, intersections: 10, lights: 6 };
      for (const table of TABLES) equal((await it.order(table)).length, most[table], `axes of the ${table}`);
      claim((await page.locator('.hint').count()) === 0, 'this browser has WebGL2');
    });

    await on('a brush by the mouse: terms, text, counts; two ranges, moved, an end dragged, inverted, cleared', async (it, page) => {
      await it.brush('paths', 'pixel.x', 0.25, 0.5);
      await until(() => /^pixel\.x >= 1[5-7] and pixel\.x <= 3[0-2]$/.test(it.where), `one range, not ${it.where}`, 5);
      equal(await it.chips().count(), 1, 'terms');
      const one = await it.agree(claim, 'one range');
      claim(one.paths > 500, `paths of a quarter of the pixels: ${one.paths}`);
      await it.brush('paths', 'pixel.x', 0.7, 0.9);
      await until(() => it.where.includes(' or '), `two ranges, not ${it.where}`, 5);
      equal(await it.chips().count(), 1, 'one term for two ranges of an axis');
      const two = await it.agree(claim, 'two ranges');
      claim(two.paths > one.paths, 'more paths in two ranges');
      const bounds = () => [...it.where.matchAll(/(\d+)/g)].map(([n]) => Number(n));
      const before = bounds();
      await it.brush('paths', 'pixel.x', 0.38, 0.45);
      await until(() => bounds()[0] > before[0], `the first range moves up: ${it.where}`, 5);
      const moved = bounds();
      equal(moved[1] - moved[0], before[1] - before[0], 'a moved range keeps its size');
      equal(`${moved.slice(2)}`, `${before.slice(2)}`, 'the other range stays');
      await it.agree(claim, 'a moved range');
      // An end, by its handle.
      const end = it.column('paths', 'pixel.x').getByRole('slider', { name: 'Upper end of range 2 of pixel.x' });
      const box = await end.boundingBox();
      await it.drag([box.x + 16, box.y + 16], [box.x + 16, box.y + 40]);
      await until(() => bounds()[3] < moved[3], `the upper end moves down: ${it.where}`, 5);
      equal(bounds()[2], moved[2], 'the lower end stays');
      const small = await it.agree(claim, 'a moved end');
      // The menu inverts and clears.
      await it.title('paths', 'pixel.x').click();
      await it.menu('pixel.x').getByRole('button', { name: 'Invert' }).click();
      await until(() => it.where.startsWith('not '), `inverted: ${it.where}`, 5);
      const rest = await it.agree(claim, 'inverted');
      const { recorded } = await it.ask('schema');
      equal(rest.paths + small.paths, recorded, 'a brush and its inversion contain all paths');
      await it.menu('pixel.x').getByRole('button', { name: 'Clear' }).click();
      await until(() => !it.where, 'cleared', 5);
      await page.keyboard.press('Escape');
      // A double click clears, too; so does Escape.
      await it.brush('paths', 'depth', 0.1, 0.4);
      await until(() => /^depth/.test(it.where), 'a brush on depth', 5);
      const at = await it.place('paths', 'depth');
      await page.mouse.dblclick(at.x, at.y(0.97));
      await until(() => !it.where, 'a double click clears', 5);
      await it.brush('paths', 'radiance.g', 0.5, 0.8);
      await until(() => /^path\.radiance\.g/.test(it.where), 'a brush on radiance', 5);
      await it.agree(claim, 'a range of a logarithmic axis');
      await it.plot('paths').getByRole('button', { name: 'Clear brushes' }).click();
      await until(() => !it.where, 'the button of the plot clears', 5);
    });

    await on('brushes of the three plots are one selection; categories by a click', async (it, page) => {
      const word = await it.category('intersections', 'object');
      await until(() => /^any\(object == /.test(it.where), `a category, not ${it.where}`, 5);
      const object = /object == (\S+)\)/.exec(it.where)[1];
      claim(object.endsWith(word.replace('…', '')), `${object} is what was clicked, ${word}`);
      await it.agree(claim, 'a category');
      await it.brush('intersections', 'bounce', 0.02, 0.2);
      await until(() => /any\(object == \S+ and bounce/.test(it.where), `both in one intersection: ${it.where}`, 5);
      await it.agree(claim, 'two brushes of a plot');
      await it.brush('paths', 'pixel.y', 0.3, 0.9);
      await until(() => it.where.includes('pixel.y'), 'a brush of another plot', 5);
      await it.agree(claim, 'brushes of two plots');
      const found = await it.category('lights', 'found');
      await until(() => it.where.includes(`light(found == ${found})`), `lights: ${it.where}`, 5);
      const all = await it.agree(claim, 'brushes of three plots');
      claim(all.paths > 0, 'there are such paths');
      equal(await it.chips().count(), 3, 'terms');
      // The line of a path under the pointer, and the values of a bin.
      const at = await it.place('paths', 'first.x');
      await page.mouse.move(at.x + 1, at.y(0.5));
      await it.plot('paths').locator('.tip').waitFor();
      claim(/selected/.test(await it.plot('paths').locator('.tip').innerText()), 'the tip counts the selected ones');
      // Escape clears.
      await page.keyboard.press('Escape');
      await until(() => !it.where, 'Escape clears', 5);
    });

    await on('a brush by the keyboard alone', async (it, page) => {
      await page.locator('body').press('Tab');
      const focused = () => page.evaluate(() => [document.activeElement?.ariaLabel ?? '', document.activeElement?.closest('[data-plot]')?.dataset.plot ?? '']);
      const tabTo = async (label, plot) => {
        for (let i = 0; i < 150; i++) {
          const [is, of] = await focused();
          if (is === label && (!plot || of === plot)) return;
          await page.keyboard.press('Tab');
        }
        claim(false, `Tab reaches ${label}`);
      };
      await tabTo('depth', 'paths');
      await page.keyboard.press('Enter');
      await it.menu('depth').waitFor();
      await tabTo('Lower end of a new range');
      await page.keyboard.type('4');
      await page.keyboard.press('Tab');
      await page.keyboard.type('6');
      await page.keyboard.press('Enter');
      await until(() => it.where === 'depth >= 4 and depth <= 6', `a range by numbers, not ${it.where}`, 5);
      await it.agree(claim, 'a range by numbers');
      // Escape closes the menu, and nothing else.
      await page.keyboard.press('Escape');
      await it.menu('depth').waitFor({ state: 'hidden' });
      equal(it.where, 'depth >= 4 and depth <= 6', 'the selection after Escape in the menu');
      await page.keyboard.press('Enter');
      await it.menu('depth').waitFor();
      await page.keyboard.press('Escape');
      await it.menu('depth').waitFor({ state: 'hidden' });
      equal(it.where, 'depth >= 4 and depth <= 6', 'the selection after Escape on a button of the menu');
      equal((await focused())[0], 'depth', 'the focus returns');
      await tabTo('Upper end of range 1 of depth');
      await page.keyboard.press('ArrowUp');
      await until(() => it.where === 'depth >= 4 and depth <= 7', `an end by a key, not ${it.where}`, 5);
      await page.keyboard.press('ArrowDown');
      await page.keyboard.press('ArrowDown');
      await until(() => it.where === 'depth >= 4 and depth <= 5', `an end by keys, not ${it.where}`, 5);
      await it.agree(claim, 'an end moved by keys');
      // Invert by keys.
      await page.keyboard.press('Shift+Tab');
      await page.keyboard.press('Shift+Tab');
      equal((await focused())[0], 'depth', 'back to the title');
      await page.keyboard.press('Enter');
      await it.menu('depth').waitFor();
      for (let i = 0; i < 12 && (await page.evaluate(() => document.activeElement.textContent.trim())) !== 'Invert'; i++)
        await page.keyboard.press('Tab');
      await page.keyboard.press('Space');
      await until(() => it.where === 'not (depth >= 4 and depth <= 5)', `inverted by a key, not ${it.where}`, 5);
      await it.agree(claim, 'inverted by a key');
      await page.keyboard.press('Escape');
      // A word by keys.
      await it.title('lights', 'found').focus();
      await page.keyboard.press('Enter');
      await it.menu('found').waitFor();
      for (let i = 0; i < 12 && (await page.evaluate(() => document.activeElement.type)) !== 'checkbox'; i++)
        await page.keyboard.press('Tab');
      await page.keyboard.press('Space');
      await until(() => /light\(found == \w+\)$/.test(it.where), `a word by a key: ${it.where}`, 5);
      await it.agree(claim, 'a word by a key');
      await page.keyboard.press('Escape');
      await it.title('lights', 'found').focus();
      await page.keyboard.press('Escape');
      await until(() => !it.where, 'Escape clears the selection', 5);
    });

    await on('axes: order by drag and by keys, hidden, linear, flipped; a reload shows the same', async (it, page) => {
      const usual = await it.order('paths');
      await it.place('paths', 'radiance.g');
      const center = async (name) => {
        const box = await it.title('paths', name).boundingBox();
        return [box.x + box.width / 2, box.y + box.height / 2];
      };
      await it.place('paths', 'pixel.y');
      await it.drag(await center('throughput.r'), await center('pixel.y'));
      await until(async () => (await it.order('paths'))[1] === 'throughput.r', 'an axis is moved by the mouse', 5);
      equal(await page.getByRole('dialog').count(), 0, 'a drag opens no menu');
      await it.title('paths', 'throughput.r').focus();
      await page.keyboard.press('Alt+ArrowRight');
      await until(async () => (await it.order('paths'))[2] === 'throughput.r', 'an axis is moved by a key', 5);
      await until(() => it.title('paths', 'throughput.r').evaluate((t) => t === document.activeElement), 'it keeps the focus', 5);
      await page.keyboard.press('Alt+ArrowRight');
      await until(async () => (await it.order('paths'))[3] === 'throughput.r', 'and by a second one: the focus stays', 5);
      await it.title('paths', 'radiance.r').click();
      await it.menu('radiance.r').getByRole('button', { name: 'Logarithmic' }).click();
      await it.menu('radiance.r').getByRole('button', { name: 'Flip' }).click();
      await page.keyboard.press('Escape');
      await it.title('paths', 'throughput.b').click();
      await it.menu('throughput.b').getByRole('button', { name: 'Hide' }).click();
      await until(async () => (await it.order('paths')).length === 19, 'an axis is hidden', 5);
      await it.title('lights', 'occluder').click();
      await it.menu('occluder').getByRole('button', { name: '← Left' }).click();
      await page.keyboard.press('Escape');
      await it.brush('paths', 'radiance.r', 0.3, 0.6);
      await until(() => it.where.startsWith('path.radiance.r'), 'a brush on the changed axis', 5);
      const counts = await it.agree(claim, 'a brush on a linear, flipped axis');
      const state = async () => JSON.stringify({
        orders: [await it.order('paths'), await it.order('intersections'), await it.order('lights')],
        where: it.where,
        title: await it.title('paths', 'radiance.r').innerText(),
        ends: await it.column('paths', 'radiance.r').getByRole('slider').evaluateAll((all) => all.map((end) => end.style.top)),
        query: [it.query(AXES.paths), it.query(AXES.lights)],
      });
      const before = await state();
      claim(JSON.parse(before).query.every((part) => part), `both plots are in the address: ${before}`);
      await page.reload();
      await it.shown();
      await until(async () => (await state()) === before, 'a reload shows the same', 10).catch(async () => equal(await state(), before, 'after a reload'));
      equal(JSON.stringify(await it.agree(claim, 'after a reload')), JSON.stringify(counts), 'counts after a reload');
      await it.plot('paths').getByRole('button', { name: 'Hidden axes (1)' }).click();
      await page.getByRole('button', { name: 'Show throughput.b' }).click();
      await until(async () => (await it.order('paths')).length === 20, 'the axis is shown again', 5);
      await page.goto(home());
      await it.shown();
      equal(`${await it.order('paths')}`, `${usual}`, 'the usual order');
    });

    await on('terms: removed, negated, joined; the text edited, refused, copied as a command', async (it, page) => {
      await it.type('depth >= 3 and any(object == knot) or end == roulette and pixel.x < 20');
      await until(async () => (await it.chips().count()) === 4, 'four terms', 5);
      await it.agree(claim, 'a text');
      await it.chip('any(object == knot)').getByRole('button', { name: 'not', exact: true }).first().click();
      await until(() => it.where.includes('not any(object == knot)'), `negated: ${it.where}`, 5);
      await it.agree(claim, 'a negated term');
      await page.locator('[aria-label=Selection]').getByRole('button', { name: 'any intersection' }).click();
      await until(() => it.where.includes('not all(object == knot)'), `all intersections: ${it.where}`, 5);
      await it.agree(claim, 'all intersections');
      await page.locator('[aria-label=Selection]').getByRole('button', { name: 'or', exact: true }).click();
      await until(() => it.where === 'depth >= 3 and not all(object == knot) and end == roulette and pixel.x < 20', `joined by and: ${it.where}`, 5);
      await it.agree(claim, 'joined otherwise');
      await it.chip('end == roulette').first().getByRole('button', { name: 'Remove end == roulette' }).click();
      await until(() => it.where === 'depth >= 3 and not all(object == knot) and pixel.x < 20', `a term is removed: ${it.where}`, 5);
      const kept = await it.agree(claim, 'a removed term');
      // A brush shows the term, and the text follows its handle.
      claim((await it.column('paths', 'depth').getByRole('slider').count()) >= 1, 'the plot shows the term');

      // Faults of a text: found by the page, and by the server.
      const selection = page.locator('[aria-label=Selection]');
      await it.field.fill('depth >= 3 and banana');
      await it.field.press('Enter');
      await selection.getByText(/column 22/).waitFor();
      equal(it.where, 'depth >= 3 and not all(object == knot) and pixel.x < 20', 'the selection after a faulty text');
      equal(JSON.stringify(await it.counts()), JSON.stringify({ paths: kept.paths, intersections: kept.intersections, lights: kept.lights }), 'its counts');
      equal(await it.field.getAttribute('aria-invalid'), 'true', 'the field is marked');
      await it.field.press('Escape');
      equal(await it.field.inputValue(), it.where, 'Escape discards the text');
      await it.field.fill('depth >= 3 and banana >= 4');
      await it.field.press('Enter');
      await selection.getByText(/column 16/).waitFor();
      await selection.getByText('The page shows the last valid selection').waitFor();
      equal((await it.counts())?.paths, kept.paths, 'the counts of the last valid selection');
      await it.type("depth >= 3 and any(object == room) and not light(occluder == room)");
      await until(async () => (await selection.getByText(/column/).count()) === 0, 'the fault is gone', 5);
      const due = await it.agree(claim, 'a valid text again');

      // The command runs in a shell.
      await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
      await selection.getByRole('button', { name: 'Copy as command' }).click();
      await page.getByText('The command is copied.').first().waitFor();
      const line = await page.evaluate(() => navigator.clipboard.readText());
      claim(line.startsWith('femc paths ') && line.includes('--where'), `a command: ${line}`);
      const bin = join(farm.folder, 'bin');
      if (!existsSync(bin)) {
        mkdirSync(bin);
        symlinkSync(program(), join(bin, 'femc'));
      }
      const cwd = where === 'view' ? farm.folder : join(farm.folder, 'fetched-gallery');
      const listed = execFileSync('sh', ['-c', `${line} --csv`], {
        cwd, env: { ...process.env, PATH: `${bin}:${process.env.PATH}` }, encoding: 'utf8', maxBuffer: 1 << 28, stdio: ['ignore', 'pipe', 'ignore'],
      });
      equal(listed.trim().split('\n').length - 1, due.paths, `paths that ${line} lists`);
      await it.clear();
    });

    await on('terms by buttons: object, shadow, order, box', async (it, page) => {
      const selection = page.locator('[aria-label=Selection]');
      const object = selection.getByLabel('Object', { exact: true });
      await object.fill('knot');
      await selection.getByRole('button', { name: 'Intersects' }).click();
      await until(() => it.where === 'any(object == knot)', `it hits the object: ${it.where}`, 5);
      await it.agree(claim, 'intersects');
      await it.clear();
      await selection.getByRole('button', { name: 'Shadow of' }).click();
      await until(() => it.where === 'light(occluder == knot)', `its shadow: ${it.where}`, 5);
      await it.agree(claim, 'shadow of');
      await it.clear();
      await selection.getByLabel('then', { exact: true }).fill('room');
      await selection.getByRole('button', { name: 'In this order' }).click();
      await until(() => it.where === 'knot then room', `in order: ${it.where}`, 5);
      await it.agree(claim, 'in this order');
      await it.clear();
      await selection.getByLabel('Box, upper z').fill('1');
      await selection.getByRole('button', { name: 'In this box' }).click();
      await until(() => /^any\(in box\(.*,1\)\)$/.test(it.where), `a box: ${it.where}`, 5);
      const { paths } = await it.agree(claim, 'in a box');
      claim(paths > 0, 'there are paths in the box');
      await it.clear();
    });

    await on('picture: a line, a pixel, the density and its smoothing', async (it, page) => {
      const host = page.locator('.host');
      await host.evaluate((h) => h.scrollIntoView({ block: 'center' }));
      await pause(200);
      const film = await page.locator('.host .film').boundingBox();
      const at = (x, y) => [film.x + (x / 64) * film.width, film.y + (y / 48) * film.height];
      await page.keyboard.down('Shift');
      await it.drag(at(15, 10), at(45, 10), at(45, 38), at(15, 38));
      await page.keyboard.up('Shift');
      await until(() => /^in lasso\(/.test(it.where), `a line: ${it.where}`, 5);
      equal(await it.chips().count(), 1, 'terms');
      const inside = await it.agree(claim, 'in a line');
      claim(inside.paths > 300, `paths inside: ${inside.paths}`);
      // The density of the selection, in every form.
      const seen = new Map();
      const picture = page.locator('[aria-label=Picture]');
      const look = async (name) => {
        await pause(250);
        seen.set(name, await it.canvas('.host canvas'));
      };
      await look('over');
      const form = (name) => picture.getByRole('group', { name: 'Density', exact: true }).getByRole('button', { name, exact: true });
      await form('Alone').click();
      await look('hot');
      equal(it.query('density'), 'hot', 'density in the address');
      await picture.getByLabel('Smoothing').fill('2');
      await until(() => it.query('smooth') === '2', 'smoothing in the address', 5);
      await look('smooth');
      await picture.getByLabel('Density of').selectOption('light');
      await look('light');
      await picture.getByLabel('log').uncheck();
      await look('linear');
      await form('Off').click();
      await look('none');
      const all = [...seen.values()];
      equal(new Set(all).size, all.length, `different pictures (${[...seen.keys()]})`);
      await form('Alone').click();
      await picture.locator('.legend').waitFor();
      const [px, py] = at(30.5, 24.5);
      await page.mouse.move(px, py);
      claim(/cd\/m²/.test(await page.locator('.host .tip').innerText()), 'the density under the pointer');
      // Without the line again: Escape on the picture.
      await host.focus();
      await page.keyboard.press('Escape');
      await until(() => !it.where, 'Escape removes the line', 5);
      // A pixel with a recorded path. Its paths are selected by one click. The picture has not moved meanwhile.
      await page.mouse.click(px, py);
      const pixel = picture.getByRole('button', { name: /^Select the paths of pixel \d+, \d+$/ });
      await pixel.waitFor();
      const [x, y] = (await pixel.textContent()).match(/\d+/g);
      equal(`${x},${y}`, '30,24', 'the pinned pixel');
      await pixel.click();
      await until(() => it.where === `pixel.x == ${x} and pixel.y == ${y}`, `its paths: ${it.where}`, 5);
      await it.agree(claim, 'paths of a pixel');
      // Another pixel takes its place.
      await host.press('ArrowRight');
      await picture.getByRole('button', { name: /^Select the paths of pixel 31, 24$/ }).click();
      await until(() => it.where === 'pixel.x == 31 and pixel.y == 24', `the next pixel: ${it.where}`, 5);
      await it.agree(claim, 'paths of the next pixel');
    });

    await on('picture: heat maps have the values of the statistics, and the picture keeps its place', async (it, page) => {
      const picture = page.locator('[aria-label=Picture]');
      const choice = picture.getByLabel('Show', { exact: true });
      await picture.evaluate((p) => p.scrollIntoView({ block: 'center' }));
      await pause(300);
      /** Place of the picture in its panel: the page may scroll. */
      const place = () => picture.evaluate((panel) => {
        const [at, ...boxes] = [panel, panel.querySelector('.host'), panel.querySelector('.film')].map((it) => it.getBoundingClientRect());
        return boxes.map((box) => [box.x - at.x, box.y - at.y, box.width, box.height].map(Math.round)).join('; ');
      });
      const [at, film] = [await place(), await page.locator('.host .film').boundingBox()];
      const point = [film.x + (30.5 / 64) * film.width, film.y + (24.5 / 48) * film.height];
      const pixels = JSON.parse(execFileSync(program(), ['paths', it.file, '--table', 'pixels', '--json'], {
        cwd: it.folder, encoding: 'utf8', maxBuffer: 1 << 28, stdio: ['ignore', 'pipe', 'ignore'],
      }));
      const own = pixels.find((pixel) => pixel.pixel_x === 30 && pixel.pixel_y === 24);
      const due = { luminance: own.luminance, samples: own.samples, depth: own.depth, throughput: own.throughput, deviation: Math.sqrt(own.variance) };
      const seen = new Map([['picture', await it.canvas('.host canvas')]]);
      for (const map of ['luminance', 'pixel-error', 'error', 'samples', 'deviation', 'depth', 'throughput']) {
        if (where === 'view' && map === 'error') {
          const option = choice.locator('option[value=error]');
          equal(await option.isDisabled(), true, 'a map that the file lacks cannot be chosen');
          equal(clean(await option.textContent()), 'Block error (not in the file)', 'and says why');
          continue;
        }
        await choice.selectOption(map);
        await until(() => it.query('show') === map, `${map} is in the address`, 5);
        await picture.locator('.legend').waitFor();
        await pause(250);
        seen.set(map, await it.canvas('.host canvas'));
        await page.mouse.move(point[0] + 1, point[1]);
        await page.mouse.move(...point);
        const tip = clean(await page.locator('.host .tip').innerText());
        claim(tip.startsWith('30, 24: '), `${map}: the pixel under the pointer: ${tip}`);
        if (map in due) {
          const value = number(tip.slice(8));
          claim(Math.abs(value - due[map]) <= 2e-3 * due[map] + 1e-3, `${map}: ${tip}, not ${due[map]}`);
        }
        equal(await place(), at, `${map}: the place of the picture`);
      }
      const all = [...seen.values()];
      equal(new Set(all).size, all.length, `different maps (${[...seen.keys()]})`);
      // By the keyboard: the last map, smoothed, with the density of a selection over it.
      await it.type('any(object == knot)');
      await it.agree(claim, 'a selection');
      equal(await picture.getByRole('button', { name: 'Off', exact: true }).getAttribute('aria-pressed'), 'true', 'a map has no density at first');
      const plain = await it.canvas('.host canvas');
      const over = picture.getByRole('button', { name: 'Over', exact: true });
      await over.focus();
      await page.keyboard.press('Enter');
      await until(() => it.query('density') === 'over', 'the density over a map, in the address', 5);
      await until(async () => (await picture.locator('.legend').count()) === 2, 'a legend of each', 5);
      claim((await it.canvas('.host canvas')) !== plain, 'the density lies over the map');
      const opacity = picture.getByLabel('Opacity');
      await opacity.focus();
      const before = await it.canvas('.host canvas');
      for (let i = 0; i < 6; i++) await page.keyboard.press('ArrowLeft');
      await until(() => it.query('cover') === '50', 'the opacity is in the address', 5);
      await until(async () => (await it.canvas('.host canvas')) !== before, 'the opacity changes the picture', 5);
      await picture.getByLabel('Smoothing').focus();
      await page.keyboard.press('ArrowRight');
      await until(() => it.query('smooth') === '0.5', 'smoothing by a key', 5);
      for (const name of ['Alone', 'Off', 'Over']) {
        await picture.getByRole('button', { name, exact: true }).click();
        equal(await place(), at, `${name}: the place of the picture`);
      }
      await choice.selectOption('picture');
      await picture.getByLabel('Exposure').focus();
      await page.keyboard.press('ArrowRight');
      await until(() => it.query('ev') === '0.25', 'exposure by a key', 5);
      equal(await place(), at, 'the place of the picture');
      // The address shows the same again.
      await choice.selectOption('depth');
      await it.settled();
      await pause(300);
      const last = await it.canvas('.host canvas');
      await page.reload();
      await it.shown();
      await it.agree(claim, 'after a reload');
      await until(async () => (await it.canvas('.host canvas')) === last, 'a reload shows the same map and density', 10);
    });

    await on('lines: 500, within the selection, the brightest', async (it, page) => {
      const totals = async () => clean(await page.locator('[data-totals]').innerText());
      await page.getByLabel('Number of lines').selectOption('500');
      const rows = await it.ask('paths', { count: 500 });
      claim(rows.set <= 520 && rows.set >= 400, `about 500 paths: ${rows.set}`);
      await until(async () => (await totals()).includes(`${rows.set} lines for`), 'about 500 lines', 10);
      const d = Number(/D ([\d.e-]+)/.exec(await totals())?.[1]);
      claim(Math.abs(d - rows.d) <= 0.006 * rows.d, `D of 500: ${await totals()}, not ${rows.d}`);
      await page.getByLabel('Paths drawn as lines').selectOption('selection');
      await it.type('path.radiance.g > 40 and depth >= 2');
      const { paths } = await it.agree(claim, 'a rare selection');
      const within = await it.ask('paths', { count: 500, where: it.where });
      equal(within.candidates, paths, 'candidates within the selection');
      await until(async () => (await totals()).includes(`${within.set.toLocaleString('en-US')} lines for ${paths.toLocaleString('en-US')} paths`),
        'lines within the selection', 10);
      await page.getByText('Table of paths').click();
      await until(async () => clean(await page.locator('caption').innerText()).includes('that the selection contains'), 'a table of them', 5);
      const drawn = await page.locator('table tbody tr').count();
      equal(drawn, Math.min(100, within.set), 'rows of the table');
      await page.getByLabel('Paths drawn as lines').selectOption('brightest');
      const bright = await it.ask('paths', { count: 500, among: 'brightest' });
      await until(async () => (await totals()).includes(`${bright.set.toLocaleString('en-US')} lines`) && !/lines for/.test(await totals()),
        'the brightest', 10);
      equal(it.query('among'), 'brightest', 'in the address');
      equal(it.query('n'), '500', 'in the address');
    });

    await on('two sets: A red, B blue', async (it, page) => {
      const chooser = page.getByLabel('Compare with');
      const option = chooser.locator('option', { hasText: 'pendant' }).first();
      await chooser.selectOption(await option.getAttribute('value'));
      await page.getByText('bins are red where A has the larger share').waitFor();
      await it.plot('paths').getByText('only A').waitFor();
      await it.type('depth >= 2 and depth <= 4');
      await it.agree(claim, 'A');
      const other = it.command(it.where, where === 'view' ? files.pendant : files['farm-pendant']);
      await until(async () => JSON.stringify(await it.counts(1)) === JSON.stringify(other), 'B', 10)
        .catch(async () => equal(JSON.stringify(await it.counts(1)), JSON.stringify(other), 'counts of B'));
      await it.place('paths', 'pixel.x');
      await pause(500);
      const colors = await it.plot('paths').locator('.field canvas').last().evaluate((canvas) => {
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        const seen = { red: 0, blue: 0 };
        for (let i = 0; i < data.length; i += 4) {
          if (data[i + 3] < 200) continue;
          if (data[i] > data[i + 2] + 60) seen.red++;
          else if (data[i + 2] > data[i] + 60) seen.blue++;
        }
        return seen;
      });
      claim(colors.red > 200 && colors.blue > 200, `red and blue bins: ${JSON.stringify(colors)}`);
      // The picture of A or of B, and the density of both or of each.
      const picture = page.locator('[aria-label=Picture]');
      await picture.evaluate((p) => p.scrollIntoView({ block: 'center' }));
      await picture.getByLabel('Smoothing').fill('2');
      const tints = async () => {
        await it.settled();
        await pause(300);
        return page.locator('.host canvas').first().evaluate((canvas) => {
          const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
          const sum = { red: 0, blue: 0 };
          for (let i = 0; i < data.length; i += 4) {
            sum.red += data[i] / (data.length / 4);
            sum.blue += data[i + 2] / (data.length / 4);
          }
          return sum;
        });
      };
      const whose = picture.getByLabel('Density of the sets');
      const both = await tints();
      await whose.selectOption('a');
      const ofA = await tints();
      equal(it.query('whose'), 'a', 'the density of A in the address');
      claim(ofA.red > ofA.blue + 60, `the density of A is red: ${JSON.stringify(ofA)}`);
      await whose.selectOption('b');
      const ofB = await tints();
      claim(ofB.blue > ofB.red + 60, `the density of B is blue: ${JSON.stringify(ofB)}`);
      claim(both.red > ofB.red + 20 && both.blue > ofA.blue + 20, `both densities: ${JSON.stringify({ both, ofA, ofB })}`);
      await picture.getByRole('button', { name: 'Alone', exact: true }).click();
      await picture.getByText(/^B: selected recorded paths/).waitFor();
      await whose.selectOption('');
      await picture.getByText(/^A red, B blue: selected recorded paths/).waitFor();
      await picture.getByRole('button', { name: 'Off', exact: true }).click();
      await tints();
      const pictureOfA = await it.canvas('.host canvas');
      const own = picture.getByRole('group', { name: 'Picture of' });
      await own.getByRole('button', { name: 'A', exact: true }).focus();
      await page.keyboard.press('Tab');
      await page.keyboard.press('Space');
      await until(() => it.query('set') === 'b', 'B by the keyboard, in the address', 5);
      equal(await own.getByRole('button', { name: 'B', exact: true }).getAttribute('aria-pressed'), 'true', 'B is pressed');
      await until(async () => (await it.canvas('.host canvas')) !== pictureOfA, 'another picture', 10);
      await tints();
      const pictureOfB = await it.canvas('.host canvas');
      await picture.getByLabel('Show', { exact: true }).selectOption('difference');
      await picture.getByText('cd/m², A minus B').waitFor();
      claim(![pictureOfA, pictureOfB].includes(await it.canvas('.host canvas')), 'the difference is another picture');
      await picture.getByLabel('Show', { exact: true }).selectOption('picture');
      await it.settled();
      await page.reload();
      await page.getByText('bins are red where A has the larger share').waitFor();
      await until(async () => (await it.canvas('.host canvas')) === pictureOfB, 'a reload shows the picture of B', 10);
      await page.getByText('bins are red where A has the larger share').waitFor();
      if (images && where === 'view') {
        await page.goto(`${home()}?b=${it.query('b')}&smooth=2&where=${encodeURIComponent('depth >= 2 and depth <= 4')}`);
        await page.getByText('bins are red where A has the larger share').waitFor();
        await page.setViewportSize({ width: 1360, height: 1100 });
        await images(page, 'light-compare');
        await page.setViewportSize({ width: 1360, height: 800 });
      }
    });

    for (const [size, dark] of [[1360, false], [1360, true], [390, false], [390, true]]) {
      await on(`axe at ${size} pixels, ${dark ? 'dark' : 'light'}`, async (it, page) => {
        await page.setViewportSize({ width: size, height: 800 });
        await page.emulateMedia({ colorScheme: dark ? 'dark' : 'light' });
        try {
          await page.goto(`${home()}?where=${encodeURIComponent('depth >= 3 and any(object == room) and pixel.x >= 10 and pixel.x <= 50')}`);
          await it.shown();
          await it.agree(claim, 'a selection', { commandToo: false });
          await page.getByText('Table of paths').click();
          await pause(500);
          await accessible(`the light at ${size} pixels`, page);
          const width = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
          claim(width[0] <= width[1], `no horizontal scroll: ${width}`);
          await it.title('paths', 'depth').evaluate((t) => t.scrollIntoView({ block: 'center', inline: 'center' }));
          await it.title('paths', 'depth').click();
          await it.menu('depth').waitFor();
          await pause(200);
          await accessible('the menu of an axis', page);
          await page.keyboard.press('Escape');
          const other = where === 'view' ? '1' : `${jobs.pendant}/1`;
          for (const form of ['show=depth&density=over', 'show=difference&set=b', 'density=hot&whose=b']) {
            await page.goto(`${home()}?b=${other}&where=${encodeURIComponent('depth >= 3')}&${form}&pixel=30,24`);
            await it.shown();
            await page.locator('[aria-label=Picture] .legend').first().waitFor();
            await accessible(`the picture with ${form}`, page);
          }
        } finally {
          await page.setViewportSize({ width: 1360, height: 800 });
          await page.emulateMedia({ colorScheme: 'light' });
        }
      });
    }

    await step(`light: ${where}: fingers on a small screen`, async () => {
      await target(where);
      const of = where === 'view' ? { url: server.url } : farm;
      const page = await shown(of, { viewport: { width: 390, height: 780 }, hasTouch: true, isMobile: true });
      try {
        if (where === 'view') {
          await page.goto(server.address);
          await page.locator('[data-totals]').waitFor();
        }
        await page.goto(home());
        const it = new Light(page, { ...targets[where], page });
        await it.shown();
        const touch = await page.context().newCDPSession(page);
        const finger = async (...points) => {
          const send = (type, list) => touch.send('Input.dispatchTouchEvent', { type, touchPoints: list.map(([x, y]) => ({ x, y })) });
          await send('touchStart', [points[0]]);
          for (let k = 1; k < points.length; k++) {
            const [a, b] = [points[k - 1], points[k]];
            for (let i = 1; i <= 6; i++) await send('touchMove', [[a[0] + ((b[0] - a[0]) * i) / 6, a[1] + ((b[1] - a[1]) * i) / 6]]);
          }
          await send('touchEnd', []);
          await pause(150);
        };
        // A word, by a tap.
        await it.place('lights', 'found');
        const label = await it.column('lights', 'found').locator('.label').first().boundingBox();
        await page.touchscreen.tap(label.x + label.width / 2, label.y + label.height / 2);
        await until(() => /^light\(found == /.test(it.where), `a word by a tap: ${it.where}`, 5);
        await it.agree(claim, 'a word by a tap');
        await it.clear();
        // A brush and its end.
        let at = await it.place('paths', 'pixel.y');
        await finger([at.x, at.y(0.3)], [at.x, at.y(0.7)]);
        await until(() => /^pixel\.y/.test(it.where), `a brush by a finger: ${it.where}`, 5);
        const before = it.where;
        at = await it.place('paths', 'pixel.y');
        const knob = await it.column('paths', 'pixel.y').getByRole('slider', { name: 'Upper end of range 1 of pixel.y' }).boundingBox();
        claim(knob.width >= 44 && knob.height >= 44, `ends have 44 pixels for fingers: ${knob.width} x ${knob.height}`);
        await finger([knob.x + 22, knob.y + 20], [knob.x + 22, knob.y + 60]);
        await until(() => it.where !== before && /^pixel\.y/.test(it.where), `its end by a finger: ${it.where}`, 5);
        await it.agree(claim, 'an end by a finger');
        // A finger scrolls the axes.
        await finger([at.x + 100, at.y(0.5)], [at.x - 20, at.y(0.5)]);
        await pause(300);
        claim((await it.plot('paths').locator('.scroll').evaluate((s) => s.scrollLeft)) > 40, 'a finger scrolls the axes');
        if (images && where === 'view') {
          const now = it.where;
          await page.goto(`${home()}?where=${encodeURIComponent(`any(object == knot) and ${now}`)}`);
          await it.shown();
          await it.agree(claim, 'the small screen');
          await it.plot('paths').evaluate((p) => p.scrollIntoView({ block: 'center' }));
          await page.mouse.wheel(0, -120);
          await images(page, 'light-small');
          await page.goto(`${home()}?where=${encodeURIComponent(now)}`);
          await it.shown();
        }
        await it.clear();
        // Maps, and A or B.
        await page.goto(`${home()}?b=${where === 'view' ? '1' : `${jobs.pendant}/1`}`);
        await it.shown();
        const picture = page.locator('[aria-label=Picture]');
        const isB = picture.getByRole('group', { name: 'Picture of' }).getByRole('button', { name: 'B', exact: true });
        await isB.tap();
        await until(() => it.query('set') === 'b', 'the picture of B by a tap', 5);
        await picture.getByLabel('Show', { exact: true }).selectOption('depth');
        await until(() => it.query('show') === 'depth', 'a map', 5);
        await picture.getByRole('button', { name: 'Alone', exact: true }).tap();
        await until(() => it.query('density') === 'hot', 'the density alone by a tap', 5);
        const slider = picture.getByLabel('Smoothing');
        await slider.evaluate((s) => s.scrollIntoView({ block: 'center' }));
        const track = await slider.boundingBox();
        await page.touchscreen.tap(track.x + 0.75 * track.width, track.y + track.height / 2);
        await until(() => number(it.query('smooth') ?? '0') > 3, `smoothing by a tap: ${it.query('smooth')}`, 5);
        for (const target of await picture.locator('button, select, input[type=range]').all())
          claim((await target.boundingBox()).height >= 34, `controls have 34 pixels for fingers: ${await target.evaluate((t) => t.outerHTML)}`);
        await page.goto(home());
        await it.shown();
        // A line, after the button.
        await page.locator('.host').evaluate((h) => h.scrollIntoView({ block: 'center' }));
        await pause(200);
        await page.locator('.host').getByRole('button', { name: 'Line' }).tap();
        const film = await page.locator('.host .film').boundingBox();
        const on = (x, y) => [film.x + x * film.width, film.y + y * film.height];
        await finger(on(0.2, 0.2), on(0.7, 0.2), on(0.7, 0.6), on(0.2, 0.6));
        await until(() => /^in lasso\(/.test(it.where), `a line by a finger: ${it.where}`, 5);
        await it.agree(claim, 'a line by a finger');
        const width = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
        claim(width[0] <= width[1], `no horizontal scroll: ${width}`);
      } finally {
        await page.context().close();
      }
    });

    await step(`light: ${where}: a browser without WebGL2 has the line and the table`, async () => {
      await target(where);
      for (const kind of ['stub', 'flags']) {
        const of = where === 'view' ? { url: server.url } : farm;
        const page = current(await open(of, { by: kind === 'stub' ? browser : plain }));
        try {
          if (kind === 'stub')
            await page.addInitScript(() => {
              // The page itself looks at the graphics.
              delete globalThis.Worker;
              for (const canvas of [HTMLCanvasElement, OffscreenCanvas]) {
                const { getContext } = canvas.prototype;
                canvas.prototype.getContext = function (name, ...more) {
                  return name === 'webgl2' ? null : getContext.call(this, name, ...more);
                };
              }
            });
          if (where === 'view') {
            await page.goto(server.address);
            await page.locator('[data-totals]').waitFor();
          }
          await page.goto(`${home()}?where=depth+%3E%3D+5`);
          const it = new Light(page, { ...targets[where], page });
          await it.shown();
          const has = await page.evaluate(() => document.createElement('canvas').getContext('webgl2') !== null);
          if (has && kind === 'flags') {
            console.log('        this browser has WebGL2 without a graphics card, too');
            continue;
          }
          await page.getByText('This browser has no WebGL2').first().waitFor();
          await until(async () => (await page.locator('table tbody tr').count()) > 5, 'the table is open', 10);
          await it.agree(claim, 'without WebGL2', { commandToo: false });
          await it.brush('paths', 'pixel.x', 0.2, 0.6);
          await until(() => it.where.includes('pixel.x'), 'brushes work', 5);
          await it.agree(claim, 'a brush without WebGL2');
          await accessible('a page without WebGL2', page);
        } finally {
          await page.context().close();
        }
      }
    });
  }

  await step('light: two films of different sizes', async () => {
    await begin();
    farm.femc('render', join(root, 'scenes', 'gallery.mgf'), '-o', 'narrow.exr', '--size', '40x48', '--spp', '8', '--stats');
    const other = await view(farm, files.gallery, 'narrow.paths');
    try {
      const page = await shown({ url: other.url });
      await page.goto(other.address);
      const it = new Light(page, { api: '/api/v1/files/0/light', folder: farm.folder, file: files.gallery });
      await it.shown();
      await it.type('depth >= 3');
      const picture = page.locator('[aria-label=Picture]');
      const said = 'The films differ: A has 64 × 48 pixels, B 40 × 48. The density of B is not shown over A: choose the picture of B.';
      await picture.getByText(said).waitFor();
      await picture.getByText(/^A: selected recorded paths/).waitFor();
      equal(await picture.locator('option[value=difference]').isDisabled(), true, 'there is no difference');
      await picture.getByRole('group', { name: 'Picture of' }).getByRole('button', { name: 'B', exact: true }).click();
      await picture.getByText('The density of A is not shown over B: choose the picture of A.').waitFor();
      await picture.getByText(/^B: selected recorded paths/).waitFor();
      equal(await page.locator('.host canvas').first().evaluate((c) => `${c.width} x ${c.height}`), '40 x 48', 'the film of B');
      await accessible('two films', page);
      await page.context().close();
    } finally {
      await farm.kill(other.child);
    }
  });

  if (images)
    await step('light: pictures for the manual', async () => {
      const it = await target('view');
      const { page } = it;
      current(page);
      await page.setViewportSize({ width: 1360, height: 1080 });
      await page.goto(`/view?where=${encodeURIComponent('any(material == chrome) and path.radiance.g >= 2')}`);
      await it.shown();
      await it.agree(claim, 'a selection');
      await images(page, 'light-paths');
      await page.setViewportSize({ width: 1360, height: 690 });
      await page.goto(`/view?show=depth&density=over&where=${encodeURIComponent('any(material == chrome)')}`);
      await it.shown();
      await it.agree(claim, 'a selection');
      await images(page, 'light-density');
      await page.setViewportSize({ width: 1360, height: 800 });
    });

  await step('light: a damaged file in the terminal: what is wrong, and what to do', async () => {
    await begin();
    const terminal = (name, change) => {
      const bytes = readFileSync(join(farm.folder, files.gallery));
      change(bytes);
      writeFileSync(join(farm.folder, name), bytes);
      try {
        execFileSync(program(), ['view', name, '--no-browser'], { cwd: farm.folder, encoding: 'utf8', timeout: 20_000, stdio: ['ignore', 'pipe', 'pipe'] });
      } catch (error) {
        return error.stderr;
      }
      return claim(false, `femc view shows ${name}`);
    };
    const damaged = terminal('damaged.paths', (bytes) => bytes.fill(0x55, bytes.length >> 1, (bytes.length >> 1) + 64));
    console.log(`        terminal: ${clean(damaged)}`);
    claim(/damaged\.paths/.test(damaged) && /damaged|checksum/.test(damaged), `a damaged file: ${damaged}`);
    const short = terminal('short.paths', (bytes) => bytes.fill(0, 100));
    claim(/short\.paths/.test(short), `a file of zeros: ${short}`);
    const none = (() => {
      try {
        return execFileSync(program(), ['view', 'nothing.paths', '--no-browser'], { cwd: farm.folder, encoding: 'utf8', timeout: 20_000, stdio: ['ignore', 'pipe', 'pipe'] });
      } catch (error) {
        return error.stderr;
      }
    })();
    claim(/nothing\.paths/.test(none), `a missing file: ${none}`);
    claim(/--stats/.test(damaged), `what to do about a damaged file: ${damaged}`);
  });

  await step('light: no light and damaged light on the page', async () => {
    await begin();
    let page = await shown(farm);
    await page.goto(`/jobs/${jobs.plain}/light`);
    await page.getByText('submit it with --stats').waitFor();
    await accessible('a job without light', page);

    // On the page: a file that is damaged after the command began.
    copyFileSync(join(farm.folder, files.gallery), join(farm.folder, 'later.paths'));
    const later = await view(farm, 'later.paths');
    try {
      const bytes = readFileSync(join(farm.folder, 'later.paths'));
      bytes.fill(0x55, bytes.length >> 1, (bytes.length >> 1) + 64);
      writeFileSync(join(farm.folder, 'later.paths'), bytes);
      await page.context().close();
      page = await shown({ url: later.url });
      await page.goto(later.address);
      await page.getByText('The recorded light cannot be shown').waitFor();
      const text = clean(await page.locator('.light .empty').innerText());
      console.log(`        page: ${text}`);
      claim(/damaged: |checksum mismatch/.test(text), `the page says what is wrong: ${text}`);
      claim(/Render the frame again|render/i.test(text), `the page says what to do: ${text}`);
      await accessible('a damaged file', page);
      await page.context().close();
    } finally {
      await farm.kill(later.child);
    }

    // A damaged result of the farm.
    const { frames } = await (await fetch(`${farm.url}/api/v1/jobs/${jobs.pendant}/frames`)).json();
    const stats = frames[0].outputs.find((it) => /stat|paths/.test(it.role));
    claim(stats, `roles: ${frames[0].outputs.map((it) => it.role)}`);
    claim(farm.damage(stats.digest), 'the statistics lie in the store');
    page = await shown(farm);
    await page.goto(`/jobs/${jobs.pendant}/light`);
    const told = await until(async () => {
      const text = clean(await page.locator('.light').innerText());
      return /damaged|cannot be shown|paths recorded/.test(text) && text;
    }, 'the page answers', 20);
    console.log(`        page of the job: ${told.slice(0, 300)}`);
    await page.context().close();
  });

  await step('light: the tab while the frame is rendered, and a worker killed meanwhile', async () => {
    await begin();
    const page = await shown(farm);
    const options = ['--size', '160x120', '--spp', process.env.LIGHT_SPP ?? '256', '--stats'];
    const job = farm.submit('gallery.mgf', ...options);
    await page.goto(`/jobs/${job}/light`);
    const it = new Light(page, { api: `/api/v1/jobs/${job}/light`, frames: '1', folder: farm.folder, file: '' });
    await page.locator('[data-totals]').waitFor({ timeout: 120_000 });
    const totals = async () => clean(await page.locator('[data-totals]').innerText());
    claim(/samples so far/.test(await totals()), `it grows: ${await totals()}`);
    await it.shown();
    await it.brush('paths', 'pixel.x', 0.2, 0.7);
    await until(() => /^pixel\.x/.test(it.where), 'a brush', 5);
    const where = it.where;
    await it.category('intersections', 'object');
    await until(() => it.where.includes('any(object'), 'a category', 5);
    const text = it.where;
    claim(text.startsWith(where), 'the brush stays');
    const seen = [];
    let killed = false;
    let shot = false;
    await until(async () => {
      const [state, now] = [farm.job(job).state, await totals()];
      equal(it.where, text, 'the selection while the data grow');
      const counts = await it.counts();
      const recorded = number(/([\d,]+) paths recorded/.exec(now)?.[1] ?? '0');
      if (seen.at(-1)?.recorded !== recorded) seen.push({ recorded, samples: /([\d.]+ ?[kM]?) samples/.exec(now)?.[1], d: /D ([\d.e-]+)/.exec(now)?.[1], selected: counts?.paths });
      if (images && seen.length > 2 && !shot && /so far/.test(now) && counts) {
        shot = true;
        await page.setViewportSize({ width: 1360, height: 1100 });
        await page.mouse.move(700, 4);
        await page.locator('[data-totals]').evaluate((at) => {
          for (let it = at; it; it = it.parentElement) it.scrollTop = 0;
        });
        await images(page, 'light-growing');
      }
      if (!killed && seen.length > 2) {
        killed = true;
        await farm.kill(farm.workers.get('light-b'));
      }
      return state === 'done';
    }, 'the frame is done', 400);
    console.log(`        ${seen.length} moments: ${seen.map(({ samples, recorded, d }) => `${samples} (${recorded}, D ${d})`).join(', ')}`);
    claim(seen.length >= 3, 'the data grew on the page');
    claim(killed, 'a worker was killed meanwhile');
    await until(async () => !/so far/.test(await totals()), 'the page says that the frame is finished', 20);
    farm.femc('fetch', String(job), '-o', 'fetched-growing');
    it.file = join('fetched-growing', readdirSync(join(farm.folder, 'fetched-growing')).find((name) => name.endsWith('.paths')));
    equal(it.where, text, 'the selection at the end');
    await it.agree(claim, 'the finished frame');
    const schema = await it.ask('schema');
    claim((await totals()).includes(`${schema.recorded.toLocaleString('en-US')} paths recorded`), 'totals at the end');
    equal(schema.growing, false, 'growing');
    await page.context().close();
  });
  await gone();
}
