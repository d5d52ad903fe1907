// The paper's control panel (figure 3) and its plotter (figures 4 and 5): parameters, orders, the state of the logic, curves
// of what is wanted and what is.

import { BehaviourView } from '../behaviour';
import { card, degrees, h, inMotion, newId, number, write } from '../dom';
import { Fields } from '../fields';
import type { Link } from '../link';
import type { Diagnostics, Far, JointStates, Log, PoseInFrame, Session } from '../messages';
import { JOG_KEYS, ORDERS, Orders } from '../orders';
import { Plot, Store } from '../plot';

export const id = 'simulate';
export const title = 'Simulate';
export const order = 10;

const AXES = ['x', 'y', 'z'] as const;
const KEY_NAMES: Record<string, string> = { ArrowLeft: '←', ArrowRight: '→', ArrowDown: '↓', ArrowUp: '↑' };
const EVENTS_SHOWN = 200;

// ---- orders ----

function ordersCard(link: Link): HTMLElement {
  const orders = Orders.of.get(link)!;
  const buttons = ORDERS.map((o) => ({
    order: o,
    button: h('button', { type: 'button', id: `order-${o.name}`, 'aria-keyshortcuts': o.shown.replace('⇧ ', 'Shift+'), click: () => void orders.give(o.name) }, o.name, h('kbd', {}, o.shown)),
  }));
  const told = h('p', { class: 'told', role: 'status' });
  const why = h('p', { class: 'note' });
  const keys = h('input', { type: 'checkbox', id: newId(), change: () => orders.setKeys(keys.checked) });
  keys.checked = orders.keys;
  orders.onTold(({ what, answer }) => {
    told.className = `told ${answer.ok ? 'good' : 'bad'}`;
    write(told, `${what}: ${answer.text}`);
  });
  link.onChange(() => {
    const next = ['Resume', 'StartSim', 'Validate', 'Download', 'Execute', 'Reinit', 'Prepare'].find((name) => link.offers(name) && !(name === 'Download' && !link.offers('Download')));
    for (const { order: o, button } of buttons) {
      button.disabled = !link.offers(o.name);
      button.classList.toggle('main', o.name === next);
    }
    write(why, link.state !== 'live' ? 'No link: no order can be given.' : link.leads ? '' : link.session?.operator ? 'Another client leads: you watch.' : 'Take control to lead.');
    why.hidden = why.textContent === '';
  });
  return card('Orders', why, h('div', { class: 'orders' }, ...buttons.map((b) => b.button)), told, h('p', { class: 'note keys' }, keys, h('label', { for: keys.id }, 'Letters are orders (Esc is UserStop always)')));
}

// ---- by hand ----

function jogButton(orders: Orders, joint: string, sign: number, label: string, key: string): HTMLButtonElement {
  const button = h('button', { type: 'button', class: 'jog', 'aria-label': label, title: `hold (${KEY_NAMES[key] ?? key})` }, sign < 0 ? '−' : '+', h('kbd', { 'data-key': KEY_NAMES[key] ?? key }));
  const press = () => orders.hold(joint, sign);
  const end = () => orders.release();
  button.addEventListener('pointerdown', (event) => {
    button.setPointerCapture(event.pointerId);
    press();
  });
  for (const name of ['pointerup', 'pointercancel', 'blur'] as const) button.addEventListener(name, end);
  button.addEventListener('keydown', (event) => {
    if (event.key === ' ' || event.key === 'Enter') press();
  });
  button.addEventListener('keyup', end);
  button.addEventListener('contextmenu', (event) => event.preventDefault());
  return button;
}

function manualCard(link: Link): HTMLElement {
  const orders = Orders.of.get(link)!;
  const rows = h('div', { class: 'jogs' });
  const share = h('output', {}, '50 %');
  const stick = h('input', { type: 'range', id: newId(), min: 5, max: 100, step: 5, value: 50 });
  stick.addEventListener('input', () => {
    orders.stick = Number(stick.value) / 100;
    write(share, `${stick.value} %`);
  });
  let made = '';
  link.onChange(() => {
    const joints = link.panel?.joints ?? [];
    if (made !== joints.map((j) => j.name).join()) {
      made = joints.map((j) => j.name).join();
      rows.replaceChildren(
        ...joints.map((j, i) => {
          const [less, more] = JOG_KEYS[i] ?? ['', ''];
          return h('div', { class: 'row' }, h('span', {}, j.name), jogButton(orders, j.name, -1, `${j.name} backwards, hold`, less), jogButton(orders, j.name, 1, `${j.name} forwards, hold`, more));
        }),
      );
    }
    for (const b of rows.querySelectorAll('button')) b.disabled = !link.offers('Jog');
  });
  return card('By hand', h('p', { class: 'note' }, 'In manual: hold a button or its key.'), rows, h('div', { class: 'row stick' }, h('label', { for: stick.id }, 'Speed'), stick, share));
}

// ---- what happens ----

function eventsCard(link: Link): HTMLElement {
  const body = h('tbody', {});
  let last = -1;
  link.on<Log>('/log', (log, time_s) => {
    if (time_s < last) body.replaceChildren();
    last = time_s;
    const [kind, ...rest] = log.message.split(': ');
    const text = rest[0] === kind ? rest.slice(1).join(': ') : rest.join(': ');
    if (text.includes('a deadline was missed, and forgiven')) return; // its report tells it
    const bad = kind === 'fault';
    const before = body.rows[0];
    if (before && before.dataset.text === log.message) {
      const times = Number(before.dataset.times ?? 1) + 1;
      before.dataset.times = String(times);
      write(before.cells[0], `${number(time_s, 2)} s`);
      write(before.cells[2], `${text}, ${times} times`);
      return;
    }
    const row = h('tr', { class: bad ? 'bad' : log.level >= 3 ? 'warn' : '' }, h('td', { class: 'n' }, `${number(time_s, 2)} s`), h('td', {}, kind), h('td', { class: 'text-cell' }, text || log.message));
    row.dataset.text = log.message;
    body.prepend(row);
    while (body.rows.length > EVENTS_SHOWN) body.lastElementChild!.remove();
  });
  const box = h('div', { class: 'scroll', tabindex: 0, role: 'region', 'aria-label': 'Events, newest first' }, h('table', {}, h('thead', {}, h('tr', {}, h('th', { class: 'n', scope: 'col' }, 'Time'), h('th', { scope: 'col' }, 'Kind'), h('th', { scope: 'col' }, 'Event'))), body));
  return card('Events', box);
}

function timingCard(link: Link): HTMLElement {
  const rows = ['Real time', 'Deadlines missed', 'Late (99 %)', 'Latest', 'Session’s time', 'Watching'].map((name) => ({ name, value: h('dd', {}, '–') }));
  const list = h('dl', { class: 'facts' }, ...rows.map((r) => h('div', {}, h('dt', {}, r.name), r.value)));
  link.on<Diagnostics>('/diagnostics', (d) => {
    const values = [`× ${number(d.real_time_factor, 3)}`, `${d.misses} of ${d.ticks}`, `${number(1e3 * d.late_p99_s, 2)} ms`, `${number(1e3 * d.late_max_s, 2)} ms`, `${number(link.time_s, 1)} s`, d.clients === 1 ? 'you alone' : `${d.clients} clients`];
    rows.forEach((r, i) => write(r.value, values[i]));
    rows[1].value.parentElement!.className = d.misses > 0 ? 'warn' : '';
  });
  return card('Real time', list);
}

/** The machine that does what was simulated here, where the panel leads one. */
function machineCard(link: Link): HTMLElement {
  const names = ['Link', 'It says', 'Fault', 'Round trip', 'Sent again', 'Its state is', 'Its pictures are'];
  const rows = names.map((name) => ({ name, value: h('dd', {}, '–') }));
  const list = h('dl', { class: 'facts' }, ...rows.map((r) => h('div', {}, h('dt', {}, r.name), r.value)));
  const root = card('Machine elsewhere', list);
  root.id = 'machine';
  root.hidden = true;
  const old = (s: number | null) => (s === null ? 'not known' : `${number(s, 2)} s old`);
  link.on<Far>('/link', (m) => {
    root.hidden = false;
    const values = [m.open ? 'open' : `lost: ${m.why}`, m.phase || '–', m.fault || 'none', `${number(1e3 * m.round_trip_mean_s, 2)} ms`, `${number(100 * m.lost_share, 1)} %`, old(m.state_age_s), old(m.image_age_s)];
    rows.forEach((r, i) => write(r.value, values[i]));
    rows[0].value.parentElement!.className = m.open ? '' : 'bad';
    rows[1].value.parentElement!.className = 'long';
    rows[2].value.parentElement!.className = m.fault && m.fault !== 'none' ? 'bad' : '';
  });
  return root;
}

// ---- numbers and curves ----

type Row = { name: string; cells: HTMLElement[] };

function table(heads: string[], caption: string): { root: HTMLElement; body: HTMLTableSectionElement } {
  const body = h('tbody', {});
  const root = h(
    'div',
    { class: 'scroll plainly', tabindex: 0, role: 'region', 'aria-label': caption },
    h('table', {}, h('caption', { class: 'hidden' }, caption), h('thead', {}, h('tr', {}, ...heads.map((t, i) => h('th', { scope: 'col', class: i ? 'n' : '' }, t)))), body),
  );
  return { root, body };
}

function row(body: HTMLElement, name: string, count: number): Row {
  const cells = Array.from({ length: count }, () => h('td', { class: 'n' }, '–'));
  body.append(h('tr', {}, h('th', { scope: 'row' }, name), ...cells));
  return { name, cells };
}

class Curves {
  readonly root: HTMLElement;
  private readonly tool = new Store(9); // actual, desired, difference
  private joints: Store | null = null;
  private plots: Plot[] = [];
  private readonly grid = h('div', { class: 'plots' });
  private readonly toolTable = table(['Tool', 'desired m', 'actual m', 'difference mm'], 'The tool’s place, desired and actual');
  private readonly jointTable = table(['Joint', 'desired °', 'actual °', 'rate °/s', 'force kN'], 'The joints, desired and actual');
  private toolRows: Row[] = [];
  private jointRows: Row[] = [];
  private wantedTool: PoseInFrame | null = null;
  private wantedJoints: JointStates | null = null;
  private dirty = false;
  private window_s = 30;

  constructor(
    private readonly link: Link,
    private readonly view: HTMLElement,
  ) {
    this.toolRows = AXES.map((a) => row(this.toolTable.body, a, 3));
    const axes = AXES.map((a, i) => ({ name: a, colour: `--p${i + 1}` }));
    this.plots = [
      new Plot('Tool, m', 3, this.tool, [0, 3, 1, 4, 2, 5], axes.flatMap((a) => [{ name: a.name, colour: a.colour }, { name: `${a.name} desired`, colour: a.colour, wanted: true }])),
      new Plot('Tool, actual less desired, mm', 1, this.tool, [6, 7, 8], axes, 1000),
    ];
    this.grid.append(...this.plots.map((p) => p.root));
    const windows: [string, number][] = [['10 s', 10], ['30 s', 30], ['2 min', 120], ['all', Infinity]];
    const group = newId();
    const choice = h(
      'fieldset',
      { class: 'choice' },
      h('legend', { class: 'hidden' }, 'Time shown'),
      ...windows.map(([name, seconds]) => {
        const input = h('input', { type: 'radio', name: group, id: newId(), change: () => this.show(seconds) });
        input.checked = seconds === this.window_s;
        return h('span', {}, input, h('label', { for: input.id }, name));
      }),
    );
    this.root = card('Motion', choice, this.grid, h('div', { class: 'tables' }, this.toolTable.root, this.jointTable.root));
    link.onChange(() => {
      this.makeJoints();
      if (link.state !== 'live') {
        this.tool.gap();
        this.joints?.gap();
        this.dirty = true;
      }
    });
    // What is wanted comes after what is, of the same period.
    let tool: PoseInFrame | null = null;
    let joints: JointStates | null = null;
    link.on<PoseInFrame>('/tool', (m) => (tool = m));
    link.on<PoseInFrame>('/tool/desired', (m, t) => {
      this.wantedTool = m;
      if (tool) this.addTool(t, tool);
    });
    link.on<JointStates>('/joints', (m) => (joints = m));
    link.on<JointStates>('/joints/desired', (m, t) => {
      this.wantedJoints = m;
      if (joints) this.addJoints(t, joints);
    });
    const draw = () => {
      if (this.dirty && !this.view.hidden) {
        this.dirty = false;
        for (const p of this.plots) p.draw();
        this.write(tool, joints);
      }
    };
    setInterval(draw, 100);
    view.addEventListener('shown', () => (this.dirty = true));
  }

  private show(seconds: number): void {
    this.window_s = seconds;
    for (const p of this.plots) p.window_s = seconds;
    this.dirty = true;
  }

  private makeJoints(): void {
    const joints = this.link.panel?.joints;
    if (!joints || this.joints) return;
    const n = joints.length;
    this.joints = new Store(4 * n); // position, desired, rate, force
    const colours = joints.map((j, i) => ({ name: j.name, colour: `--p${(i % 7) + 1}` }));
    const store = this.joints;
    const made = [
      new Plot('Joints, °', 2, store, joints.flatMap((_, i) => [i, n + i]), colours.flatMap((c) => [c, { name: `${c.name} desired`, colour: c.colour, wanted: true }]), 180 / Math.PI),
      new Plot('Forces at the joints, kN (swing: kN m)', 1, store, joints.map((_, i) => 3 * n + i), colours, 1e-3),
    ];
    for (const p of made) p.window_s = this.window_s;
    this.plots.push(...made);
    this.grid.append(...made.map((p) => p.root));
    this.jointRows = joints.map((j) => row(this.jointTable.body, j.name, 4));
  }

  private addTool(t: number, m: PoseInFrame): void {
    const at = m.pose.position;
    const to = this.wantedTool!.pose.position;
    this.tool.add(t, [at.x, at.y, at.z, to.x, to.y, to.z, at.x - to.x, at.y - to.y, at.z - to.z]);
    this.dirty = true;
  }

  private addJoints(t: number, m: JointStates): void {
    const wanted = this.wantedJoints?.joints;
    if (!this.joints) return;
    this.joints.add(t, [...m.joints.map((j) => j.position), ...m.joints.map((_, i) => wanted?.[i]?.position ?? null), ...m.joints.map((j) => j.rate), ...m.joints.map((j) => j.force)]);
    this.dirty = true;
  }

  private write(tool: PoseInFrame | null, joints: JointStates | null): void {
    if (tool && this.wantedTool)
      AXES.forEach((a, i) => {
        const is = tool.pose.position[a];
        const to = this.wantedTool!.pose.position[a];
        [number(to, 3), number(is, 3), number(1e3 * (is - to), 1)].forEach((text, k) => write(this.toolRows[i].cells[k], text));
      });
    joints?.joints.forEach((j, i) => {
      const cells = this.jointRows[i]?.cells;
      if (!cells) return;
      const to = this.wantedJoints?.joints[i]?.position;
      [number(to === undefined ? undefined : degrees(to), 2), number(degrees(j.position), 2), number(degrees(j.rate), 2), number(j.force / 1e3, 1)].forEach((text, k) => write(cells[k], text));
    });
  }
}

// ---- the view ----

function stateCard(link: Link): HTMLElement {
  const word = h('p', { class: 'state-word' }, 'waiting');
  const why = h('div', { class: 'why', hidden: true }, h('p', { class: 'bad fault' }), h('p', { class: 'note' }));
  const bar = h('div', { class: 'bar', role: 'progressbar', 'aria-label': 'of the motion', 'aria-valuemin': 0, 'aria-valuemax': 100 }, h('div', {}));
  const diagram = new BehaviourView();
  let fault = '';
  let detail = '';
  link.on<Log>('/log', (log) => {
    if (log.message.startsWith('fault: ')) fault = log.message.replace(/^(fault: )+/, '');
    if (log.message.startsWith('report: ') && !log.message.includes('deadline')) detail = log.message.slice(8);
    tell();
  });
  /** Why it failed, and what the part that found it says. */
  function tell(): void {
    why.hidden = !link.session?.phase.startsWith('failed') || !fault;
    write(why.firstElementChild!, fault);
    write(why.lastElementChild!, detail === '' || fault.startsWith('a deadline') ? '' : detail);
  }
  link.on<Session>('/session', (session) => {
    const share = Math.max(0, Math.min(1, session.share));
    bar.hidden = session.step <= 0 || !inMotion(session.phase);
    (bar.firstChild as HTMLElement).style.width = `${100 * share}%`;
    bar.setAttribute('aria-valuenow', String(Math.round(100 * share)));
  });
  link.onChange(() => {
    const { session, panel } = link;
    if (!session) return;
    const failed = session.phase.startsWith('failed');
    write(word, session.phase[0].toUpperCase() + session.phase.slice(1));
    word.classList.toggle('bad', failed);
    tell();
    if (panel) diagram.show(panel.behaviour, session.phase, session.offers);
  });
  const root = card('State', word, why, bar, diagram.root);
  root.classList.add('state');
  return root;
}

export function mount(root: HTMLElement, link: Link): void {
  const fields = new Fields(link);
  link.onChange(() => fields.update());
  root.append(
    h('div', { class: 'side' }, ordersCard(link), card('Parameters', fields.root), manualCard(link)),
    h('div', { class: 'wide' }, stateCard(link), new Curves(link, root).root, h('div', { class: 'pair' }, eventsCard(link), h('div', { class: 'stack' }, timingCard(link), machineCard(link)))),
  );
}
