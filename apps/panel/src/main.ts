// The operator's page: a frame around views, over one link to the server that serves it.
//
// A view is a file in src/views that exports
//
//   export const id = 'acquire';        // in the address: #acquire
//   export const title = 'Acquire';     // in the navigation
//   export const order = 30;            // its place there
//   export function mount(root: HTMLElement, link: Link): void { … }
//
// and nothing else has to know of it. `mount` is called once, when the view is first shown; afterwards root.hidden says
// whether it is seen, and the event "shown" on root that it is again. What the view shows comes from link.on(topic, f) and
// link.onChange(f); what it asks for goes through link.call and link.set, which answer and never throw. Heavy parts are
// imported by the view when they are needed, as views/site.ts does.
//
// Rules that hold for all views: a card (dom.ts) marks the age of what it shows by itself; nothing that is old looks new;
// an order that is not taken now is a disabled button; colours are those of style.css, which are the reports'.
//
// The token of a server that asks for one stands in the address (?token=…). It is given on to the socket, kept for this tab
// alone, and taken out of the address.

import './style.css';
import { h, inMotion, write } from './dom';
import { Link } from './link';
import { Orders } from './orders';

export interface View {
  id: string;
  title: string;
  order: number;
  mount(root: HTMLElement, link: Link): void;
}

const views = Object.values(import.meta.glob<View>('./views/*.ts', { eager: true })).sort((a, b) => a.order - b.order);

function token(): string {
  const address = new URL(location.href);
  const given = address.searchParams.get('token');
  if (given !== null) {
    sessionStorage.setItem('token', given);
    address.searchParams.delete('token');
    history.replaceState(null, '', address);
  }
  const kept = sessionStorage.getItem('token');
  return kept ? `?token=${encodeURIComponent(kept)}` : '';
}

const link = new Link(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/${token()}`);
const orders = new Orders(link);

// ---- the frame ----

const scenario = h('span', { class: 'scenario' });
const phase = h('strong', { class: 'phase-word' }, 'connecting');
const step = h('span', { class: 'step' });
const pill = h('span', { class: 'pill', id: 'link' }, 'connecting');
const holder = h('span', { class: 'holder' });
const take = h('button', { type: 'button', id: 'take', 'aria-keyshortcuts': 't', click: () => void orders.give('TakeControl') }, 'Take control');
const release = h('button', { type: 'button', id: 'release', click: () => void orders.give('ReleaseControl') }, 'Release control');
const stop = h(
  'button',
  { type: 'button', class: 'stop', id: 'stop', 'aria-keyshortcuts': 'Escape', click: () => void orders.stop() },
  'UserStop',
  h('kbd', {}, 'Esc'),
);
const notice = h('div', { class: 'notice', role: 'alert', hidden: true });
const nav = h('nav', { 'aria-label': 'Views' });
const main = h('main', { tabindex: -1 });

document.body.append(
  h('a', { class: 'skip', href: '#main' }, 'To the view'),
  h(
    'header',
    { class: 'top' },
    h('h1', {}, 'Teledimos', scenario),
    h('div', { class: 'now', role: 'status' }, phase, step),
    pill,
    h('div', { class: 'control' }, holder, take, release),
    stop,
  ),
  nav,
  notice,
  main,
);
main.id = 'main';

const mounted = new Map<string, HTMLElement>();
const tabs = new Map<string, HTMLAnchorElement>();
for (const view of views) {
  const tab = h('a', { href: `#${view.id}` }, view.title);
  tabs.set(view.id, tab);
  nav.append(tab);
}

function show(id: string): void {
  const view = views.find((v) => v.id === id) ?? views[0];
  let root = mounted.get(view.id);
  for (const other of mounted.values()) other.hidden = true;
  for (const [name, tab] of tabs) {
    if (name === view.id) tab.setAttribute('aria-current', 'page');
    else tab.removeAttribute('aria-current');
  }
  document.title = `${view.title} · Teledimos panel`;
  if (!root) {
    root = h('div', { class: `view ${view.id}` });
    mounted.set(view.id, root);
    main.append(root);
    view.mount(root, link);
  }
  root.hidden = false;
  root.dispatchEvent(new Event('shown'));
}
addEventListener('hashchange', () => {
  if (location.hash !== '#main') show(location.hash.slice(1));
});
show(location.hash.slice(1));

// ---- what is always told ----

function since(seconds: number): string {
  return seconds < 10 ? `${seconds.toFixed(1)} s` : seconds < 100 ? `${Math.round(seconds)} s` : `${Math.round(seconds / 60)} min`;
}

const WORDS = { connecting: 'no link', silent: 'link silent', frozen: 'session stands', live: 'live' } as const;

function tellAge(): void {
  const lost = link.state !== 'live';
  const age = since(link.age_s);
  write(pill, lost && link.everLive ? `${WORDS[link.state]} · ${age} old` : link.state === 'connecting' ? 'connecting' : WORDS[link.state]);
  for (const e of document.querySelectorAll('.age')) write(e, lost && link.everLive ? `${age} old` : '');
}
setInterval(tellAge, 200);

link.onChange(() => {
  const { state, session } = link;
  const lost = state !== 'live';
  document.body.dataset.link = state;
  document.body.classList.toggle('lost', lost);
  document.body.classList.toggle('leads', link.leads);
  write(scenario, link.panel ? link.panel.scenario : '');
  write(phase, session ? session.phase : link.everLive ? phase.textContent! : 'waiting for the machine');
  document.body.dataset.phase = session?.phase ?? '';
  const failed = session?.phase.startsWith('failed') ?? false;
  phase.className = `phase-word ${failed ? 'bad' : ''}`;
  write(step, session && session.steps > 0 && session.step > 0 && inMotion(session.phase) ? `step ${session.step} of ${session.steps}` : '');
  const operator = session?.operator ?? 0;
  write(holder, lost ? '' : link.leads ? 'You lead' : operator ? `Client ${operator} leads` : 'Nobody leads');
  take.hidden = lost || operator !== 0;
  release.hidden = !link.leads;
  notice.hidden = !lost || !link.everLive;
  if (lost)
    write(
      notice,
      state === 'frozen'
        ? 'The server answers, but the session does not: what is shown is old.'
        : 'The link is down: what is shown is old. The machine is stopped by its server when the link of who leads is lost. This page connects again by itself.',
    );
  tellAge();
});

// A link that never was: the server may not let this page in.
setTimeout(async () => {
  if (link.everLive || link.state === 'live') return;
  const there = await fetch('connect', { cache: 'no-store' }).then(
    (r) => r.ok,
    () => false,
  );
  if (link.everLive) return;
  notice.hidden = false;
  write(notice, there ? 'The server does not let this page in. If it asks for a token, open the page with ?token=… at the end of its address.' : 'The server cannot be reached. This page goes on trying.');
}, 2500);

addEventListener('keydown', (event) => orders.key(event));
addEventListener('keyup', (event) => orders.keyUp(event));
