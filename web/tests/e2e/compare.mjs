/** Two scenes compared: numbers, pictures, boxes and voxels, over a farm and over `femc view`; the studies of the manual. */
import { copyFileSync, mkdirSync, readdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { chromium } from 'playwright-core';
import { Farm, pause, root, until } from './farm.mjs';
import { view } from './light.mjs';

/** A browser that draws with WebGL2, in software. */
const GRAPHICS = ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const FLAGS = ['--no-sandbox', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'];
const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };
/** Boxes around plants of scenes/plants.mgf. */
const BOXES = { p1: '-1.5,-0.35,0.87,-0.9,0.35,1.4', p3: '-0.3,-0.35,0.87,0.3,0.35,1.4' };

/** Parses CSV with a header line. */
function parseCsv(text) {
  const [head, ...lines] = text.trim().split('\n').map((line) => {
    const cells = [];
    for (const [, quoted, plain] of line.matchAll(/(?:^|,)(?:"((?:[^"]|"")*)"|([^,]*))/g)) cells.push(quoted?.replaceAll('""', '"') ?? plain);
    return cells;
  });
  return lines.map((cells) => Object.fromEntries(head.map((name, i) => [name, cells[i] ?? ''])));
}

/** Reason why two tables differ; null: they are equal, except for the last digits of numbers. */
function difference(page, command) {
  const keyOf = (row) => `${row.by} ${row.name}`;
  const listed = new Map(command.map((row) => [keyOf(row), row]));
  const own = page.filter((row) => row.by !== 'box');
  if (own.length !== command.length) return `${own.length} rows on the page, ${command.length} by the command`;
  for (const row of own) {
    const other = listed.get(keyOf(row));
    if (!other) return `the command has no row ${keyOf(row)}`;
    for (const [name, cell] of Object.entries(row)) {
      if (!(name in other)) return `the command has no column ${name}`;
      const [a, b] = [cell, other[name]];
      const isNear = a !== '' && b !== '' && Math.abs(Number(a) - Number(b)) <= 1e-6 * Math.abs(Number(b)) + 1e-12;
      if (a !== b && !isNear) return `${keyOf(row)}, ${name}: ${a}, not ${b}`;
    }
  }
  return null;
}

class Numbers {
  constructor(page) {
    this.page = page;
  }
  get section() {
    return this.page.getByRole('region', { name: 'Numbers', exact: true });
  }
  query(key) {
    return new URL(this.page.url()).searchParams.get(key);
  }
  async ready() {
    await this.page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await this.page.locator('[data-numbers=ready]').waitFor({ timeout: 30_000 });
  }
  /** Text of the cells of a row. */
  async cells(name) {
    const row = this.section.locator(`tr[data-row="${name}"]`);
    return (await row.locator('th, td').allInnerTexts()).map((it) => it.replace(/\s+/g, ' ').trim());
  }
  async rows() {
    return this.section.locator('tbody tr[data-row]').evaluateAll((all) => all.map((it) => it.dataset.row));
  }
  /** The copied table. */
  async csv() {
    await this.section.getByRole('button', { name: 'Copy as CSV' }).click();
    return parseCsv(await this.page.evaluate(() => navigator.clipboard.readText()));
  }
  /** The command that the page copies. */
  async command() {
    await this.section.getByRole('button', { name: 'Copy as command' }).click();
    return this.page.evaluate(() => navigator.clipboard.readText());
  }
  by(label) {
    return this.section.getByRole('group', { name: 'Rows of the table' }).getByRole('button', { name: label, exact: true });
  }
}

export async function compare({ step, open, claim, equal, accessible, current, shotsAt }) {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: [...FLAGS, ...GRAPHICS],
  });
  const farm = await Farm.start();
  const jobs = {};
  const files = {};
  let server, begun;
  // The pictures of the manual have the sizes of its commands.
  const film = shotsAt ? [160, 100] : [96, 60];
  const size = ['--size', film.join('x'), '--spp', shotsAt ? (process.env.STUDY_SPP ?? '512') : '256', '--stats', '--set', 'camera.main.fov=27'];
  const lamps = { two: 'object.lamps.five.hidden=1', five: 'object.lamps.two.hidden=1' };
  const hidden = { none: ['reflector'], side: ['reflector.end', 'reflector.bench'], end: ['reflector.side', 'reflector.bench'], bench: ['reflector.side', 'reflector.end'] };
  const sets = (of, sheet = 'none') => ['--set', lamps[of], ...hidden[sheet].flatMap((it) => ['--set', `object.${it}.hidden=1`])];

  const begin = () => (begun ??= prepare());
  async function prepare() {
    await farm.coordinator();
    for (const name of ['compare-a', 'compare-b']) farm.worker(name);
    const plants = (name, ...more) => farm.submit('plants.mgf', ...size, ...sets(...more), '--name', name);
    jobs.two = plants('two', 'two');
    jobs.five = plants('five', 'five');
    jobs.sheet = plants('sheet', 'five', 'bench');
    jobs.box = farm.submit('cornell.mgf', '--size', '32x32', '--spp', '16', '--stats');
    jobs.drive = farm.submit('roundabout.mgf', '--size', '32x20', '--spp', '4', '--stats', '--frames', '1..2');
    jobs.plain = farm.submit('cornell.mgf', '--size', '16x16', '--spp', '2');
    const scene = join(root, 'scenes/cornell.mgf');
    writeFileSync(
      join(farm.folder, 'panels.toml'),
      `scene = "${scene}"\nsize = "24x24"\nspp = 8\nstats = true\n[sweep]\n"material.panel.ed" = [1150, 2300, 4600]\n`,
    );
    farm.femc('sweep', 'panels.toml');
    const all = () => JSON.parse(farm.femc('jobs', '--json'));
    await until(() => all().every((it) => it.state === 'done'), 'all jobs are done', shotsAt ? 1500 : 400);
    jobs.panels = all().filter((it) => /panel|ed=/.test(it.name)).map((it) => it.job).sort((x, y) => x - y);
    claim(jobs.panels.length === 3, `variants: ${JSON.stringify(all().map((it) => it.name))}`);
    for (const name of ['two', 'five', 'sheet', 'box']) {
      farm.femc('fetch', String(jobs[name]), '-o', `fetched-${name}`);
      const fetched = (end) => readdirSync(join(farm.folder, `fetched-${name}`)).find((it) => it.endsWith(end));
      files[name] = { paths: join(`fetched-${name}`, fetched('.paths')), exr: join(`fetched-${name}`, fetched('.exr')) };
      copyFileSync(join(farm.folder, files[name].paths), join(farm.folder, `${name}.paths`));
    }
    server = await view(farm, 'two.paths', 'five.paths');
  }
  const openings = {
    async view(options = {}) {
      const page = current(await open({ url: server.url }, { by: browser, ...options }));
      await page.context().grantPermissions(['clipboard-read', 'clipboard-write'], { origin: server.url });
      await page.goto(server.address);
      await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
      return new Numbers(page);
    },
    async farm(options = {}) {
      const page = current(await open(farm, { by: browser, ...options }));
      await page.context().grantPermissions(['clipboard-read', 'clipboard-write'], { origin: farm.url });
      return new Numbers(page);
    },
  };
  /** Address of data sets: A, and B. */
  const home = (where, a = 'two', b = 'five') =>
    where === 'view' ? `/view?b=${b === 'five' ? 1 : ''}` : `/jobs/${jobs[a]}/light?b=${b ? `${jobs[b]}/1` : ''}`;
  const table = (a, b, ...more) =>
    parseCsv(farm.femc('paths', `${a}.paths`, '--by', 'object,bounce,lamp', ...(b ? ['--minus', `${b}.paths`] : []), ...more, '--csv'));
  const targets = {};

  for (const where of ['view', 'farm']) {
    const on = (name, run) => step(`compare: ${where}: ${name}`, async () => {
      await begin();
      const it = (targets[where] ??= await openings[where]());
      current(it.page);
      await it.page.goto(home(where));
      await it.page.locator('[data-totals]').waitFor({ timeout: 60_000 });
      await run(it, it.page);
    });

    await on('the numbers are those of femc paths --by, with and without a selection', async (it, page) => {
      await page.getByRole('button', { name: 'Numbers', exact: true }).click();
      await it.ready();
      equal(it.query('numbers'), 'open', 'the address');
      const fault = difference(await it.csv(), table('two', 'five'));
      claim(fault === null, fault);
      const command = await it.command();
      claim(/^femc paths two(\.0001)?\.paths --by object --minus five(\.0001)?\.paths$/.test(command), `the command: ${command}`);
      // The lamps of A are not in B.
      await it.by('by lamp').click();
      const names = await it.rows();
      claim(names.some((name) => /lamps\.two/.test(name)) && names.some((name) => /lamps\.five/.test(name)), `lamps: ${names}`);
      // A row adds its condition to the selection.
      await it.by('by object').click();
      await it.section.getByRole('button', { name: 'leaves.p1', exact: true }).click();
      await until(() => it.query('where') === 'object == leaves.p1', `a row selects: ${it.query('where')}`, 5);
      await it.ready();
      await until(async () => difference(await it.csv(), table('two', 'five', '--where', 'object == leaves.p1')) === null, 'the numbers follow the selection', 10);
      const [all] = table('two', null, '--where', 'object == leaves.p1');
      const cells = await it.cells('all');
      equal(cells.at(-2).replace(/,/g, ''), all.paths, 'paths of A');
      const share = Number((await page.locator('[aria-label=Selection]').innerText()).match(/([\d.]+) % of the light/)?.[1] ?? NaN);
      const [whole] = table('two', null);
      if (Number.isFinite(share)) claim(Math.abs(share - (100 * all.light) / whole.light) < 0.06, `the share of the selection: ${share}`);
    });

    await on('pictures are compared as by femc compare', async (it, page) => {
      await page.goto(`${home(where)}&numbers=open`);
      await it.ready();
      const line = page.locator('[data-pictures]');
      await until(async () => /Mean A/.test(await line.innerText()), 'the errors of the pictures', 20);
      const text = await line.innerText();
      const number = (word) => Number(new RegExp(`${word} ([\\d.e+-]+[\\d])`).exec(text)?.[1]);
      if (where === 'farm') {
        const due = JSON.parse(farm.femc('compare', files.two.exr, files.five.exr, '--json'));
        for (const [word, value] of [['mean B', due.mean_ratio], ['mse', due.mse], ['ssim', due.ssim], ['flip', due.flip]])
          claim(Math.abs(number(word) - value) <= 2e-3 * Math.abs(value), `${word}: ${number(word)}, not ${value}: ${text}`);
        claim(!/no images/.test(text), text);
      } else {
        claim(/Files have no images: these are the mean luminances of all samples/.test(text), text);
        const due = JSON.parse(farm.femc('compare', files.two.exr, files.five.exr, '--json'));
        claim(Math.abs(number('mean B') - due.mean_ratio) < 0.02 * due.mean_ratio, `mean ratio ${number('mean B')}, not about ${due.mean_ratio}`);
      }
      // The recorded paths estimate the same ratio.
      const [all] = table('two', 'five');
      claim(Number(all.ratio_low) - 0.01 < number('mean B') && number('mean B') < Number(all.ratio_high) + 0.01, `${all.ratio_low} .. ${all.ratio_high} contains ${number('mean B')}`);
    });

    await on('pictures side by side move together; a slider is dragged by mouse and keys', async (it, page) => {
      const picture = page.locator('[aria-label=Picture]').first();
      const choose = (name) => picture.getByRole('group', { name: 'Picture of' }).getByRole('button', { name, exact: true }).click();
      await choose('A | B');
      await until(() => it.query('set') === 'slider', 'the address', 5);
      const slider = picture.getByLabel('Left edge of the second frame');
      await slider.focus();
      await page.keyboard.press('Home');
      await until(() => it.query('split') === '0', `the keyboard: ${it.query('split')}`, 5);
      const box = await slider.boundingBox();
      await page.mouse.click(box.x + 0.75 * box.width, box.y + box.height / 2);
      await until(() => Math.abs(Number(it.query('split')) - 75) < 6, `the mouse: ${it.query('split')}`, 5);
      const [a, b] = await picture.locator('.film canvas').evaluateAll((all) => all.map((it) => it.toDataURL()));
      claim(b && a !== b, 'two pictures under the slider');
      await choose('A, B');
      await until(async () => (await picture.locator('.host').count()) === 2, 'two stages', 5);
      const films = () => picture.locator('.host .film').evaluateAll((all) => all.map((it) => [it.style.width, it.style.left, it.style.top].join(' ')));
      const before = await films();
      equal(before[0], before[1], 'both films begin alike');
      await picture.locator('.host').nth(1).getByRole('button', { name: 'Zoom in' }).click();
      await picture.locator('.host').nth(1).getByRole('button', { name: 'Zoom in' }).click();
      await until(async () => (await films())[0] !== before[0], 'the picture of A zooms with that of B', 5);
      const host = await picture.locator('.host').first().boundingBox();
      await page.mouse.move(host.x + host.width / 2, host.y + host.height / 2);
      for (let i = 0; i < 6; i++) await page.mouse.wheel(0, -100);
      await page.mouse.down();
      await page.mouse.move(host.x + host.width / 2 - 60, host.y + host.height / 2 - 20, { steps: 4 });
      await page.mouse.up();
      await until(async () => { const [x, y] = await films(); return x === y && x !== before[0]; }, 'both move together', 5);
      const shown = await picture.locator('.host .film canvas').evaluateAll((all) => all.map((it) => it.toDataURL()));
      equal(shown[0], a, 'the picture of A');
      equal(shown[1], b, 'the picture of B');
      await page.getByLabel('Show', { exact: true }).selectOption('depth');
      await until(() => it.query('show') === 'depth', 'a map', 5);
      await until(async () => new Set(await picture.locator('.host .film canvas').evaluateAll((all) => all.map((it) => it.toDataURL()))).size === 2, 'maps of both', 10);
    });

    await on('boxes, one for each data set: drawn, dragged, and compared in numbers', async (it, page) => {
      await page.goto(`${home(where)}&scene=open&numbers=open&boxa=${BOXES.p1}&boxb=${BOXES.p3}`);
      await page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
      await it.ready();
      await it.by('in boxes').click();
      const inA = table('two', null, `--in=${BOXES.p1}`)[0];
      const inB = table('five', null, `--in=${BOXES.p3}`)[0];
      const row = async () => (await it.csv()).find((cells) => cells.by === 'box');
      await until(async () => (await row()) !== undefined, 'the row of the boxes', 10);
      const box = await row();
      for (const name of ['paths', 'light', 'records', 'energy', 'per_path', 'light_error', 'energy_error']) {
        claim(Math.abs(box[name] - inA[name]) <= 1e-6 * inA[name], `${name} of box A: ${box[name]}, not ${inA[name]}`);
        claim(Math.abs(box[`${name}_there`] - inB[name]) <= 1e-6 * inB[name], `${name} of box B: ${box[`${name}_there`]}, not ${inB[name]}`);
      }
      equal((await it.section.locator('table[data-table=box] tbody tr').count()), 3, 'measures of the boxes');
      // The selection keeps its own box.
      const fields = page.getByRole('group', { name: 'Box in the scene' });
      const kinds = page.getByRole('group', { name: 'Box of' });
      await kinds.getByRole('button', { name: 'A', exact: true }).click();
      const field = page.getByLabel('Box in the scene, upper z');
      equal(await field.inputValue(), '1.4', 'the corner of box A');
      await field.fill('1.2');
      await field.press('Enter');
      await until(() => it.query('boxa') === '-1.5,-0.35,0.87,-0.9,0.35,1.2', `a number moves a face of box A: ${it.query('boxa')}`, 5);
      equal(it.query('boxb'), BOXES.p3, 'box B stays');
      equal(it.query('where'), null, 'the selection stays');
      // The middle of box A is in the middle of the view: its handle is there.
      await page.goto(`${home(where)}&scene=open&numbers=open&boxof=a&boxa=${BOXES.p1}&boxb=${BOXES.p3}&by=box&eye=-1.2,0,1.135,2.5,-1.2,0.2,0.7`);
      await page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
      const canvas = page.locator('.scene canvas').first();
      await canvas.scrollIntoViewIfNeeded();
      const place = await canvas.boundingBox();
      const [x, y] = [place.x + place.width / 2, place.y + place.height / 2];
      await page.mouse.move(x, y);
      await page.mouse.down();
      await page.mouse.move(x + 25, y, { steps: 4 });
      await page.mouse.up();
      await until(() => it.query('boxa') !== BOXES.p1, 'a drag moves box A', 5);
      const moved = it.query('boxa').split(',').map(Number);
      const start = BOXES.p1.split(',').map(Number);
      for (let k = 0; k < 3; k++) claim(Math.abs(moved[k + 3] - moved[k] - (start[k + 3] - start[k])) < 0.02, `the size stays: ${moved}`);
      await until(async () => Math.abs((await row()).paths - table('two', null, `--in=${it.query('boxa')}`)[0].paths) < 0.5, 'the numbers follow the drag', 10);
      await fields.getByRole('button', { name: 'Remove the box' }).click();
      await until(() => it.query('boxa') === null, 'box A is removed', 5);
    });

    await on('one cube for the voxels of both', async (it, page) => {
      await page.goto(`${home(where)}&scene=open&layers=voxels&voxelset=difference`);
      await page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
      const said = page.locator('[data-cube]');
      await said.waitFor();
      const [a, b] = ['two', 'five'].map((name) => {
        const rows = parseCsv(farm.femc('paths', `${name}.paths`, '--table', 'histograms', '--csv'));
        return rows.length;
      });
      claim(a > 0 && a === b, 'tables of both');
      claim(/one cube of|One cube of/.test(await said.innerText()), await said.innerText());
    });

    for (const theme of ['light', 'dark'])
      await step(`compare: ${where}: axe in ${theme}`, async () => {
        await begin();
        const it = await openings[where]({ colorScheme: theme });
        await it.page.goto(`${home(where)}&numbers=open&set=both&scene=open&boxa=${BOXES.p1}&boxb=${BOXES.p3}&by=box&boxof=b`);
        await it.ready();
        await it.page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
        await accessible(`boxes compared in ${theme}`, it.page);
        await it.page.goto(`${home(where)}&numbers=open&set=slider`);
        await it.ready();
        await accessible(`numbers in ${theme}`, it.page);
        if (shotsAt) await it.section.screenshot({ path: join(shotsAt, `numbers-${where}-${theme}.png`) });
        await it.page.context().close();
      });

    await step(`compare: ${where}: a small screen, by fingers and by keys`, async () => {
      await begin();
      const it = await openings[where](PHONE);
      const { page } = it;
      await page.goto(home(where));
      await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
      await page.getByRole('button', { name: 'Numbers', exact: true }).tap();
      await it.ready();
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      claim(wide <= 0, `${wide} pixels too wide`);
      await it.by('by lamp').tap();
      await until(() => it.query('by') === 'lamp', 'rows by a tap', 5);
      const scroll = it.section.getByRole('region', { name: 'Table of light' });
      claim(await scroll.evaluate((s) => s.scrollWidth > s.clientWidth), 'the table scrolls sideways');
      await scroll.focus();
      await page.keyboard.press('ArrowRight');
      await until(async () => (await scroll.evaluate((s) => s.scrollLeft)) > 0, 'keys scroll the table', 5);
      await it.by('by bounce').focus();
      await page.keyboard.press('Enter');
      await until(() => it.query('by') === 'bounce', 'rows by a key', 5);
      await it.section.getByLabel('only what differs').focus();
      await page.keyboard.press('Space');
      await until(() => it.query('marked') === 'yes', 'a filter by a key', 5);
      const picture = page.locator('[aria-label=Picture]').first();
      await picture.getByRole('button', { name: 'A | B', exact: true }).tap();
      const slider = picture.getByLabel('Left edge of the second frame');
      await slider.evaluate((s) => s.scrollIntoView({ block: 'center' }));
      const box = await slider.boundingBox();
      await page.touchscreen.tap(box.x + 0.25 * box.width, box.y + box.height / 2);
      await until(() => Math.abs(Number(it.query('split')) - 25) < 8, `the slider by a tap: ${it.query('split')}`, 5);
      await accessible('numbers at 390 pixels', page);
      if (shotsAt) await it.section.screenshot({ path: join(shotsAt, `numbers-${where}-small.png`) });
      await page.context().close();
    });
  }

  await step('compare: B is chosen among frames, variants of a sweep, and other jobs', async () => {
    await begin();
    const it = (targets.farm ??= await openings.farm());
    const { page } = it;
    current(page);
    await page.goto(`/jobs/${jobs.panels[0]}/light?numbers=open`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    const menu = page.getByLabel('Compare with');
    const groups = await menu.locator('optgroup').evaluateAll((all) => all.map((it) => [it.label, [...it.children].map((o) => o.textContent)]));
    const variants = Object.fromEntries(groups)['variants of this sweep'];
    claim(variants?.length === 2 && variants.every((it) => /^ed=(2300|4600), frame 1 \(job \d+\)$/.test(it)), `variants: ${JSON.stringify(groups)}`);
    claim(Object.fromEntries(groups)['other jobs']?.length >= 4, `other jobs: ${JSON.stringify(groups)}`);
    await menu.selectOption({ label: variants.find((it) => it.startsWith('ed=4600')) });
    await it.ready();
    await until(async () => (await it.cells('all')).length > 9, 'the numbers of both', 10);
    const [name, a, , b, , , , ratio] = await it.cells('all');
    equal(name, 'all', 'the first row');
    claim(Math.abs(Number(ratio) - 0.25) < 0.12, `a quarter of the light: ${a}, ${b}, ${ratio}`);
    // Two frames of a job.
    await page.goto(`/jobs/${jobs.drive}/light?numbers=open&frame=1`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    await menu.selectOption({ label: 'frame 2' });
    await until(() => it.query('b') === `${jobs.drive}/2`, 'another frame', 5);
    await it.ready();
    await until(async () => (await it.cells('all')).length > 9, 'the numbers of both frames', 10);
  });

  await step('compare: a job without statistics, one without geometry, and other boxes', async () => {
    await begin();
    const it = (targets.farm ??= await openings.farm());
    const { page } = it;
    current(page);
    await page.goto(`/jobs/${jobs.two}/light?numbers=open&b=${jobs.plain}/1`);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    const refused = page.getByText(/cannot be compared: /);
    await refused.waitFor();
    console.log(`        without statistics: ${(await refused.innerText()).replace(/\s+/g, ' ')}`);
    claim(/--stats|no light statistics/.test(await refused.innerText()), await refused.innerText());
    await it.ready();
    claim((await it.cells('all')).length < 8, 'the numbers of A alone');
    // Another scene: other boxes.
    await page.goto(`/jobs/${jobs.two}/light?scene=open&layers=voxels&voxelset=difference&b=${jobs.box}/1&numbers=open`);
    await page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
    await page.locator('[data-cube]').waitFor();
    const cube = await page.locator('[data-cube]').innerText();
    console.log(`        two boxes: ${cube}`);
    claim(/The boxes of A and B (differ|have no place in common)/.test(cube), cube);
    await until(async () => (await page.locator('[data-pictures]').innerText()).includes(`A has ${film.join(' × ')} pixels, B 32 × 32`), 'films differ', 10);
    console.log(`        films: ${await page.locator('[data-pictures]').innerText()}`);
    // A job from before has no geometry; one above the limit has boxes.
    await page.route('**/geometry?*', (route) => route.fulfill({ status: 404, contentType: 'application/json', body: '{"error":{"code":"not_found","message":"no geometry"}}' }));
    await page.goto(`/jobs/${jobs.two}/light?scene=open`);
    await page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
    const note = page.locator('[data-geometry=none]');
    await note.waitFor();
    console.log(`        before geometry: ${await note.innerText()}`);
    await page.unroute('**/geometry?*');
  });

  await step('compare: a scene above the limit of triangles', async () => {
    await begin();
    // 23 x 23 copies of 2500 squares.
    const mesh = ['m gray =', '\tsides 2', '\trd 0.5', 'm lamp =', '\tsides 1', '\ted 1000', 'm gray', 'xf -a 23 -t 0.2 0 0 -a 23 -t 0 0.2 0', 'o cloth'];
    for (let k = 0; k < 50; k++)
      for (let i = 0; i < 50; i++) {
        const corners = [[i, k], [i + 1, k], [i + 1, k + 1], [i, k + 1]];
        corners.forEach(([x, y], n) => mesh.push(`v v${n} =`, `\tp ${x * 0.003} ${y * 0.003} ${0.01 * Math.sin(0.3 * x) * Math.cos(0.2 * y)}`));
        mesh.push('f v0 v1 v2', 'f v0 v2 v3');
      }
    mesh.push('o', 'xf', 'm lamp', 'o sun', 'v a =', '\tp 1 1 4', 'v b =', '\tp 1 3 4', 'v c =', '\tp 3 3 4', 'v d =', '\tp 3 1 4', 'f a b c d', 'o');
    mesh.unshift('camera main =', '\torigin 2.3 -3 4', '\ttarget 2.3 2.3 0', '\tfov 50', '\tfilm 32 20');
    writeFileSync(join(farm.folder, 'cloth.mgf'), mesh.join('\n') + '\n');
    const out = farm.femc('submit', 'cloth.mgf', '--size', '32x20', '--spp', '8', '--stats');
    const job = Number(out.trim().split('\n').at(-1));
    await until(() => farm.job(job).state === 'done', 'the job is done', 300);
    const it = (targets.farm ??= await openings.farm());
    const { page } = it;
    current(page);
    await page.goto(`/jobs/${job}/light?scene=open`);
    await page.locator('[data-scene=ready]').waitFor({ timeout: 120_000 });
    const said = await page.locator('[data-geometry]').innerText();
    console.log(`        above the limit: ${said}`);
    claim(/objects? with too many triangles (are|is) shown as (boxes|a box)/.test(said), said);
  });

  // ---- Studies of the manual
  const studies = shotsAt && (async (name, address, { height = 1000, wait = async () => {}, at = 'Numbers' } = {}) => {
    const page = current(await open(farm, { by: browser, viewport: { width: 1360, height } }));
    await page.goto(address);
    await page.locator('[data-totals]').waitFor({ timeout: 60_000 });
    if (/scene=open/.test(address)) await page.locator('[data-scene=ready]').waitFor({ timeout: 60_000 });
    if (/numbers=open/.test(address)) await page.locator('[data-numbers=ready]').waitFor({ timeout: 30_000 });
    await wait(page);
    await pause(2500);
    await page.getByRole('region', { name: at, exact: true }).evaluate((it) => {
      it.scrollIntoView({ block: 'start' });
      // Only the page within the header scrolls.
      for (const outer of [document.documentElement, document.body, document.getElementById('app')]) outer.scrollTop = 0;
    });
    await page.mouse.move(700, 4);
    await pause(500);
    mkdirSync(shotsAt, { recursive: true });
    await page.screenshot({ path: join(shotsAt, `${name}.png`) });
    await page.context().close();
  });
  if (studies) {
    await step('compare: pictures of the studies', async () => {
      await begin();
      const eye = 'eye=0,0,0.95,3.6,-0.9,0.35,0.7';
      const leaves = `where=${encodeURIComponent('bounce == 0 and object == leaves')}`;
      const boxes = (a, b) => `boxa=${BOXES[a]}&boxb=${BOXES[b]}&by=box&boxof=a`;
      const lampsOnly = 'scene=open&numbers=open&layers=surfaces,voxels&voxelset=difference&level=6&threshold=20';
      await studies('study-lamps', `/jobs/${jobs.two}/light?b=${jobs.five}/1&${lampsOnly}&${boxes('p3', 'p3')}&${eye}&${leaves}`, { at: 'Scene', height: 1240 });
      await studies('study-reflector', `/jobs/${jobs.sheet}/light?b=${jobs.five}/1&numbers=open&set=slider&split=52`, { at: 'Picture', height: 1040 });
      await studies('study-place', `/jobs/${jobs.five}/light?scene=open&numbers=open&layers=surfaces,points&${boxes('p3', 'p1')}&${eye}&${leaves}`, { at: 'Scene', height: 1060 });
      await studies('light-numbers', `/jobs/${jobs.two}/light?b=${jobs.five}/1&numbers=open`, { at: 'Numbers', height: 620 });
    });
  }

  for (const { page } of Object.values(targets)) await page.context().close().catch(() => {});
  if (server) await farm.kill(server.child);
  await farm.end();
  await browser.close();
}
