/** Links within the pages: a click changes the view; a click with a modifier opens a tab, as on any page. */

import { parseAddress, parsePath } from './route';
import { views } from './stores.svelte';

/** A Svelte action for `<a href>`. */
export function link(node: HTMLAnchorElement) {
  const onclick = (event: MouseEvent) => {
    if (
      event.defaultPrevented ||
      event.button !== 0 ||
      event.ctrlKey ||
      event.metaKey ||
      event.shiftKey ||
      event.altKey
    )
      return;
    event.preventDefault();
    views.go(parsePath(node.pathname), parseAddress(node));
  };
  node.addEventListener('click', onclick);
  return { destroy: () => node.removeEventListener('click', onclick) };
}
