/** Every number of the picture's page and of the pixels' answer, held against the EXR file. */
import { readFileSync } from 'node:fs';
import { until } from './farm.mjs';
import { readExr } from './exr.mjs';

/** Rounding of a half float, and of the four digits of a page. */
const HALF = 5.5e-4;
const DIGITS = 1.2e-3;

/** Planes of `application/vnd.femc.pixels`. */
function readPixels(buffer) {
  const bytes = Buffer.from(buffer);
  const [width, height, count] = [8, 12, 16].map((at) => bytes.readUInt32LE(at));
  let at = 20;
  const names = [];
  for (let i = 0; i < count; i++) {
    const length = bytes.readUInt32LE(at);
    names.push(bytes.toString('utf8', at + 4, at + 4 + length));
    at += 4 + length;
  }
  const half = (bits) => {
    const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
    return (bits & 0x8000 ? -1 : 1) * (exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24);
  };
  const plane = (i) =>
    Float64Array.from({ length: width * height }, (_, pixel) => half(bytes.readUInt16LE(at + 2 * (i * width * height + pixel))));
  return { width, height, planes: new Map(names.map((name, i) => [name, plane(i)])) };
}

/** What the file says of each pixel, by the names of the pixels' answer. */
function due({ width, height, channels }) {
  const channel = (name) => channels.get(name);
  const [r, g, b] = ['R', 'G', 'B'].map(channel);
  const [variance, samples] = ['variance.Y', 'samples.Y'].map(channel);
  const y = r.map((v, i) => 0.212639 * v + 0.7151687 * g[i] + 0.07219232 * b[i]);
  const isLit = (i) => y[i] > 0 && samples[i] >= 2;
  const freedom = new Float64Array(y.length).fill(-1);
  const error = new Float64Array(y.length).fill(-1);
  for (let i = 0; i < y.length; i++) {
    if (!isLit(i)) continue;
    const pool = [];
    for (let row = Math.max(0, Math.floor(i / width) - 1); row <= Math.min(height - 1, Math.floor(i / width) + 1); row++)
      for (let x = Math.max(0, (i % width) - 1); x <= Math.min(width - 1, (i % width) + 1); x++)
        if (isLit(row * width + x)) pool.push(row * width + x);
    freedom[i] = pool.length;
    const mean = pool.reduce((sum, at) => sum + (variance[at] * samples[at]) / y[at], 0) / pool.length;
    error[i] = Math.sqrt(mean / (samples[i] * y[i]));
  }
  return new Map(Object.entries({ R: r, G: g, B: b, Y: y, error: channel('relative_error.Y'), standard_error: error, freedom, samples }));
}

/** Student's quantiles for the pools there are. */
const T = { 1: 12.706, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306, 9: 2.262 };

const number = (text) => Number(text.replace(/[^\d.e+-]/g, ''));

export async function numbers({ step, claim, equal, farm, page, visit }) {
  await step('numbers: those of the pixels and of the picture are those of the EXR file', async () => {
    const options = ['--size', '48x48', '--spp', '16', '--stats', '--owner', 'numbers', '--priority', '95'];
    const job = farm.submit('cornell.mgf', ...options);
    await until(() => farm.job(job).state === 'done', 'its frame is rendered', 120);
    const base = `${farm.url}/api/v1/jobs/${job}/frames`;
    const { frames } = await (await fetch(base)).json();
    const frame = frames[0];
    const digest = (role) => frame.outputs.find((it) => it.role === role).digest;
    const file = readExr(readFileSync(farm.artifact(digest('image'))));
    const of_file = due(file);
    const sent = readPixels(await (await fetch(`${base}/${frame.frame}/pixels`)).arrayBuffer());
    const maps = readPixels(await (await fetch(`${base}/${frame.frame}/maps`)).arrayBuffer());
    equal(`${[...sent.planes.keys()].sort()}`, `${[...of_file.keys()].sort()}`, 'channels');
    equal(`${[sent.width, sent.height, maps.width, maps.height]}`, `${[file.width, file.height, file.width, file.height]}`, 'sizes');
    const near = (is, due, share, what) =>
      claim(Math.abs(is - due) <= share * Math.abs(due) + 1e-7, `${what}: ${is}, not ${due}`);
    for (const [name, values] of of_file)
      values.forEach((v, i) => near(sent.planes.get(name)[i], v, HALF, `${name} of pixel ${i}`));

    // The panel, for pixels at the border, at edges of blocks and within.
    const pixels = [[0, 0], [15, 16], [24, 24], [47, 47], [31, 5], [8, 40]];
    for (const [x, y] of pixels) {
      await visit(`/jobs/${job}/picture?frame=${frame.frame}&pixel=${x},${y}&show=depth`);
      const shown = page();
      await shown.locator('aside dt', { hasText: 'Throughput' }).waitFor();
      const facts = await shown.locator('aside dl').first().evaluate((list) =>
        Object.fromEntries([...list.querySelectorAll('dt')].map((dt) => [dt.textContent, dt.nextElementSibling.textContent])));
      const i = y * file.width + x;
      const at = (name) => of_file.get(name)[i];
      claim(at('Y') > 0, `pixel ${x}, ${y} is lit`);
      const [half, unit] = [T[at('freedom')] * at('standard_error'), at('Y')];
      const ends = facts['Pixel, 95 %'].split(' .. ').map(number);
      const told = new Map([
        ['Luminance', [number(facts.Luminance.replace('cd/m²', '')), at('Y'), DIGITS]],
        // The expansion of Student's quantile is within 1 % of the table.
        ['from', [ends[0], Math.max(0, unit * (1 - half)), 0.012 * Math.max(1, half / Math.abs(1 - half))]],
        ['to', [ends[1], unit * (1 + half), 0.012]],
        // Percent have one digit behind the point.
        ['Pixel error', [number(facts['Pixel error']) / 100, at('standard_error'), 6e-4 / at('standard_error') + DIGITS]],
        ['Block error', [number(facts['Block error']) / 100, at('error'), 6e-4 / at('error') + DIGITS]],
        ['Samples', [number(facts.Samples), at('samples'), 0]],
        ['Deviation', [number(facts.Deviation.replace('cd/m²', '')), maps.planes.get('deviation')[i], DIGITS]],
        ['Depth', [number(facts.Depth), maps.planes.get('depth')[i], DIGITS]],
        ['Throughput', [number(facts.Throughput), maps.planes.get('throughput')[i], DIGITS]],
      ]);
      facts['R G B'].split('  ').forEach((text, c) => told.set('RGB'[c], [number(text), at('RGB'[c]), DIGITS]));
      for (const [name, [is, what, share]] of told) near(is, what, share, `${name} of pixel ${x}, ${y} on the page`);
      equal(Object.keys(facts).length, 9, `numbers of the panel (${Object.keys(facts)})`);
    }

    // The maps: the ends of each scale and the mean are those of the channel.
    const mean = (values) => {
      const kept = [...values].filter((v) => v >= 0);
      return kept.reduce((sum, v) => sum + v, 0) / kept.length;
    };
    for (const [show, values] of [
      ['luminance', of_file.get('Y')],
      ['pixel-error', of_file.get('standard_error')],
      ['error', of_file.get('error')],
      ['samples', of_file.get('samples')],
      ['deviation', maps.planes.get('deviation')],
      ['depth', maps.planes.get('depth')],
      ['throughput', maps.planes.get('throughput')],
    ]) {
      await visit(`/jobs/${job}/picture?frame=${frame.frame}&show=${show}`);
      const text = await page().locator('.bar.second .muted', { hasText: /^mean / }).textContent();
      const isShare = show.endsWith('error');
      const [is, low, high] = [...text.matchAll(/-?[\d.]+(?:e[+-]?\d+)?/g)].map(([it]) => Number(it) / (isShare ? 100 : 1));
      const kept = [...values].filter((v) => v >= 0);
      const slack = (v) => (isShare ? 6e-4 / Math.max(v, 1e-9) : 0) + 2 * DIGITS;
      for (const [what, a, b] of [['mean', is, mean(values)], ['lowest', low, Math.min(...kept)], ['highest', high, Math.max(...kept)]])
        near(a, b, slack(b), `${what} of ${show}`);
    }
  });

  await step('numbers: a frame in work has the errors of its parts', async () => {
    const job = farm.submit('roundabout.mgf', '--frames', '1', '--size', '96x96', '--spp', '512', '--owner', 'parts', '--priority', '99');
    const path = `${farm.url}/api/v1/jobs/${job}/frames/1/pixels`;
    const sent = await until(async () => {
      if (farm.job(job).state === 'done') throw new Error('the frame was done before its pixels were seen');
      // The command above stops this program for a while, in which a connection that is kept may have ended.
      const answer = await fetch(path).catch(() => null);
      return answer?.status === 200 && readPixels(await answer.arrayBuffer());
    }, 'pixels of a frame in work', 60);
    const [samples, error, y] = ['samples', 'standard_error', 'Y'].map((name) => sent.planes.get(name));
    const rendered = [...samples.keys()].filter((i) => samples[i] >= 2 && y[i] > 0);
    claim(rendered.length > 100, `${rendered.length} pixels are rendered`);
    claim(rendered.every((i) => error[i] >= 0 && error[i] < 5), 'each has an error');
    claim([...samples.keys()].every((i) => samples[i] > 0 || error[i] === -1), 'a pixel without a sample has none');
    farm.femc('cancel', String(job));
  });
}
