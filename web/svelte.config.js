import { vitePreprocess } from '@sveltejs/vite-plugin-svelte';

/** @type {import('@sveltejs/vite-plugin-svelte').SvelteConfig} */
export default {
  preprocess: vitePreprocess(),
  // Styles go into the style sheet: the pages' content security policy refuses what is injected.
  compilerOptions: { css: 'external', runes: true },
};
