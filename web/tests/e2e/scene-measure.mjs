/**
 * Times and memory of the scene view in Chromium with graphics in software, as a JSON line for each scene:
 *
 *     node tests/e2e/scene-measure.mjs SCENE.mgf.. [-- OPTIONS OF femc submit]
 *
 * FEMC names the program, CHROMIUM the browser. Not a part of `run`.
 */
import { readFileSync } from 'node:fs';
import { loadavg } from 'node:os';
import { resolve } from 'node:path';
import { chromium } from 'playwright-core';
import { Farm, pause, until } from './farm.mjs';

const args = process.argv.slice(2);
const split = args.includes('--') ? args.indexOf('--') : args.length;
const [scenes, options] = [args.slice(0, split).map((it) => resolve(it)), args.slice(split + 1)];
const SETTINGS = ['--size', '96x64', '--spp', '64', '--stats', '--frames', '1'];
const MOVING_PATHS = 500;
/** Seconds over which drawn frames are counted. */
const COUNTED_SECONDS = 8;
const round = (v) => Math.round(v * 10) / 10;
const mebibytes = (bytes) => round(bytes / 2 ** 20);

const cpu = /model name\s*:\s*(.*)/.exec(readFileSync('/proc/cpuinfo', 'utf8'))?.[1];
const farm = await Farm.start();
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync',
    '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist', '--enable-precise-memory-info'],
});
try {
  await farm.coordinator();
  farm.worker('measured');
  for (const scene of scenes) {
    const job = Number(farm.femc('submit', scene, ...SETTINGS, ...options).trim().split('\n').at(-1));
    await until(() => ['done', 'failed'].includes(farm.job(job).state), `${scene} is rendered`, 1200);
    const page = await browser.newPage({ viewport: { width: 1360, height: 1000 } });
    const geometry = await page.request.get(`${farm.url}/api/v1/jobs/${job}/geometry`);
    const bytes = await geometry.body();
    const document = JSON.parse(bytes.toString('utf8', 20, 20 + bytes.readUInt32LE(12)));
    const { triangles, boxed_objects: boxed } = document.scenes[0].extras;
    await page.goto(`${farm.url}/jobs/${job}/light?moving=${MOVING_PATHS}`);
    await page.locator('[data-totals]').waitFor({ timeout: 120_000 });
    await page.getByRole('button', { name: 'Scene', exact: true }).click();
    const section = page.locator('[data-scene=ready]');
    await section.waitFor({ timeout: 120_000 });
    const first = Number(await section.getAttribute('data-first-picture'));
    const canvas = page.getByRole('region', { name: 'Scene', exact: true }).locator('canvas');
    await canvas.scrollIntoViewIfNeeded();
    const frames = async () => Number(await canvas.getAttribute('data-frames'));
    await pause(2000);
    const [before, began] = [await frames(), performance.now()];
    await pause(1000 * COUNTED_SECONDS);
    const rate = ((await frames()) - before) / ((performance.now() - began) / 1000);
    const { width, height } = await canvas.boundingBox();
    // The whole process of the tab, with the buffers of graphics that it keeps.
    const session = await page.context().newCDPSession(page);
    await session.send('HeapProfiler.collectGarbage');
    const heap = await page.evaluate(() => performance.memory.usedJSHeapSize);
    const processes = (await (await browser.newBrowserCDPSession()).send('SystemInfo.getProcessInfo')).processInfo;
    const tabs = processes.filter((it) => it.type === 'renderer').map(({ id }) => 1024 * Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${id}/status`, 'utf8'))?.[1]));
    console.log(JSON.stringify({
      scene, cpu, load: round(loadavg()[0]), browser: browser.version(), triangles, boxed_objects: boxed,
      geometry_mib: mebibytes(bytes.length), first_picture_s: round(first / 100) / 10, moving_paths: await page.locator('[data-moving]').innerText().catch(() => null),
      canvas: `${Math.round(width)}x${Math.round(height)}`, frames_per_second: round(rate),
      tab_heap_mib: mebibytes(heap), tab_resident_mib: mebibytes(Math.max(...tabs)),
    }));
    await page.close();
  }
} finally {
  await browser.close();
  await farm.end();
}
