/** Page of plot-bench.mjs: a plot of made-up paths. Address: `?rows=10000&sets=2&height=320`. */
import { mount } from 'svelte';
import '../../../src/app.css';
import Host from './Host.svelte';

const theme = new URLSearchParams(location.search).get('theme');
if (theme) document.documentElement.dataset.theme = theme;
mount(Host, { target: document.getElementById('app')! });
