/** Many tabs of one browser over plain HTTP, where a browser has six connections to a coordinator. */
import { createServer, request } from 'node:http';
import { pause, until } from './farm.mjs';

const TABS = 7;
/** Most time until a page shows the farm, milliseconds. */
const LOAD_MS = 2000;

/** A coordinator's address that counts the feeds which are open. */
class Counter {
  feeds = 0;
  /** - `target`: address of the coordinator. */
  static async start(target) {
    const counter = new Counter();
    const { hostname, port } = new URL(target);
    counter.server = createServer((from, to) => {
      const isFeed = from.url.startsWith('/api/v1/feed');
      if (isFeed) {
        counter.feeds++;
        to.once('close', () => counter.feeds--);
      }
      const onward = request({ hostname, port, path: from.url, method: from.method, headers: from.headers }, (answer) => {
        to.writeHead(answer.statusCode, answer.headers);
        answer.pipe(to);
      });
      onward.on('error', () => to.destroy());
      to.once('close', () => onward.destroy());
      from.pipe(onward);
    });
    await new Promise((resolve) => counter.server.listen(0, '127.0.0.1', resolve));
    counter.url = `http://127.0.0.1:${counter.server.address().port}`;
    return counter;
  }

  end() {
    this.server.closeAllConnections();
    this.server.close();
  }
}

/** Goes to an address; the milliseconds until the page is live. */
async function load(page, path) {
  const began = Date.now();
  await page.goto(path, { waitUntil: 'commit', timeout: 90_000 });
  await page.getByText('live', { exact: true }).waitFor({ timeout: 90_000 });
  return Date.now() - began;
}

/** Makes a page believe that its tab is in the background or in front. */
const show = (page, isVisible) =>
  page.evaluate((state) => {
    Object.defineProperty(document, 'visibilityState', { configurable: true, get: () => state });
    document.dispatchEvent(new Event('visibilitychange'));
  }, isVisible ? 'visible' : 'hidden');

/** The steps. */
export async function tabs({ step, open, claim, equal, farm, jobs }) {
  await step('tabs: seven over plain HTTP are live, and the seventh loads at once', async () => {
    const counter = await Counter.start(farm.url);
    const first = await open({ url: counter.url });
    const context = first.context();
    try {
      const pages = [first];
      while (pages.length < TABS) pages.push(await context.newPage());
      const paths = ['/jobs', `/jobs/${jobs.drive}`, '/workers', `/jobs/${jobs.drive}/picture`];
      const times = [];
      for (const [i, page] of pages.entries()) times.push(await load(page, paths[i % paths.length]));
      console.log(`        ${TABS} tabs: ${times.join(', ')} ms; ${counter.feeds} feeds`);
      claim(Math.max(...times) < LOAD_MS, `a tab took ${Math.max(...times)} ms`);
      equal(counter.feeds, 1, 'feeds of seven tabs');
      // A change reaches all of them: the number of workers is in the head of every page.
      const there = () => JSON.parse(farm.femc('workers', '--json')).filter((it) => it.intake !== 'offline');
      const all = (count) =>
        Promise.all(pages.map((page) => page.getByRole('link', { name: `Workers ${count}` }).waitFor({ timeout: 60_000 })));
      farm.worker('node-tabs');
      await until(() => there().some((it) => it.name === 'node-tabs'), 'another worker is there');
      const count = there().length;
      await all(count);
      // The tab that opened the feed is closed.
      await pages.shift().close();
      await farm.kill(farm.workers.get('node-tabs'));
      farm.workers.delete('node-tabs');
      await all(count - 1);
      equal(counter.feeds, 1, 'feeds after the first tab is closed');
      // Tabs in the background hold nothing; one that comes back knows what it has missed.
      for (const page of pages) await show(page, false);
      await until(() => counter.feeds === 0, 'no feed for hidden tabs', 5);
      const late = farm.submit('cornell.mgf', '--size', '32x32', '--spp', '4', '--owner', 'missed', '--tags', 'nobody');
      await pause(1500);
      const list = pages[3];
      await show(list, true);
      await list.getByText('live', { exact: true }).waitFor();
      if (!new URL(list.url()).pathname.endsWith('/jobs')) await list.getByRole('link', { name: 'Jobs', exact: true }).first().click();
      await list.locator('.row.body', { hasText: 'missed' }).waitFor({ timeout: 10_000 });
      equal(counter.feeds, 1, 'feeds of the tab that came back');
      farm.femc('cancel', String(late));
    } finally {
      await context.close();
      counter.end();
    }
  });

  await step('tabs: an address typed seven times in one tab loads at once', async () => {
    const counter = await Counter.start(farm.url);
    const page = await open({ url: counter.url });
    try {
      const times = [];
      for (let i = 0; i < TABS + 1; i++) times.push(await load(page, `/jobs?filter=${i}`));
      console.log(`        ${times.join(', ')} ms; ${counter.feeds} feeds`);
      claim(Math.max(...times) < LOAD_MS, `an address took ${Math.max(...times)} ms`);
      claim(counter.feeds === 1, `${counter.feeds} feeds`);
      // The way back leads to pages that browsers keep: they are live again.
      for (const left of [TABS - 1, TABS - 2, TABS - 3]) {
        await page.evaluate(() => history.back());
        await until(() => new URL(page.url()).searchParams.get('filter') === String(left), 'the way back', 10);
      }
      await page.getByText('live', { exact: true }).waitFor();
      await until(() => counter.feeds === 1, `one feed after the way back, not ${counter.feeds}`, 5);
    } finally {
      await page.context().close();
      counter.end();
    }
  });

  await step('tabs: a browser without shared workers ends the feed of a page that is left or hidden', async () => {
    const counter = await Counter.start(farm.url);
    const page = await open({ url: counter.url });
    await page.context().addInitScript(() => Reflect.deleteProperty(globalThis, 'SharedWorker'));
    try {
      const times = [];
      for (let i = 0; i < TABS + 1; i++) times.push(await load(page, `/jobs?filter=${i}`));
      claim(Math.max(...times) < LOAD_MS, `an address took ${Math.max(...times)} ms`);
      await until(() => counter.feeds === 1, `one feed, not ${counter.feeds}`, 5);
      await show(page, false);
      await until(() => counter.feeds === 0, 'no feed of a hidden page', 5);
      await show(page, true);
      await page.getByText('live', { exact: true }).waitFor();
      await until(() => counter.feeds === 1, 'a feed of a visible page', 5);
    } finally {
      await page.context().close();
      counter.end();
    }
  });
}
