/** Page of plot-bench.mjs: a plot of made-up paths. Address: `?rows=10000&sets=2&height=320`. */
import { mount } from 'svelte';
import '../../../src/app.css';
import { prepare } from './data';
import Host from './Host.svelte';

const theme = new URLSearchParams(location.search).get('theme');
if (theme) document.documentElement.dataset.theme = theme;
const query = new URLSearchParams(location.search);
const data = prepare(Number(query.get('rows') ?? 10_000), Number(query.get('sets') ?? 1));
// The data are prepared before the clock of the plot starts.
setTimeout(() => {
  performance.mark('mount');
  mount(Host, { target: document.getElementById('app')!, props: { data } });
}, 300);
