/** Small screens and hands: 390 pixels, touch, keys without Tab, and a width of 1360 pixels. */
import { mkdirSync } from 'node:fs';
import { join } from 'node:path';
import { pause, until } from './farm.mjs';

const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 };

/** A drag of one finger through points of the page. */
async function drag(page, points) {
  const session = await page.context().newCDPSession(page);
  const touch = (type, point) =>
    session.send('Input.dispatchTouchEvent', { type, touchPoints: point ? [{ x: point[0], y: point[1] }] : [] });
  await touch('touchStart', points[0]);
  for (const point of points.slice(1)) {
    await touch('touchMove', point);
    await pause(30);
  }
  await touch('touchEnd', null);
}

export async function hands({ step, open, claim, equal, farm, jobs, shotsAt }) {
  const live = async (page, path) => {
    await page.goto(path);
    await page.getByText('live', { exact: true }).waitFor();
  };

  await step('hands: at 390 pixels every page fits', async () => {
    const page = await open(farm, { ...PHONE });
    try {
      const pages = {
        jobs: '/jobs',
        selected: `/jobs?jobs=1..9`,
        frames: `/jobs/${jobs.drive}`,
        'frames-selected': `/jobs/${jobs.drive}?frames=3..6&color=seconds`,
        picture: `/jobs/${jobs.drive}/picture?frame=6&show=luminance&pixel=64,36`,
        beside: `/jobs/${jobs.drive}/picture?frame=6&other=9`,
        tasks: `/jobs/${jobs.drive}/tasks`,
        task: `/jobs/${jobs.drive}/tasks?task=${jobs.drive}/1.0/render.0/0`,
        timeline: `/jobs/${jobs.drive}/timeline`,
        logs: `/jobs/${jobs.drive}/logs`,
        settings: `/jobs/${jobs.drive}/settings`,
        waits: `/jobs/${jobs.waits}`,
        workers: '/workers',
        audit: '/audit',
      };
      for (const [name, path] of Object.entries(pages)) {
        await live(page, path);
        await pause(700);
        if (shotsAt) {
          mkdirSync(join(shotsAt, '390'), { recursive: true });
          await page.screenshot({ path: join(shotsAt, '390', `${name}.png`) });
        }
        // Neither the document nor the part of it that scrolls is wider than the screen, and nothing is cut off beside it.
        const wide = await page.evaluate(() => {
          const all = [document.documentElement, document.body, document.querySelector('main'), document.querySelector('header')];
          const scrolls = all.filter((it) => it && it.scrollWidth > it.clientWidth + 1).map((it) => it.tagName);
          const isWithin = (it) => it.closest('.viewport, .hidden, .strip, .host, dialog, pre, .plot');
          const out = [...document.querySelectorAll('button, a, select, input, dd, h1, h2, p')]
            .filter((it) => !isWithin(it) && it.getBoundingClientRect().width && it.getBoundingClientRect().right > innerWidth + 1);
          return [...scrolls, ...out.map((it) => `${it.tagName} ${it.textContent.trim().slice(0, 30)}`)];
        });
        claim(wide.length === 0, `${name} is too wide: ${wide.slice(0, 5).join('; ')}`);
      }
    } finally {
      await page.context().close();
    }
  });

  await step('hands: on a phone the picture is above its panel, and fingers pin a pixel and draw a line', async () => {
    const page = await open(farm, { ...PHONE });
    try {
      await live(page, `/jobs/${jobs.drive}/picture?frame=6`);
      await page.locator('.host canvas').first().waitFor();
      const [stage, panel] = [await page.locator('.stage').boundingBox(), await page.locator('aside').boundingBox()];
      claim(stage.y + stage.height <= panel.y && panel.width > 340, 'the picture is above its panel');
      await page.locator('.host').scrollIntoViewIfNeeded();
      const box = await page.locator('.film').boundingBox();
      const at = (x, y) => [box.x + x * box.width, box.y + y * box.height];
      const query = (key) => new URL(page.url()).searchParams.get(key);
      await page.touchscreen.tap(...at(0.5, 0.5));
      await until(() => /^6[345],3[567]$/.test(query('pixel') ?? ''), `a tap pins the pixel, not ${query('pixel')}`, 5);
      await page.getByRole('button', { name: 'Line', exact: true }).tap();
      await drag(page, [at(0.3, 0.3), at(0.6, 0.3), at(0.6, 0.7), at(0.3, 0.7), at(0.3, 0.35)]);
      await until(() => (query('lasso') ?? '').split(';').length >= 4, 'the line around pixels is in the address', 5);
      await page.getByText(/^[\d,]+ pixels selected$/).waitFor();
      equal(await page.getByRole('button', { name: 'Line', exact: true }).getAttribute('aria-pressed'), 'false', 'the line is done');
      // Frames, too, are selected by fingers.
      await live(page, `/jobs/${jobs.drive}`);
      await page.locator('#frame-2').tap();
      await until(() => query('frames') === '2', 'a tap selects a frame', 5);
      await page.locator('#frame-4').tap();
      await until(() => query('frames') === '2,4', 'another tap adds a frame', 5);
      await live(page, '/jobs');
      await page.getByLabel(`Select job ${jobs.drive}`).tap();
      await page.getByText('1 job selected').waitFor();
    } finally {
      await page.context().close();
    }
  });

  await step('hands: j, k and x work without a press of Tab, and g j still goes to the jobs', async () => {
    const page = await open(farm);
    try {
      await live(page, '/jobs?sort=job');
      await page.locator('.row.body').first().waitFor();
      for (const key of ['j', 'j', 'k', 'x']) await page.keyboard.press(key);
      await until(() => new URL(page.url()).searchParams.get('jobs') === '1', 'the first job is selected', 5);
      await live(page, `/jobs/${jobs.drive}/tasks`);
      await page.locator('.row.body').first().waitFor();
      await page.keyboard.press('g');
      await page.keyboard.press('j');
      await until(() => new URL(page.url()).pathname === '/jobs', 'g j', 5);
    } finally {
      await page.context().close();
    }
  });

  await step('hands: at 1360 pixels the reason of a job that waits is whole', async () => {
    const page = await open(farm);
    try {
      await live(page, '/jobs?filter=owner:eve');
      const cell = page.locator('.row.body', { hasText: 'no worker has all the tags gpu' }).locator('.reason');
      const { right, cut } = await cell.evaluate((it) => ({
        right: it.getBoundingClientRect().right,
        cut: it.scrollHeight > it.clientHeight + 1 || it.scrollWidth > it.clientWidth + 1,
      }));
      claim(right <= 1360 && !cut, `it ends at ${right}, cut off: ${cut}`);
    } finally {
      await page.context().close();
    }
  });

  await step('hands: all jobs are selected, and what cannot be done says why', async () => {
    const page = await open(farm);
    try {
      await live(page, '/jobs');
      await page.getByRole('button', { name: 'Select all', exact: true }).click();
      const count = JSON.parse(farm.femc('jobs', '--json')).length;
      await page.getByText(`${count} jobs selected`).waitFor();
      // More jobs than a query can name: the address keeps them, and a reload brings them back.
      const many = Array.from({ length: 3000 }, (_, i) => 2 * i + 1).join(',');
      await live(page, `/jobs#jobs=${many}`);
      await page.getByText(/jobs? selected/).waitFor();
      await page.reload();
      await page.getByText(/jobs? selected/).waitFor();
      // A job that is done cannot be tried again: no button says so.
      await live(page, `/jobs/${jobs.drive}`);
      await page.getByRole('button', { name: 'Pause', exact: true }).waitFor();
      equal(await page.getByRole('button', { name: 'Retry', exact: true }).count(), 0, 'buttons to retry a job that is done');
      // Ticks of frames are whole.
      await page.context().addInitScript(() => {
        globalThis.drawnTexts = [];
        const fill = CanvasRenderingContext2D.prototype.fillText;
        CanvasRenderingContext2D.prototype.fillText = function (text, ...rest) {
          globalThis.drawnTexts.push(text);
          return fill.call(this, text, ...rest);
        };
      });
      await live(page, `/jobs/${jobs.drive}`);
      await page.locator('.plots canvas').first().waitFor();
      const ticks = await until(async () => {
        const texts = await page.evaluate(() => globalThis.drawnTexts);
        return texts.includes('6') && texts.filter((it) => /^[\d.]+$/.test(it));
      }, 'the axis of frames is drawn', 10);
      claim(ticks.every((it) => Number.isInteger(Number(it))), `ticks of frames: ${[...new Set(ticks)]}`);
    } finally {
      await page.context().close();
    }
  });
}
