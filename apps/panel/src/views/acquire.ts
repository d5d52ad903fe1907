// The paper's 3.1: what the cameras see now, frozen and stored. Focus and skew stand beside it.

import '../pictures/pictures.css';
import { card, h, number, write } from '../dom';
import type { Link } from '../link';
import { offer } from '../pictures/bench';
import { Pane } from '../pictures/pane';

export const id = 'acquire';
export const title = 'Acquire';
export const order = 30;

interface State {
  cameras: number;
  seen: number;
  frozen: boolean;
  is_stored: boolean;
  stored: number;
  ended: boolean;
  focus: (number | null)[];
  best_focus: (number | null)[];
  saturated_share: (number | null)[];
  names: string[];
  skew_s: number | null;
  trouble: string;
}
interface CompressedImage {
  data: string;
  format: string;
}

const SIDES = ['left', 'right'];
const STALE_MS = 2500; // a state comes each half second

class Focus {
  readonly root: HTMLElement;
  private readonly value = h('dd', {}, '–');

  constructor(name: string) {
    this.root = h('div', { class: 'focus' }, h('dt', {}, name), this.value);
  }

  show(now: number | null, best: number | null): void {
    write(this.value, `${number(now, 1)} (best ${number(best, 1)})`);
    this.root.style.setProperty('--share', now && best ? `${Math.round((100 * now) / best)}%` : '0%');
  }
}

export function mount(root: HTMLElement, link: Link): void {
  const panes = [new Pane('Left'), new Pane('Right')];
  const word = h('p', { class: 'state-word' }, 'waiting');
  const trouble = h('p', { class: 'error', role: 'alert', hidden: true });
  const told = h('p', { class: 'told', role: 'status' });
  const why = h('p', { class: 'note' });
  const freeze = h('button', { type: 'button', id: 'freeze', click: () => void give('Freeze', { on: !(state?.frozen ?? false) }) }, 'Freeze');
  const store = h('button', { type: 'button', id: 'store', click: () => void give('Store', {}) }, 'Store');
  const focus = [new Focus('Focus, left'), new Focus('Focus, right')];
  const facts = ['Skew of the pair', 'Pictures', 'Stored', 'At white'].map((name) => ({ name, value: h('dd', {}, '–') }));
  const names = h('p', { class: 'note names' });
  let state: State | null = null;
  let heard_ms = 0;
  let ends: (() => void)[] = [];

  const give = async (service: string, request: object) => {
    const answer = await link.call(service, request, 15);
    const stored = answer.response as { folder?: string; frame?: string } | undefined;
    told.className = `told ${answer.ok ? 'good' : 'bad'}`;
    write(told, `${service}: ${answer.ok && stored?.frame ? `as frame ${stored.frame} of ${stored.folder}` : answer.text}`);
  };

  const update = () => {
    const fresh = link.state === 'live' && performance.now() - heard_ms < STALE_MS;
    const s = fresh ? state : null;
    write(word, !s ? (link.state === 'live' ? 'Waiting for pictures' : 'No link') : s.frozen ? 'Frozen' : s.ended ? 'The source has ended' : s.seen ? 'Live' : 'Waiting for pictures');
    write(freeze, s?.frozen ? 'Go on' : 'Freeze');
    freeze.disabled = !link.leads || !s?.seen;
    store.disabled = !link.leads || !s?.seen || s.is_stored;
    store.classList.toggle('main', !store.disabled && (s?.frozen ?? false));
    write(why, link.leads ? (s?.is_stored ? 'This picture is stored.' : '') : 'Freezing and storing is for who leads: there is one head. Take control to do it.');
    why.hidden = !why.textContent;
    const wrong = link.state === 'live' ? (state?.trouble ?? '') : '';
    trouble.hidden = !wrong;
    write(trouble, wrong);
    root.classList.toggle('stale', !fresh && heard_ms > 0);
  };

  const take = (s: State) => {
    state = { ...s, focus: s.focus ?? [], best_focus: s.best_focus ?? [], names: s.names ?? [], saturated_share: s.saturated_share ?? [] };
    if (s.seen !== undefined) heard_ms = performance.now();
    const two = s.cameras === 2;
    panes[1].root.hidden = focus[1].root.hidden = !two;
    state.focus.forEach((f, k) => focus[k].show(f, state!.best_focus[k]));
    const white = state.saturated_share.map((w) => `${number(100 * (w ?? 0), 2)} %`).join(', ');
    const values = [s.skew_s === null || s.skew_s === undefined ? (two ? 'not told' : 'one camera') : `${number(1e3 * s.skew_s, 1)} ms`, String(s.seen ?? 0), String(s.stored ?? 0), white || '–'];
    facts.forEach((f, k) => write(f.value, values[k]));
    write(names, state.names.join(', '));
    update();
  };

  // Watched only while it is seen: the server then acquires, and rests otherwise.
  const watch = () => {
    if (root.hidden || ends.length) return;
    ends = [link.on<State>('/acquire', take), ...SIDES.map((side, k) => link.on<CompressedImage>(`/acquire/${side}`, (m) => void panes[k].show(m.format, m.data)))];
  };
  const rest = () => {
    for (const end of ends) end();
    ends = [];
  };
  new MutationObserver(() => (root.hidden ? rest() : watch())).observe(root, { attributes: true, attributeFilter: ['hidden'] });
  setInterval(update, 500);
  link.onChange(update);

  const shown = h(
    'div',
    { class: 'bench' },
    h(
      'div',
      { class: 'side' },
      card('Acquire', word, trouble, why, h('div', { class: 'orders' }, freeze, store), told),
      card('Lens and light', h('dl', { class: 'facts' }, ...focus.map((f) => f.root), ...facts.map((f) => h('div', {}, h('dt', {}, f.name), f.value))), names, h('p', { class: 'note' }, 'Focus is told by how sharp the picture is beside its contrast: turn the lens while the scene stays, until it is largest.')),
    ),
    h('div', { class: 'wide' }, card('Live', h('div', { class: 'panes' }, ...panes.map((p) => p.root)), h('p', { class: 'note' }, 'What is stored can be looked at, calibrated and matched in ', h('a', { href: '#calibrate' }, 'Calibrate'), ' and ', h('a', { href: '#match' }, 'Match'), ', as “acquired”.'))),
  );
  offer(root, link, 'Store', shown);
  // To zoom in on while focusing, a pane needs its loupe: a click does nothing else.
  for (const p of panes) p.onPick = () => undefined;
  watch();
}
