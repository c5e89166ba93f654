import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vitest/config';

export default defineConfig({
  plugins: [svelte()],
  build: {
    target: 'es2022',
    // Data addresses are refused by the content security policy.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    reportCompressedSize: true,
    // The licenses of the packages that are part of the pages.
    license: { fileName: 'licenses.txt' },
    // The scene view has a chunk of its own, which is loaded when the view is opened.
    chunkSizeWarningLimit: 700,
  },
  // For work on the pages: `npx vite` beside a coordinator on its usual port.
  server: {
    proxy: { '/api': 'http://127.0.0.1:7878', '/login': 'http://127.0.0.1:7878', '/logout': 'http://127.0.0.1:7878' },
  },
  test: { include: ['tests/unit/**/*.test.ts'], environment: 'node' },
});
