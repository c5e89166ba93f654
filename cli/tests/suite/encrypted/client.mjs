// Speaks to an encrypted coordinator with fetch: client.mjs URL JOB FILE.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';

const [url, job, file] = process.argv.slice(2);
const bearer = (user) => ({ Authorization: `Bearer ${process.env[user]}` });
const change = { 'Content-Type': 'application/json', 'X-Femc': '1' };

for (const line of readFileSync(file, 'utf8').trim().split('\n')) {
  const [status, path] = line.split(' ');
  const answer = await fetch(url + path, { headers: bearer('OPERATOR') });
  // An operator may not read the record.
  const wanted = path.startsWith('/api/v1/audit') ? 403 : Number(status);
  assert.equal(answer.status, wanted, path);
  const body = await answer.arrayBuffer();
  assert.equal(body.byteLength > 0, wanted !== 204, path);
}
const steer = { jobs: [Number(job)], action: 'retry' };
const post = (path, user, body) =>
  fetch(url + path, { method: 'POST', headers: { ...bearer(user), ...change }, body });
const steered = await post('/api/v1/jobs/control', 'OPERATOR', JSON.stringify(steer));
assert.equal(steered.status, 200);
assert.equal((await steered.json()).refused[0].code, 'ended');
const refused = await post('/api/v1/workers/drain', 'VIEWER', ' '.repeat(60000));
assert.equal(refused.status, 403);
assert.equal((await refused.json()).error.code, 'forbidden');
const login = await fetch(`${url}/login`, {
  method: 'POST',
  body: new URLSearchParams({ token: process.env.VIEWER }),
  redirect: 'manual',
});
assert.equal(login.status, 303);
const cookie = login.headers.get('set-cookie').split(';')[0];
const me = await fetch(`${url}/api/v1/me`, { headers: { Cookie: cookie } });
assert.equal((await me.json()).name, 'eve');
const feed = await fetch(`${url}/api/v1/feed`, { headers: bearer('VIEWER') });
const reader = feed.body.pipeThrough(new TextDecoderStream()).getReader();
let text = '';
while (!text.includes('event: ')) text += (await reader.read()).value;
assert.match(text, /event: snapshot/);
await reader.cancel();
console.log('fetch: done');
