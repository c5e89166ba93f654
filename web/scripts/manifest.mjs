/**
 * Writes `web/dist/manifest.sha256`, the digests of the sources and of the built pages. `web/check` uses them to check
 * without Node that the pages match the sources. The lines have the format of `sha256sum`, with paths relative to `web/`.
 */
import { createHash } from 'node:crypto';
import { readdirSync, readFileSync, writeFileSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

const web = join(dirname(fileURLToPath(import.meta.url)), '..');
const SOURCES = [
  '.npmrc',
  'index.html',
  'package-lock.json',
  'package.json',
  'svelte.config.js',
  'tsconfig.json',
  'vite.config.ts',
];
const FOLDERS = ['dist', 'public', 'scripts', 'src'];
const MANIFEST = 'dist/manifest.sha256';

const files = [...SOURCES];
for (const folder of FOLDERS) {
  for (const entry of readdirSync(join(web, folder), { recursive: true, withFileTypes: true })) {
    if (entry.isFile()) files.push(join(entry.parentPath, entry.name).slice(web.length + 1));
  }
}
const lines = files
  .map((file) => file.replaceAll('\\', '/'))
  .filter((file) => file !== MANIFEST)
  .sort((a, b) => (a < b ? -1 : 1))
  .map(
    (file) =>
      `${createHash('sha256')
        .update(readFileSync(join(web, file)))
        .digest('hex')}  ${file}\n`,
  );
writeFileSync(join(web, MANIFEST), lines.join(''));
