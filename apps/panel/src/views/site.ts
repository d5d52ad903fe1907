// The paper's 3D viewer. What draws is large, and comes when this view is first opened.

import { h } from '../dom';
import type { Link } from '../link';

export const id = 'site';
export const title = 'Site';
export const order = 20;

export function mount(root: HTMLElement, link: Link): void {
  const wait = h('p', { class: 'note', role: 'status' }, 'Loading the viewer …');
  root.append(wait);
  import('../site/site').then(
    (site) => {
      wait.remove();
      site.mount(root, link);
    },
    (why: unknown) => (wait.textContent = `The viewer cannot be shown here: ${String(why)}`),
  );
}
