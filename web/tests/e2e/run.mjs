/**
 * The pages over a real farm: a coordinator and three workers, in Chromium.
 *
 *     node tests/e2e/run.mjs [--shots FOLDER] [WORD]   # only steps with this word in their names
 *
 * FEMC names the program, CHROMIUM the browser; FEMC_KEEP=1 leaves the farm's folder for a look. FEMC_PAGES is a folder of built pages
 * that take the place of those in the program.
 */
import { existsSync, mkdirSync } from 'node:fs';
import { join } from 'node:path';
import axe from 'axe-core';
import { chromium } from 'playwright-core';
import { compare } from './compare.mjs';
import { Farm, pause, until } from './farm.mjs';
import { files } from './files.mjs';
import { hands } from './hands.mjs';
import { light } from './light.mjs';
import { numbers } from './numbers.mjs';
import { scene } from './scene.mjs';
import { slow } from './slow.mjs';
import { tabs } from './tabs.mjs';

const args = process.argv.slice(2);
const shotsAt = args.includes('--shots') ? args.splice(args.indexOf('--shots'), 2)[1] : null;
const only = args[0] ?? '';
if (shotsAt) mkdirSync(shotsAt, { recursive: true });

let failures = 0;
let steps = 0;
const claim = (holds, what) => {
  if (!holds) throw new Error(what);
};
const equal = (is, due, what) =>
  claim(Object.is(is, due), `${what}: ${JSON.stringify(is)}, not ${JSON.stringify(due)}`);

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  // Browsers of people keep pages for the way back.
  ignoreDefaultArgs: ['--disable-back-forward-cache'],
  args: [
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
  ],
});

/**
 * Faults that a page may have at any time: errors of scripts, what the content security policy refuses, other
 * servers.
 */
const faults = [];

async function open(farm, { dark = false, by = browser, ...more } = {}) {
  const context = await by.newContext({
    viewport: { width: 1360, height: 800 },
    colorScheme: dark ? 'dark' : 'light',
    baseURL: farm.url,
    ...more,
  });
  if (process.env.FEMC_PAGES)
    await context.route((url) => url.origin === new URL(farm.url).origin && !url.pathname.startsWith('/api/'), (route) => {
      if (route.request().method() !== 'GET') return route.continue();
      const path = join(process.env.FEMC_PAGES, new URL(route.request().url()).pathname);
      return route.fulfill({ path: /\.\w+$/.test(path) && existsSync(path) ? path : join(process.env.FEMC_PAGES, 'index.html') });
    });
  const page = await context.newPage();
  page.on('pageerror', (error) => faults.push(`error of a script: ${error.message}`));
  page.on('console', (message) => {
    const text = message.text();
    // A coordinator that is gone or refuses is what some steps are about.
    if (message.type() === 'error' && !/Failed to load resource|net::ERR/.test(text)) faults.push(`console: ${text}`);
  });
  page.on('request', (request) => {
    if (!request.url().startsWith(farm.url) && !request.url().startsWith('blob:'))
      faults.push(`asked another server: ${request.url()}`);
  });
  return page;
}

async function step(name, run) {
  // The steps of light, of the scene and of comparisons have a farm of their own: `run light:` makes only these.
  if (!name.includes(only) && (!name.startsWith('begin') || /^(light|scene|compare):/.test(only))) return;
  const began = Date.now();
  steps++;
  try {
    await run();
    const seen = faults.splice(0);
    if (seen.length) throw new Error(seen.slice(0, 3).join('\n    '));
    console.log(`ok      ${name} (${((Date.now() - began) / 1000).toFixed(1)} s)`);
  } catch (error) {
    failures++;
    faults.length = 0;
    console.log(`FAILED  ${name}\n    ${error.message}`);
    await current?.screenshot({ path: join(shotsAt ?? farm.folder, `failed-${failures}.png`) }).catch(() => {});
  }
}

let current;
const shot = (name) => (shotsAt ? current.screenshot({ path: join(shotsAt, `${name}.png`) }) : null);
/** Goes to an address within the pages. */
const visit = async (path) => {
  await current.goto(path);
  await current.getByText('live', { exact: true }).waitFor();
};
const query = (key) => new URL(current.url()).searchParams.get(key);

/** In the table of tasks: those of the first stage of this kind. */
async function chooseStage(kind) {
  const option = current.getByLabel('Stage').locator('option', { hasText: kind }).first();
  await current.getByLabel('Stage').selectOption(await option.getAttribute('value'));
  await current.locator('.row.body', { hasText: kind }).first().waitFor();
}

async function accessible(what, page = current) {
  // By the debugger's protocol, which the page's content security policy does not concern.
  const session = await page.context().newCDPSession(page);
  await session.send('Runtime.evaluate', { expression: axe.source });
  const { result } = await session.send('Runtime.evaluate', {
    expression: `axe.run(document, { resultTypes: ['violations'] }).then((it) => JSON.stringify(it.violations.map((v) =>
      v.id + ': ' + v.help + ' at ' + v.nodes.slice(0, 3).map((n) => n.target.join(' ')).join(' | '))))`,
    awaitPromise: true,
    returnByValue: true,
  });
  const violations = JSON.parse(result.value);
  claim(violations.length === 0, `axe on ${what}: ${violations.join('; ')}`);
}

const farm = await Farm.start();
const jobs = {};

await step('begin: a farm of three workers, and the page finds it', async () => {
  await farm.coordinator();
  for (const name of ['node-a', 'node-b', 'node-c']) farm.worker(name);
  jobs.drive = farm.submit(
    'roundabout.mgf',
    '--frames',
    '1..12',
    '--size',
    '128x72',
    '--spp',
    '8',
    '--owner',
    'ann',
    '--priority',
    '60',
  );
  jobs.fog = farm.submit('cornell-fog.mgf', '--size', '64x64', '--spp', '32', '--owner', 'bob');
  jobs.waits = farm.submit('cornell.mgf', '--size', '64x64', '--spp', '4', '--tags', 'gpu', '--owner', 'eve');
  // More tasks than a table could hold, for nobody to do.
  jobs.huge = farm.submit(
    ...['roundabout.mgf', '--frames', '1..96', '--size', '4096x4096'],
    ...['--spp', '4', '--tags', 'nobody', '--owner', 'eve'],
  );
  current = await open(farm);
  await visit('/');
  await current.getByRole('link', { name: 'roundabout' }).first().waitFor();
  await current.getByRole('link', { name: 'Workers 3' }).waitFor();
});

await step('jobs: filter, states, order and groups, all in the address', async () => {
  await visit('/jobs');
  const rows = () => current.locator('.row.body').count();
  equal(await rows(), 4, 'rows');
  await current.keyboard.press('/');
  await current.keyboard.type('owner:eve');
  await until(async () => (await rows()) === 2, 'the filter leaves two jobs');
  await until(() => query('filter') === 'owner:eve', 'filter in the address', 5);
  await current.reload();
  await until(async () => (await rows()) === 2, 'the filter outlives a reload');
  await current.getByLabel('Filter the jobs').fill('');
  await current.getByRole('button', { name: /^Job/ }).click();
  await until(
    async () => (await current.locator('.row.body a').first().textContent()) === 'roundabout',
    'the oldest job comes first',
  );
  await until(() => query('sort') === 'job', 'order in the address', 5);
  // The age: first the oldest, then the youngest, and each is told.
  for (const [order, first] of [
    ['-age', 'roundabout'],
    ['age', 'roundabout'],
  ]) {
    await current.getByRole('button', { name: /^Age/ }).click();
    await until(() => query('sort') === order, `order ${order} in the address`, 5);
    const number = order === '-age' ? jobs.drive : jobs.huge;
    const top = current.locator('.row.body').first();
    await until(async () => (await top.locator('a').getAttribute('href')) === `/jobs/${number}`, `job ${number} first`);
    equal(await top.locator('a').textContent(), first, 'its name');
    const told = await top.locator('[title]').evaluateAll((all) => all.map((it) => it.textContent));
    claim(
      told.some((it) => / s$/.test(it)),
      `its age is told: ${told}`,
    );
  }
  await current.getByLabel('Groups').selectOption('owner');
  await until(async () => (await current.locator('.grouphead').count()) === 3, 'three owners');
  await current.getByRole('button', { name: /eve/ }).click();
  await until(async () => (await rows()) === 5, 'a closed group hides its jobs');
  await accessible('jobs');
});

await step('jobs: several at once are selected by keys, paused, resumed and given a priority', async () => {
  await visit('/jobs?filter=owner:eve');
  await current.locator('[role=table]').focus();
  for (const key of ['ArrowDown', 'x', 'j', 'Shift+X']) await current.keyboard.press(key);
  await current.getByText('2 jobs selected').waitFor();
  await until(() => query('jobs') === `${jobs.waits},${jobs.huge}`, 'selection in the address', 5);
  await current.getByRole('button', { name: 'Pause', exact: true }).click();
  await until(
    () => farm.job(jobs.waits).state === 'paused' && farm.job(jobs.huge).state === 'paused',
    'both jobs are paused',
  );
  await until(
    async () => (await current.locator('.row.body', { hasText: 'paused' }).count()) === 2,
    'the page shows it',
  );
  await current.getByRole('button', { name: 'Resume', exact: true }).click();
  await until(() => farm.job(jobs.waits).state !== 'paused', 'resumed');
  await current.getByLabel('Priority').fill('33');
  await current.getByRole('button', { name: 'Set', exact: true }).click();
  await until(() => farm.job(jobs.waits).priority === 33 && farm.job(jobs.huge).priority === 33, 'priority 33');
  await current.locator('[role=table]').focus();
  await current.keyboard.press('Escape');
  await until(() => query('jobs') === null, 'nothing selected', 5);
});

await step('a job says why it waits', async () => {
  await visit(`/jobs/${jobs.waits}`);
  await current.getByText('no worker has all the tags gpu').waitFor();
  await accessible('a job that waits');
});

await step('frames: thumbnails come, colors change, a drag selects', async () => {
  await visit(`/jobs/${jobs.drive}`);
  await until(() => farm.job(jobs.drive).frames_done >= 12, 'the frames are rendered', 240);
  await until(async () => (await current.locator('.cell.done').count()) === 12, 'twelve frames are done on the page');
  const loaded = () =>
    current.locator('.cell img').evaluateAll((all) => all.filter((img) => img.naturalWidth > 0).length);
  await until(async () => (await loaded()) === 12, 'twelve thumbnails');
  const cell = async (n) => {
    const box = await current.locator(`#frame-${n}`).boundingBox();
    return [box.x + box.width / 2, box.y + box.height / 2];
  };
  await current.mouse.move(...(await cell(3)));
  await current.mouse.down();
  await current.mouse.move(...(await cell(5)), { steps: 4 });
  await current.mouse.move(...(await cell(6)), { steps: 4 });
  await current.mouse.up();
  await until(() => query('frames') === '3..6', 'frames in the address', 5);
  await current.getByText('4 frames selected').waitFor();
  await current.locator('[role=listbox]').press('Escape');
  for (const key of ['Home', ' ']) if (key === ' ') await current.locator('[role=listbox]').press(key);
  await current.locator('[role=listbox]').press('Shift+ArrowRight');
  await until(() => query('frames') !== null, 'keys select frames, too', 5);
  for (const color of ['processor', 'at workers', 'waiting', 'first to last', 'error']) {
    await current.getByLabel('Color by').getByRole('button', { name: color, exact: true }).click();
    await current.locator('.legend').waitFor();
  }
  await accessible('frames');
  for (const size of ['small', 'large', 'middle']) {
    await current.getByRole('button', { name: size, exact: true }).click();
    await until(async () => (await current.locator('.cell').count()) === 12, `twelve cells, ${size}`);
  }
  await visit(`/jobs/${jobs.drive}?color=seconds&frames=3..6`);
  await until(async () => (await loaded()) === 12, 'twelve thumbnails');
});

await step('picture: exposure, false color, error, samples, difference, split, a pixel', async () => {
  await visit(`/jobs/${jobs.drive}?frames=3`);
  await current.locator('#frame-3').dblclick();
  await current.locator('.host canvas').waitFor();
  await until(() => query('frame') === '3', 'frame in the address', 5);
  const lit = () =>
    current
      .locator('.host canvas')
      .first()
      .evaluate((canvas) => {
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        let sum = 0;
        for (let i = 0; i < data.length; i += 4) sum += data[i] + data[i + 1] + data[i + 2];
        return sum / (data.length / 4) / 3;
      });
  const plain = await lit();
  claim(plain > 5, `the picture is black: ${plain}`);
  await current.getByLabel('Exposure').fill('3');
  await until(async () => (await lit()) > plain * 1.2, 'three stops are brighter');
  await until(() => query('ev') === '3', 'exposure in the address', 5);
  await current.getByRole('button', { name: 'Automatic' }).click();
  for (const [name, unit] of [
    ['Luminance', 'cd/m²'],
    ['Pixel error', 'standard error of the pixel'],
    ['Block error', '95 % interval of the block'],
    ['Samples', 'samples per pixel'],
  ]) {
    await current.getByRole('button', { name, exact: true }).click();
    await current.locator('.legend', { hasText: unit }).waitFor();
  }
  const box = await current.locator('.host').boundingBox();
  await current.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  await until(() => /^\d+,\d+$/.test(query('pixel') ?? ''), 'the pixel is in the address', 5);
  await current.getByText(/^Pixel \d+, \d+$/).waitFor();
  claim((await current.locator('aside dd').first().textContent()).includes('cd/m²'), 'its luminance is told');
  const before = query('pixel');
  await current.locator('.host').press('ArrowRight');
  await until(() => query('pixel') !== before, 'arrows move the pin', 5);
  await current.keyboard.down('Shift');
  await current.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await current.mouse.down();
  for (const [dx, dy] of [
    [80, 0],
    [80, 80],
    [0, 80],
  ]) {
    await current.mouse.move(box.x + box.width / 2 + dx, box.y + box.height / 2 + dy, { steps: 6 });
  }
  await current.mouse.up();
  await current.keyboard.up('Shift');
  await until(() => (query('lasso') ?? '').split(';').length >= 4, 'the line around pixels is in the address', 5);
  const chosen = Number((await current.getByText(/^[\d,]+ pixels selected$/).textContent()).replace(/\D/g, ''));
  claim(chosen > 20, `${chosen} pixels chosen`);
  await current.getByLabel('beside').selectOption({ label: 'frame 9' });
  await current.getByLabel('Left edge of the second frame').fill('30');
  await until(() => query('split') === '30', 'the split is in the address', 5);
  await current.getByRole('button', { name: 'Difference', exact: true }).click();
  await current.locator('.legend', { hasText: 'other frame minus this one' }).waitFor();
  await current.getByLabel('Smoothing').fill('2');
  await accessible('the picture');
  await current.goBack();
});

await step('frames: those that are selected are tried again', async () => {
  // Of a job that is done a retry is refused unless an image is damaged: it finds this one, and renders that frame alone.
  const outputs = async (frame) => {
    const { frames } = await (await fetch(`${farm.url}/api/v1/jobs/${jobs.drive}/frames`)).json();
    return frames.find((it) => it.frame === frame);
  };
  for (const frame of [3, 4]) {
    await until(async () => (await outputs(frame))?.state === 'done', `frame ${frame} is rendered`, 120);
  }
  const digest = async (role) => (await outputs(3)).outputs.find((it) => it.role === role).digest;
  const [image, preview] = [await digest('image'), await digest('preview')];
  claim(farm.damage(image), `the image ${image} lies in the store`);
  await visit(`/jobs/${jobs.drive}?frames=3`);
  await current.getByText('1 frame selected').waitFor();
  await current.getByRole('button', { name: 'Check images', exact: true }).click();
  await current.getByText('1 frame retried: 3').waitFor();
  equal((await outputs(4)).state, 'done', 'frame 4');
  await until(async () => (await outputs(3)).state === 'done', 'frame 3 is rendered again', 120);
  // The file of the image says how long it took; that of the picture says nothing of the kind.
  equal(await digest('preview'), preview, 'the picture, to the bit');
});

await step('heat maps of light statistics, where there are any', async () => {
  await visit(`/jobs/${jobs.drive}/picture?frame=6`);
  await current.locator('.host canvas').waitFor();
  claim(await current.getByRole('button', { name: 'Depth', exact: true }).isDisabled(), 'a job without statistics');
  jobs.stats = farm.submit('cornell.mgf', '--size', '48x48', '--spp', '8', '--stats', '--owner', 'stats', '--priority', '95');
  await until(() => farm.job(jobs.stats).state === 'done', 'its statistics are there', 120);
  await visit(`/jobs/${jobs.stats}/picture`);
  await current.locator('.host canvas').waitFor();
  for (const [name, unit] of [
    ['Deviation', 'standard deviation of a sample'],
    ['Throughput', 'throughput at the end of a path'],
    ['Depth', 'intersections per path'],
  ]) {
    await current.getByRole('button', { name, exact: true }).click();
    await current.locator('.legend', { hasText: unit }).waitFor();
  }
  const box = await current.locator('.host').boundingBox();
  await current.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  const tip = Number((await current.locator('.host .tip').textContent()).trim());
  claim(tip >= 1, `paths meet something: ${tip}`);
  await accessible('a heat map');
});

await step('tasks: a row leads to attempts and logs', async () => {
  await visit(`/jobs/${jobs.drive}/tasks`);
  await chooseStage('image');
  equal(await current.locator('.row.body', { hasText: 'render' }).count(), 0, 'rows of another stage');
  await current.locator('.row.body', { hasText: 'image' }).first().click();
  await current.locator('aside pre').first().waitFor();
  claim((await current.locator('aside pre').first().textContent()).length > 10, 'the log has words');
  await current.locator('aside .attempt').first().waitFor();
  await accessible('tasks');
  await current.getByRole('button', { name: 'Close' }).click();
  await current.getByRole('button', { name: 'failed' }).click();
  await current.getByText('No task matches.').waitFor();
});

await step('tasks: a table of more than 100,000 scrolls without a long task', async () => {
  await visit(`/jobs/${jobs.huge}/tasks`);
  await current.locator('.row.body').first().waitFor();
  const total = Number((await current.locator('.bar .muted', { hasText: 'tasks' }).textContent()).replace(/\D/g, ''));
  claim(total >= 100_000, `${total} tasks`);
  const scroll = () =>
    current.evaluate(async () => {
      let longest = 0;
      new PerformanceObserver((list) => {
        for (const entry of list.getEntries()) longest = Math.max(longest, entry.duration);
      }).observe({ type: 'longtask', buffered: false });
      const table = document.querySelector('[role=table]');
      const frame = () => new Promise(requestAnimationFrame);
      const jumps = [...Array(60)].map((_, i) => i * 300);
      for (const top of jumps) {
        table.scrollTop = top;
        await frame();
      }
      for (let i = 0; i < 120; i++) {
        table.scrollTop = ((i * 7919) % 120) * (table.scrollHeight / 120);
        await frame();
      }
      table.scrollTop = table.scrollHeight;
      await new Promise((resolve) => setTimeout(resolve, 1500));
      return longest;
    });
  // A machine that is busy with other work may stop the browser for a while; what the page does itself it does each
  // time.
  let longest = Infinity;
  for (let i = 0; i < 3 && longest > 100; i++) longest = Math.min(longest, await scroll());
  await current.locator('.row.body').last().getByText('/').waitFor();
  console.log(`        ${total} tasks, longest task of the page ${longest.toFixed(0)} ms`);
  claim(longest <= 100, `a task of ${longest} ms`);
});

await step('timeline: attempts by worker, enlarged and chosen', async () => {
  await visit(`/jobs/${jobs.drive}/timeline`);
  await current.getByText(/^[\d,]+ attempts/).waitFor();
  await current.getByText('render', { exact: true }).waitFor();
  await current.locator('.host').press('+');
  await until(() => /^[\d.]+,[\d.]+$/.test(query('t') ?? ''), 'the stretch is in the address', 5);
  await current.locator('.host').press('0');
  const box = await current.locator('.host').boundingBox();
  search: for (let y = 30; y < 200; y += 6) {
    for (let x = 130; x < box.width - 10; x += 12) {
      await current.mouse.move(box.x + x, box.y + y);
      if (await current.locator('.tip').count()) {
        await current.mouse.click(box.x + x, box.y + y);
        break search;
      }
    }
  }
  await current.locator('aside').waitFor();
  await until(() => query('task') !== null, 'the task is in the address', 5);
  await accessible('the timeline');
});

await step('logs and settings', async () => {
  await visit(`/jobs/${jobs.drive}/logs`);
  await current.locator('details').first().waitFor();
  await current.locator('details summary').first().click();
  await current.locator('details pre').first().waitFor();
  await current.getByRole('button', { name: 'Failures only' }).click();
  await current.getByText('No logs, or none matches the filter.').waitFor();
  await accessible('logs');
  await visit(`/jobs/${jobs.drive}/settings`);
  await current.getByText('128 × 72 pixels', { exact: false }).waitFor();
  await accessible('settings');
});

await numbers({ step, claim, equal, farm, page: () => current, visit });

await files({ step, open, claim, equal, farm, page: () => current, visit, accessible });
await slow({ step, claim, equal, open });

await hands({ step, open, claim, equal, farm, jobs, shotsAt });

await tabs({ step, open, claim, equal, farm, jobs });

await step('workers: drained, taken back, killed while the page is open', async () => {
  await visit('/workers');
  const row = (name) => current.locator('.row.body', { hasText: name });
  await row('node-b').getByRole('button').click();
  await row('node-b').getByText('draining').waitFor();
  claim(
    JSON.parse(farm.femc('workers', '--json')).find((it) => it.name === 'node-b').intake === 'draining',
    'node-b is drained',
  );
  await row('node-b').getByRole('button').click();
  await row('node-b').getByText('open').waitFor();
  await accessible('workers');
  await farm.kill(farm.workers.get('node-c'));
  await row('node-c').getByText('offline').waitFor();
  await accessible('workers, one of them gone');
  await shot('gone');
  await current.reload();
  await row('node-c').getByText('offline').waitFor();
});

await step('the coordinator is killed and started again: the page says so, and goes on', async () => {
  await visit(`/jobs/${jobs.huge}`);
  const submitted = current.locator('dl > div', { hasText: 'Submitted' }).locator('dd');
  const date = await submitted.textContent();
  await visit('/jobs');
  await farm.kill(farm.leader);
  await current.getByText(/^Connection lost/).waitFor({ timeout: 15_000 });
  await shot('lost');
  await accessible('a page without its coordinator');
  await farm.coordinator();
  await current.getByText('live', { exact: true }).waitFor({ timeout: 15_000 });
  await until(async () => (await current.getByText(/^Connection lost/).count()) === 0, 'the banner goes');
  await visit('/workers');
  await current.locator('.row.body', { hasText: 'node-c' }).getByText('offline').waitFor();
  await visit('/jobs');
  const late = farm.submit('cornell.mgf', '--size', '32x32', '--spp', '4', '--owner', 'late', '--priority', '90');
  await current.locator('.row.body', { hasText: 'late' }).waitFor();
  await until(() => farm.job(late).state === 'done', 'the farm goes on', 120);
  await current.locator('.row.body', { hasText: 'late' }).getByText('done').waitFor();
  await visit(`/jobs/${jobs.huge}`);
  claim(/\d/.test(date ?? ''), `a date: ${date}`);
  equal(await submitted.textContent(), date, 'the outage does not move the date of a submission');
});

await step('a job is found by its label, shows its notes, and is deleted after a question', async () => {
  const more = ['--size', '16x16', '--spp', '1', '--name', 'draft', '--comment', 'before the change', '--label', 'shot=12'];
  const draft = farm.submit('cornell.mgf', ...more);
  await until(() => farm.job(draft).state === 'done', 'it is done', 120);
  await visit('/jobs?filter=label:shot=12');
  equal(await current.locator('.row.body').count(), 1, 'one job has the label');
  await current.getByRole('link', { name: 'draft' }).click();
  await current.getByText('before the change').waitFor();
  await shot('notes');
  await current.getByRole('link', { name: 'shot=12' }).click();
  await current.locator('.row.body').getByRole('link', { name: 'draft' }).click();
  await current.getByRole('button', { name: 'Delete', exact: true }).click();
  await current.getByRole('button', { name: 'Keep it' }).last().click();
  claim(farm.job(draft).state === 'done', 'kept');
  await current.getByRole('button', { name: 'Delete', exact: true }).click();
  await current.getByRole('button', { name: 'Delete the job' }).click();
  await current.getByText(`Job ${draft} not found`).waitFor();
});

await step('cancel asks first; a retry takes it up again', async () => {
  await visit(`/jobs/${jobs.huge}`);
  await current.getByRole('button', { name: 'Cancel', exact: true }).first().click();
  await current.getByRole('button', { name: 'Keep it' }).click();
  claim(farm.job(jobs.huge).state !== 'cancelled', 'kept');
  await current.getByRole('button', { name: 'Cancel', exact: true }).first().click();
  await current.getByRole('button', { name: 'Cancel the job' }).click();
  await until(() => farm.job(jobs.huge).state === 'cancelled', 'cancelled');
  await until(
    async () =>
      (await current.getByRole('button', { name: 'Retry', exact: true }).getAttribute('aria-disabled')) === 'false',
    'a retry is offered',
  );
  await current.getByRole('button', { name: 'Retry', exact: true }).click();
  await until(() => farm.job(jobs.huge).state !== 'cancelled', 'tried again');
});

await step('read-only switches every change off', async () => {
  await visit(`/jobs/${jobs.waits}`);
  await current.getByLabel('read-only').check();
  await current.getByRole('button', { name: 'Pause', exact: true }).click({ force: true });
  await pause(500);
  claim(farm.job(jobs.waits).state !== 'paused', 'nothing was paused');
  await visit('/workers');
  equal(
    await current
      .getByRole('button', { name: /^Drain/ })
      .first()
      .getAttribute('aria-disabled'),
    'true',
    'drain is off',
  );
  await current.getByLabel('read-only').uncheck();
});

await step('keys, ways back, pages that are not there', async () => {
  await visit('/jobs');
  await current.keyboard.press('g');
  await current.keyboard.press('w');
  await until(() => new URL(current.url()).pathname === '/workers', 'g w goes to the workers');
  await current.goBack();
  await until(() => new URL(current.url()).pathname === '/jobs', 'the way back');
  await current.keyboard.press('?');
  await current.getByRole('dialog').waitFor();
  await current.keyboard.press('Escape');
  await visit('/nothing/here');
  await current.getByText('Page /nothing/here not found').waitFor();
  await visit('/jobs/999999');
  await current.getByText('Job 999999 not found').waitFor();
  await accessible('a page that is not there');
});

await step('dark: the same without a fault of contrast', async () => {
  current = await open(farm, { dark: true });
  for (const path of [
    '/jobs',
    '/workers',
    `/jobs/${jobs.drive}?color=error`,
    `/jobs/${jobs.drive}/picture?show=luminance`,
    `/jobs/${jobs.drive}/tasks`,
    `/jobs/${jobs.waits}`,
  ]) {
    await visit(path);
    await pause(600);
    await accessible(`${path}, dark`);
  }
  await current.context().close();
});

if (shotsAt) {
  await step('screenshots for the manual', async () => {
    for (const name of ['node-a', 'node-b']) claim(farm.workers.get(name).exitCode === null, `${name} runs`);
    jobs.running = farm.submit(
      'roundabout.mgf',
      '--frames',
      '1..24',
      '--size',
      '128x72',
      '--spp',
      '8',
      '--owner',
      'ann',
      '--priority',
      '70',
    );
    farm.submit('glossy.mgf', '--size', '128x128', '--spp', '64', '--owner', 'bob');
    current = await open(farm);
    await visit(`/jobs/${jobs.running}`);
    await until(async () => (await current.locator('.cell.done').count()) >= 3, 'some frames are done', 120);
    await pause(1500);
    await shot('browser-frames');
    await visit('/jobs');
    await pause(1200);
    await shot('browser-jobs');
    await visit(`/jobs/${jobs.drive}/picture?frame=6&show=luminance&pixel=64,48`);
    await pause(2000);
    await shot('browser-luminance');
    await visit(`/jobs/${jobs.drive}/timeline`);
    await pause(1500);
    await shot('browser-timeline');
    await visit(`/jobs/${jobs.drive}/tasks`);
    await chooseStage('image');
    await current.locator('.row.body').nth(2).click();
    await pause(1500);
    await shot('browser-tasks');
    await current.context().close();
    current = await open(farm, { dark: true });
    await visit(`/jobs/${jobs.drive}/picture?frame=6&other=9&split=40&pixel=64,48`);
    await pause(2000);
    await shot('browser-picture');
    await current.context().close();
  });
}

await farm.end();

// Who may do what, over a coordinator that asks.
const secured = await Farm.start(['--token-file', 'femc-ca/tokens']);
await step('roles: a token lets in, and each role is refused what is not its own', async () => {
  secured.femc('ca', 'init');
  const roles = ['viewer', 'submitter', 'operator', 'admin'];
  for (const role of roles) secured.femc('ca', 'token', 'user', `the-${role}`, '--role', role);
  await secured.coordinator();
  secured.env.FEMC_TOKEN_FILE = 'the-operator.token';
  const others = secured.submit('cornell.mgf', '--size', '32x32', '--spp', '4', '--tags', 'nobody');
  secured.env.FEMC_TOKEN_FILE = 'the-submitter.token';
  const own = secured.submit('cornell.mgf', '--size', '32x32', '--spp', '4', '--tags', 'nobody');
  secured.env.FEMC_TOKEN_FILE = 'the-admin.token';

  const may = {
    viewer: [false, false, false],
    submitter: [true, false, false],
    operator: [true, true, false],
    admin: [true, true, true],
  };
  for (const role of roles) {
    current = await open(secured);
    await current.goto(`/jobs/${own}`);
    await current.getByLabel('Token', { exact: true }).waitFor();
    if (role === 'viewer') {
      await accessible('login');
      await current.getByLabel('Token', { exact: true }).fill('nonsense');
      await current.getByRole('button', { name: 'Sign in' }).click();
      await current.getByRole('alert').waitFor();
    }
    await current.getByLabel('Token', { exact: true }).fill(secured.token(`the-${role}`));
    await current.getByRole('button', { name: 'Sign in' }).click();
    await current.getByText('live', { exact: true }).waitFor();
    await until(() => new URL(current.url()).pathname === `/jobs/${own}`, 'back to the page that was asked for');
    await current.getByText(`the-${role}`).first().waitFor();
    const cookies = await current.context().cookies();
    claim(
      cookies.some((it) => it.name.startsWith('femc') && it.httpOnly && it.sameSite === 'Strict'),
      'the cookie is HttpOnly and strict',
    );
    const off = async () =>
      await current
        .getByRole('button', { name: /^(Pause|Resume)$/ })
        .evaluateAll((all) => all.every((b) => b.ariaDisabled === 'true'));
    equal(!(await off()), may[role][0], `${role}: own job`);
    await visit(`/jobs/${others}`);
    await current.getByRole('button', { name: 'Pause', exact: true }).waitFor();
    equal(!(await off()), may[role][1], `${role}: another's job`);
    equal((await current.getByRole('link', { name: 'Audit' }).count()) === 1, may[role][2], `${role}: audit`);
    // What the page does not offer, the coordinator refuses.
    const asked = await current.evaluate(
      async ([job]) => {
        const headers = { 'Content-Type': 'application/json', 'X-Femc': '1' };
        const body = (it) => ({ method: 'POST', headers, body: JSON.stringify(it) });
        const control = await fetch('/api/v1/jobs/control', body({ jobs: [job], action: 'priority', priority: 51 }));
        const drain = await fetch('/api/v1/workers/drain', body({ workers: ['none'], action: 'begin' }));
        const audit = await fetch('/api/v1/audit?count=5');
        const bare = await fetch('/api/v1/jobs/control', { method: 'POST', body: '{}' });
        const answer = control.ok ? await control.json() : null;
        return {
          control: control.ok && answer.done.length === 1,
          drain: drain.status,
          audit: audit.status,
          bare: bare.ok,
        };
      },
      [others],
    );
    equal(asked.control, may[role][1], `${role}: control of another's job, asked for behind the page's back`);
    equal(asked.drain === 403, !may[role][1], `${role}: drain`);
    equal(asked.audit === 403, !may[role][2], `${role}: audit`);
    equal(asked.bare, false, 'a change without its headers');
    if (role === 'admin') {
      await current.getByRole('link', { name: 'Audit' }).click();
      await current.locator('.row.body').first().waitFor();
      await accessible('audit');
    }
    await current.getByRole('button', { name: 'Sign out' }).click();
    await current.getByLabel('Token', { exact: true }).waitFor();
    await current.context().close();
  }
});
await secured.end();

await light({ step, open, claim, equal, accessible, browser, shotsAt, current: (page) => (current = page) });
await scene({ step, open, claim, equal, accessible, shotsAt, current: (page) => (current = page) });
await compare({ step, open, claim, equal, accessible, shotsAt, current: (page) => (current = page) });
await browser.close();
console.log(`${steps} steps, ${failures} failed`);
process.exit(failures ? 1 : 0);
