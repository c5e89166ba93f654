import './app.css';
import { mount } from 'svelte';
import App from './App.svelte';
import { farm } from './lib/stores.svelte';

farm.start();
mount(App, { target: document.getElementById('app')! });
