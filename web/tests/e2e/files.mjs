/** Files of a job: frames, contact sheets and clips, saved and played in the pages. */
import { chmodSync, mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { until } from './farm.mjs';

/** A clip as WebM, which the browser itself makes of a canvas, in base64. */
const recordClip = (page) =>
  page.evaluate(async () => {
    const canvas = Object.assign(document.createElement('canvas'), { width: 64, height: 36 });
    const context = canvas.getContext('2d');
    const recorder = new MediaRecorder(canvas.captureStream(20), { mimeType: 'video/webm' });
    const parts = [];
    recorder.ondataavailable = (event) => parts.push(event.data);
    const ended = new Promise((resolve) => (recorder.onstop = resolve));
    recorder.start();
    for (let i = 0; i < 30; i++) {
      context.fillStyle = `hsl(${i * 12} 80% 50%)`;
      context.fillRect(0, 0, 64, 36);
      await new Promise((resolve) => setTimeout(resolve, 50));
    }
    recorder.stop();
    await ended;
    const bytes = new Uint8Array(await new Blob(parts).arrayBuffer());
    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(''));
  });

export async function files({ step, open, claim, equal, farm, page, visit, accessible }) {
  const out = (name) => readFileSync(join(farm.folder, 'out', name));
  let job;

  /** Saves a file with `act`; its name and its bytes. */
  async function saved(page, act) {
    const [download] = await Promise.all([page.waitForEvent('download'), act()]);
    return { name: download.suggestedFilename(), bytes: readFileSync(await download.path()) };
  }
  const link = (page, group, name) => page.getByRole('group', { name: group }).getByRole('link', { name });

  await step('files: a frame is saved as femc fetch writes it, by mouse and by keys', async () => {
    job = farm.submit(
      'roundabout.mgf',
      ...['--frames', '1..3', '--size', '64x36', '--spp', '2', '--owner', 'files', '--priority', '97'],
      ...['--layers', 'direct', '--preview', '--video', 'drive.png', '--contact-sheet', 'sheet.png'],
    );
    await until(() => farm.job(job).state === 'done', 'the job is done', 240);
    farm.femc('fetch', String(job), '-o', 'out');
    await visit(`/jobs/${job}/picture?frame=2`);
    for (const [name, file] of [
      [/^EXR/, 'roundabout.0002.exr'],
      [/^Still/, 'roundabout.0002.png'],
      [/^Layers/, 'roundabout.0002.layers.exr'],
    ]) {
      const { name: suggested, bytes } = await saved(page(), () => link(page(), 'Files of frame 2', name).click());
      equal(suggested, file, 'name');
      claim(bytes.equals(out(file)), `${file} has the bytes of femc fetch`);
    }
    const preview = await saved(page(), () => link(page(), 'Files of frame 2', /^PNG/).click());
    equal(preview.name, 'roundabout.0002.preview.png', 'name of the preview');
    equal(preview.bytes.subarray(1, 4).toString(), 'PNG', 'format of the preview');
    await accessible('the files of a frame');
    await visit(`/jobs/${job}?frames=1,3`);
    await link(page(), 'Files of frame 3', /^EXR/).focus();
    const { name, bytes } = await saved(page(), () => page().keyboard.press('Enter'));
    equal(name, 'roundabout.0003.exr', 'name');
    claim(bytes.equals(out(name)), `${name} has the bytes of femc fetch`);
    await accessible('the files of selected frames');
  });

  await step('files: an animated PNG plays, and its contact sheet is beside it', async () => {
    await visit(`/jobs/${job}`);
    await page().getByRole('tab', { name: 'Clip' }).waitFor();
    await page().keyboard.press('7');
    await until(() => new URL(page().url()).pathname === `/jobs/${job}/clip`, '7 is the key of the clip', 5);
    for (const name of ['Clip of roundabout', 'Contact sheet of roundabout']) {
      const image = page().getByRole('img', { name });
      await until(() => image.evaluate((it) => it.naturalWidth > 0), `${name} is shown`);
    }
    for (const [name, file] of [
      [/^Clip/, 'drive.png'],
      [/^Contact sheet/, 'sheet.png'],
    ]) {
      const { name: suggested, bytes } = await saved(page(), () => link(page(), 'Files of the job', name).click());
      equal(suggested, file, 'name');
      claim(bytes.equals(out(file)), `${file} has the bytes of femc fetch`);
    }
    await accessible('a clip');
  });

  await step('files: a video plays and can be searched', async () => {
    await visit('/jobs');
    const clip = join(farm.folder, 'recorded.webm');
    writeFileSync(clip, Buffer.from(await recordClip(page()), 'base64'));
    // In the place of ffmpeg: reads all frames, and writes what the browser has recorded.
    const bin = join(farm.folder, 'bin');
    mkdirSync(bin, { recursive: true });
    const words = '[ "$1" = -version ] && echo ffmpeg version 7.1-test and so on && exit 0';
    writeFileSync(join(bin, 'ffmpeg'), `#!/bin/sh\n${words}\nfor out; do :; done\ncat >/dev/null\nexec cp '${clip}' "$out"\n`);
    chmodSync(join(bin, 'ffmpeg'), 0o755);
    farm.worker('films', [], { PATH: `${bin}:${process.env.PATH}` });
    const film = farm.submit(
      'roundabout.mgf',
      ...['--frames', '1..2', '--size', '32x32', '--spp', '1', '--video', 'film.webm', '--owner', 'files'],
      ...['--priority', '98'],
    );
    await until(() => farm.job(film).state === 'done', 'the clip is made', 120);
    await visit(`/jobs/${film}/clip`);
    const video = page().getByLabel('Clip of roundabout');
    await video.waitFor();
    const state = () => video.evaluate((it) => ({ at: it.currentTime, ready: it.readyState, paused: it.paused }));
    await until(async () => (await state()).ready >= 1, 'the video is known');
    claim((await state()).paused, 'it does not begin by itself');
    await video.evaluate((it) => it.play());
    await until(async () => (await state()).at > 0.2, 'it plays');
    const range = page().waitForResponse((it) => it.url().includes(`/jobs/${film}/clip`) && it.status() === 206);
    await page().reload();
    await range;
    const { name, bytes } = await saved(page(), () => link(page(), 'Files of the job', /^Clip/).click());
    equal(name, 'film.webm', 'name');
    claim(bytes.equals(readFileSync(clip)), 'the clip has the bytes that were recorded');
    await accessible('a video');
    await farm.kill(farm.workers.get('films'));
  });

  await step('files: a clip that the browser cannot play is offered as a file', async () => {
    await page().route('**/api/v1/jobs/*/clip*', async (route) => {
      const answer = await route.fetch();
      await route.fulfill({ response: answer, headers: { ...answer.headers(), 'content-type': 'video/x-msvideo' } });
    });
    await visit(`/jobs/${job}/clip`);
    await page().getByText('This browser cannot play drive.png (video/x-msvideo)').waitFor();
    await link(page(), 'Files of the job', /^Clip/).waitFor();
    await page().unroute('**/api/v1/jobs/*/clip*');
  });

  await step('files: a damaged image says so and can be saved when it is rendered again', async () => {
    const frames = async () => (await (await fetch(`${farm.url}/api/v1/jobs/${job}/frames`)).json()).frames;
    const image = async () => (await frames()).find((it) => it.frame === 1).outputs.find((it) => it.role === 'image');
    claim(farm.damage((await image()).digest), 'the image lies in the store');
    // The view of the picture would find the damage itself.
    await visit(`/jobs/${job}?frames=1`);
    await link(page(), 'Files of frame 1', /^EXR/).click();
    await page().getByText(`image.exr of frame 1 of job ${job} is damaged`).waitFor();
    await until(async () => (await image()) !== undefined && farm.job(job).state === 'done', 'it is rendered again', 120);
    await link(page(), 'Files of frame 1', /^EXR/).waitFor();
    const { name, bytes } = await saved(page(), () => link(page(), 'Files of frame 1', /^EXR/).click());
    equal(name, 'roundabout.0001.exr', 'name');
    claim(bytes.length > 1000, 'the image is there');
  });

  await step('files: at 390 pixels the links fit, and a finger saves a file', async () => {
    const phone = await open(farm, {
      ...{ viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 },
    });
    try {
      for (const path of [`/jobs/${job}/clip`, `/jobs/${job}?frames=1..3`, `/jobs/${job}/picture?frame=3`]) {
        await phone.goto(path);
        await phone.getByText('live', { exact: true }).waitFor();
        await phone.getByRole('link', { name: /^(EXR|Clip)/ }).first().waitFor();
        const ends = await phone.getByRole('link').evaluateAll((all) => all.map((it) => it.getBoundingClientRect().right));
        claim(ends.every((right) => right <= 391), `links of ${path} end at ${ends}`);
        const width = await phone.evaluate(() => document.documentElement.scrollWidth);
        claim(width <= 391, `${path} is ${width} wide`);
      }
      const { name, bytes } = await saved(phone, () => link(phone, 'Files of frame 3', /^EXR/).tap());
      claim(bytes.equals(out(name)), `${name} has the bytes of femc fetch`);
    } finally {
      await phone.context().close();
    }
  });
}
