/** A farm of real processes in a folder of its own. */
import { execFileSync, spawn } from 'node:child_process';
import {
  appendFileSync,
  chmodSync,
  existsSync,
  mkdtempSync,
  readdirSync,
  readFileSync,
  rmSync,
  writeFileSync,
} from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

export const root = join(dirname(fileURLToPath(import.meta.url)), '../../..');

/** The program under test: $FEMC, or what cargo has built last for release or for tests. */
export function program() {
  const target = process.env.CARGO_TARGET_DIR ?? join(root, 'target');
  const found = [process.env.FEMC, join(target, 'release/femc'), join(target, 'debug/femc')].find(
    (path) => path && existsSync(path),
  );
  if (!found) throw new Error('there is no femc: cargo build --release -p femc, or say FEMC=PATH');
  return found;
}

export const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Waits until `what` gives something, and gives it. */
export async function until(what, title, seconds = 30) {
  const end = Date.now() + 1000 * seconds;
  for (;;) {
    const got = await what();
    if (got) return got;
    if (Date.now() > end) throw new Error(`not within ${seconds} s: ${title}`);
    await pause(100);
  }
}

async function freePort() {
  const server = createServer();
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const { port } = server.address();
  await new Promise((resolve) => server.close(resolve));
  return port;
}

export class Farm {
  /** - `options`: further ones of the coordinator. */
  static async start(options = [], env = {}) {
    const farm = new Farm();
    farm.folder = mkdtempSync(join(tmpdir(), 'femc-e2e-'));
    farm.port = await freePort();
    farm.url = `http://127.0.0.1:${farm.port}`;
    farm.options = options;
    farm.env = { ...process.env, HOME: farm.folder, FEMC_SERVER: farm.url, ...env };
    farm.workers = new Map();
    return farm;
  }

  launch(name, args, env = {}) {
    const child = spawn(program(), args, {
      cwd: this.folder,
      env: { ...this.env, ...env },
      stdio: ['ignore', 'pipe', 'pipe'],
    });
    const log = join(this.folder, `${name}.log`);
    for (const stream of [child.stdout, child.stderr]) stream.on('data', (data) => appendFileSync(log, data));
    return child;
  }

  async coordinator() {
    const listen = ['coordinator', '--listen', `127.0.0.1:${this.port}`, '--store', 'sqlite:farm.db'];
    this.leader = this.launch('coordinator', [...listen, '--artifacts', 'artifacts', ...this.options]);
    await until(
      () =>
        fetch(`${this.url}/`).then(
          (it) => it.status > 0,
          () => false,
        ),
      'the coordinator listens',
    );
  }

  worker(name, options = [], env = {}) {
    const args = ['worker', '--join', this.url, '--threads', '1', '--name', name, '--outbox', `outbox-${name}`];
    this.workers.set(name, this.launch(name, [...args, ...options], env));
  }

  /** Ends a process at once, as a loss of power would. */
  async kill(child) {
    if (child.exitCode !== null || child.signalCode !== null) return;
    const gone = new Promise((resolve) => child.once('exit', resolve));
    child.kill('SIGKILL');
    await gone;
  }

  /** Runs a command; what it prints. */
  femc(...args) {
    return execFileSync(program(), args, {
      cwd: this.folder,
      env: this.env,
      encoding: 'utf8',
      stdio: ['ignore', 'pipe', 'pipe'],
    });
  }

  /** Queues a scene of the project; the job's number. */
  submit(scene, ...options) {
    const out = this.femc('submit', join(root, 'scenes', scene), ...options);
    return Number(out.trim().split('\n').at(-1));
  }

  job(number) {
    return JSON.parse(this.femc('jobs', '--json')).find((job) => job.job === number);
  }

  /** Where an artifact lies in the store; nothing where there is none. */
  artifact(digest) {
    const store = join(this.folder, 'artifacts');
    const path = readdirSync(store, { recursive: true }).find((it) => it.replaceAll('/', '').endsWith(digest));
    return path && join(store, path);
  }

  /** Changes a byte of an artifact; false where there is none. */
  damage(digest) {
    const path = this.artifact(digest);
    if (!path) return false;
    const bytes = readFileSync(path);
    bytes[bytes.length >> 1] ^= 255;
    chmodSync(path, 0o644);
    writeFileSync(path, bytes);
    return true;
  }

  token(name) {
    return readFileSync(join(this.folder, `${name}.token`), 'utf8').split('\n')[0];
  }

  async end() {
    for (const child of [...this.workers.values(), this.leader]) if (child) await this.kill(child);
    if (!process.env.FEMC_KEEP) rmSync(this.folder, { recursive: true, force: true });
  }
}
