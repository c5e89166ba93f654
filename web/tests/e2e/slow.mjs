/** The slow frame of a job is named right while another job competes for the only worker. */
import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { Farm, root, until } from './farm.mjs';

const number = (text) => Number(text.replace(/[^\d.e+-]/g, ''));

export async function slow({ step, claim, equal, open }) {
  await step('slow: the slow frame is named by the page, the JSON and the terminal while another job competes', async () => {
    const farm = await Farm.start();
    let page;
    try {
      await farm.coordinator();
      // Fog is thick in the third frame alone: its paths are many times as long.
      const room = readFileSync(join(root, 'scenes/cornell.mgf'), 'utf8');
      const fog = 'medium fog =\n\tc\n\tsigma_s 0.01\nmbox fog -1.999 -1.999 0.0005 1.999 1.999 3.999\n';
      const clip = 'time 0 0.5 10\nvary medium.fog.sigma_s = 0 0 0.1 0 0.11 0 0.19 20 0.21 20 0.29 0 0.5 0\n';
      const scene = join(farm.folder, 'slow.mgf');
      writeFileSync(scene, room + fog + clip);
      const submit = (...options) => Number(farm.femc('submit', scene, ...options).trim().split('\n').at(-1));
      const job = submit('--frames', '1..5', '--size', '32x32', '--spp', '64', '--owner', 'ann');
      const other = submit('--frames', '1..2', '--size', '64x64', '--spp', '256', '--owner', 'bob');
      farm.worker('alone');
      const base = `${farm.url}/api/v1/jobs`;
      const answer = async (path) => (await fetch(`${base}/${path}`)).json();
      await until(() => [job, other].every((id) => farm.job(id).state === 'done'), 'both jobs are done', 240);

      const { frames, processor_seconds, wall_seconds } = await answer(`${job}/frames`);
      const most = (key) => frames.toSorted((a, b) => b[key] - a[key])[0].frame;
      equal(most('processor_seconds'), 3, 'the slow frame by processor seconds');
      equal(most('wall_seconds'), 3, 'the slow frame by seconds at workers');
      const sum = (key) => frames.reduce((all, frame) => all + frame[key], 0);
      const near = (is, due, what) => claim(Math.abs(is - due) <= 1e-6 * due, `${what}: ${is}, not ${due}`);
      near(sum('processor_seconds'), processor_seconds, 'processor seconds of the job');
      near(sum('wall_seconds'), wall_seconds, 'seconds at workers of the job');
      claim(sum('processor_seconds') < sum('seconds'), 'the time of the other job is in no processor seconds');
      claim(frames.every((frame) => frame.waiting_seconds >= 0), 'waiting is not negative');
      claim(frames.some((frame) => frame.waiting_seconds > 0), 'frames waited for the other job');

      // The terminal agrees.
      const status = JSON.parse(farm.femc('status', String(job), '--json'));
      equal(status.slowest_frame.frame, 3, 'the slow frame of femc status --json');
      near(status.slowest_frame.processor_seconds, frames.find(({ frame }) => frame === 3).processor_seconds, 'its time');
      claim(/^slowest  frame 3: /m.test(farm.femc('status', String(job))), 'femc status names frame 3');
      const rows = JSON.parse(farm.femc('stats', String(job), '--json'));
      for (const row of rows.filter((row) => row.frame)) {
        const frame = frames.find((it) => it.frame === row.frame);
        near(row.cpu_seconds, frame.processor_seconds, `processor seconds of frame ${row.frame}`);
        near(row.wall_seconds, frame.wall_seconds, `wall seconds of frame ${row.frame}`);
      }

      // Tasks of finished frames keep who did them, and are sorted over all pages.
      const { total, tasks } = await answer(`${job}/tasks?sort=-processor_seconds&count=3`);
      claim(total > 3 && tasks.length === 3, `three of ${total} tasks`);
      equal(tasks[0].frame, 3, 'the task of the most processor time');
      const all = (await answer(`${job}/tasks`)).tasks;
      equal(Math.max(...all.map((task) => task.processor_seconds)), tasks[0].processor_seconds, 'the greatest of all');
      claim(all.every((task) => task.workers[0] === 'alone' && task.attempts >= 1), 'each task keeps its worker');
      near(all.reduce((n, task) => n + task.processor_seconds, 0), sum('processor_seconds'), 'processor seconds of tasks');
      const bad = await fetch(`${base}/${job}/tasks?sort=cpu`);
      equal(bad.status, 400, 'a bad column');
      claim((await bad.json()).error.message.includes('processor_seconds'), 'the error names the columns');

      // The page agrees.
      page = await open(farm);
      await page.goto(`/jobs/${job}`);
      await page.locator('[data-slowest]', { hasText: '3: CPU' }).waitFor();
      await page.goto(`/jobs/${job}?size=table`);
      const head = page.getByRole('columnheader', { name: 'Processor' });
      await head.getByRole('button').focus();
      await page.keyboard.press('Enter');
      await until(async () => (await head.getAttribute('aria-sort')) === 'descending', 'frames are sorted by a key', 5);
      const first = page.locator('.row.body').first().getByRole('cell');
      equal(await first.nth(0).textContent(), '3', 'the first frame of the sorted table');
      const due = frames.find(({ frame }) => frame === 3);
      claim(Math.abs(number(await first.nth(2).textContent()) - due.processor_seconds) <= 0.06, 'its processor time');
      await page.goto(`/jobs/${job}/tasks`);
      await page.getByRole('columnheader', { name: 'CPU' }).getByRole('button').click();
      await until(() => page.locator('.row.body', { hasText: tasks[0].task }).first().isVisible(), 'the slowest task', 10);
      equal(await page.locator('.row.body').first().getByRole('cell').first().textContent(), tasks[0].task, 'the first task');
      await page.goto('/workers');
      const name = page.getByRole('columnheader', { name: 'Name' });
      await name.getByRole('button').click();
      equal(await name.getAttribute('aria-sort'), 'ascending', 'workers are sorted by name');
    } finally {
      await page?.context().close();
      await farm.end();
    }
  });
}
