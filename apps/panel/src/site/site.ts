// The site: the machine on its ground, live or from a recording.

import { card, h, newId, number, write } from '../dom';
import { Fields } from '../fields';
import type { Feed, Link } from '../link';
import { Player, Recording } from '../mcap';
import type { Grid, PoseInFrame, SceneUpdate, Session, Transforms } from '../messages';
import { Goal } from './goal';
import { Measure, type Mode } from './measure';
import { SiteScene } from './scene';
import { decodeGrid, type Colouring } from './terrain';

const COLOURINGS: [Colouring, string][] = [
  ['height', 'Height'],
  ['sigma', 'σ'],
  ['provenance', 'Provenance'],
  ['difference', 'Change'],
];

/** Four digits of a probability say more than is known. */
function chance(p: number): string {
  return p < 1e-4 ? 'below 0.0001' : p > 0.9999 ? 'above 0.9999' : p.toPrecision(2);
}

/** Radio buttons that look like one bar. */
function choice<T extends string>(legend: string, options: [T, string][], first: T, take: (value: T) => void): { root: HTMLElement; set: (value: T) => void } {
  const group = newId();
  const inputs = options.map(([value, name]) => {
    const input = h('input', { type: 'radio', name: group, id: newId(), value, change: () => take(value) });
    input.checked = value === first;
    return { value, input, label: h('label', { for: input.id }, name) };
  });
  return {
    root: h('fieldset', { class: 'choice' }, h('legend', { class: 'hidden' }, legend), ...inputs.map((i) => h('span', {}, i.input, i.label))),
    set: (value) => inputs.forEach((i) => (i.input.checked = i.value === value)),
  };
}

function toggle(name: string, on: boolean, take: (on: boolean) => void, mark = ''): HTMLElement {
  const input = h('input', { type: 'checkbox', id: newId(), change: () => take(input.checked) });
  input.checked = on;
  return h('div', { class: 'toggle' }, input, h('label', { for: input.id, class: mark }, name));
}

class SiteView {
  private readonly canvas = h('div', { class: 'canvas' });
  private readonly site: SiteScene;
  private readonly measure: Measure;
  private readonly goal: Goal;
  private readonly legend = h('div', { class: 'scale' });
  private readonly result = h('div', { class: 'result', role: 'status' });
  private readonly told = h('p', { class: 'told', role: 'status' });
  private readonly path = h('div', { class: 'path' });
  private readonly source = h('p', { class: 'source', role: 'status' });
  private readonly close = h('button', { type: 'button', disabled: true, hidden: true, click: () => this.closeArea() }, 'Close the area', h('kbd', {}, 'Enter'));
  private ends: (() => void)[] = [];
  private feed: Feed | null = null;
  private ghostTopics = new Set<string>();
  private player: Player | null = null;
  private motion = '';
  private pressed: { x: number; y: number } | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly link: Link,
  ) {
    root.append(h('div', { class: 'stage' }, this.canvas, this.side()));
    this.site = new SiteScene(this.canvas, () => !root.hidden);
    this.measure = new Measure(this.site);
    this.goal = new Goal(this.site, link);
    const c = this.site.renderer.domElement;
    c.setAttribute('role', 'application');
    c.setAttribute('aria-label', 'The machine on its ground. Arrows turn the view, plus and minus come near, Enter takes the ground at the cross, F shows all.');
    c.dataset.arrows = '';
    this.canvas.append(this.legend, this.source, h('div', { class: 'cross', 'aria-hidden': 'true' }));
    this.measure.onResult = (lines) => {
      this.result.replaceChildren(...lines.map((l, i) => h('p', { class: i ? 'note' : 'big' }, l)));
      this.close.disabled = !this.measure.canClose;
    };
    this.goal.onTold = (text, ok) => {
      write(this.told, text);
      this.told.className = `told ${ok ? '' : 'bad'}`;
    };
    c.addEventListener('pointerdown', (e) => (this.pressed = { x: e.clientX, y: e.clientY }));
    c.addEventListener('pointerup', (e) => this.click(e));
    c.addEventListener('keydown', (e) => this.key(e));
    this.use(link);
    link.onChange(() => this.update());
    root.addEventListener('shown', () => {
      this.site.theme();
      this.update();
    });
    Object.assign(this.canvas, { site: this.site, view: this }); // for whoever looks from outside
  }

  // ---- the side ----

  private side(): HTMLElement {
    const fields = new Fields(this.link, (name) => /^\/task\/step_\d+\/(to|via_\d+)\//.test(name));
    this.link.onChange(() => fields.update());
    return h(
      'div',
      { class: 'side' },
      card('Ground', choice('Colours of the ground', COLOURINGS, 'height', (c) => this.paint(c)).root, this.layers()),
      card('Motion ahead', this.path),
      card('Desired place', h('p', { class: 'note' }, 'Drag the ball: level; with Shift up and down. Or type.'), this.told, fields.root),
      this.measureCard(),
      this.recordingCard(),
    );
  }

  private layers(): HTMLElement {
    const show = (f: (on: boolean) => void) => (on: boolean) => {
      f(on);
      this.site.draw();
    };
    return h(
      'div',
      { class: 'layers' },
      toggle('planned path', true, show((on) => (this.site.planned.line.visible = on)), 'mark planned'),
      toggle('path of the tool', true, show((on) => (this.site.predicted.line.visible = on)), 'mark predicted'),
      toggle('measured machine', true, show((on) => this.site.ghosts.forEach((g) => (g.root.visible = on))), 'mark ghost'),
      h('button', { type: 'button', click: () => this.site.frameView() }, 'Show all', h('kbd', {}, 'F')),
    );
  }

  private measureCard(): HTMLElement {
    const modes: [Mode, string][] = [
      ['none', 'Off'],
      ['line', 'Line'],
      ['volume', 'Volume'],
    ];
    return card('Measure', choice('What to measure', modes, 'none', (m) => this.setMode(m)).root, this.result, this.close);
  }

  private setMode(mode: Mode): void {
    this.measure.set(mode);
    this.canvas.classList.toggle('measuring', mode !== 'none');
    this.close.hidden = mode !== 'volume';
  }

  private closeArea(): void {
    this.measure.close();
    this.close.disabled = true;
  }

  // ---- what is seen ----

  private use(feed: Feed): void {
    for (const end of this.ends) end();
    this.ends = [];
    this.feed = feed;
    this.ghostTopics.clear();
    this.site.dropGhosts();
    this.site.terrain.forget();
    this.site.predicted.set([]);
    this.site.planned.set([]);
    this.showPlan(null);
    const live = feed === this.link;
    this.listen<SceneUpdate>('/machine', (m) => this.site.setShapes(m));
    this.listen<Transforms>('/tf', (m) => this.site.transforms(m));
    this.listen<Grid>('/terrain', (m, t) => {
      this.site.terrain.set(decodeGrid(m, t));
      this.site.floor.visible = false;
      this.site.frame(m.frame_id).add(this.site.terrain.mesh);
      this.tellLegend();
      this.measure.tell();
      this.site.draw();
    });
    if (live) {
      this.listen<PoseInFrame>('/tool', (m) => {
        if (this.site.predicted.add(m.pose.position)) this.site.draw();
      });
      this.listen<SceneUpdate>('/plan', (m) => this.showPlan(m));
      this.listen<Session>('/session', (s) => {
        const motion = `${s.step} ${s.motion}`;
        if (motion === this.motion) return;
        this.motion = motion;
        if (s.motion === 1 || s.step === 0) this.site.predicted.set([]);
        this.update();
      });
    }
    this.watchGhosts();
    this.site.floor.visible = true;
    this.tellLegend();
    this.site.draw();
  }

  private listen<T>(topic: string, take: (m: T, time_s: number) => void): void {
    this.ends.push(this.feed!.on<T>(topic, take));
  }

  /** Other machines' frames: "/measured/tf" and the like. */
  private watchGhosts(): void {
    for (const topic of this.feed!.topics()) {
      const prefix = /^\/(.+)\/tf$/.exec(topic)?.[1];
      if (!prefix || this.ghostTopics.has(topic)) continue;
      this.ghostTopics.add(topic);
      this.listen<Transforms>(topic, (m) => this.site.transforms(m, prefix));
    }
  }

  private paint(colouring: Colouring): void {
    this.site.terrain.colouring = colouring;
    this.site.terrain.paint();
    this.tellLegend();
    this.site.draw();
  }

  private tellLegend(): void {
    const { legend, map } = this.site.terrain;
    this.legend.hidden = !map;
    if (!map) return;
    const parts: HTMLElement[] = [h('p', { class: 'name' }, legend.title)];
    if (legend.stops) {
      const bar = h('div', { class: 'ramp' });
      bar.style.background = `linear-gradient(to right, ${legend.stops.colours.join(', ')})`;
      parts.push(bar, h('div', { class: 'labels' }, ...legend.stops.labels.map((l) => h('span', {}, l))));
    }
    for (const kind of legend.kinds ?? []) {
      const box = h('i', {});
      box.style.background = kind.colour;
      parts.push(h('p', { class: 'kind' }, box, kind.label));
    }
    if (legend.note) parts.push(h('p', { class: 'note' }, legend.note));
    this.legend.replaceChildren(...parts);
  }

  /** The planned path, and what is known of its clearance. */
  private showPlan(m: SceneUpdate | null): void {
    const e = m?.entities[0];
    const points = e?.lines?.[0]?.points ?? [];
    this.site.planned.set(points);
    this.site.draw();
    const about = new Map(e?.metadata?.map((d) => [d.key, d.value]));
    const rows: [string, string][] = [];
    if (points.length > 1) rows.push(['lasts', `${number(Number(about.get('duration_s')), 2)} s`]);
    if (about.has('clearance_m')) {
      const sigma = about.has('sigma_m') ? ` ± ${number(Number(about.get('sigma_m')), 3)}` : '';
      rows.push(['least clearance', `${number(Number(about.get('clearance_m')), 3)}${sigma} m`]);
      rows.push(['nearest', `${about.get('link') ?? ''} at ${number(Number(about.get('time_s')), 2)} s`]);
    }
    if (about.has('probability')) rows.push(['probability of contact', chance(Number(about.get('probability')))]);
    if (about.get('verdict') === 'refused') rows.push(['verdict', 'refused: the ground is in the way']);
    this.path.replaceChildren(
      rows.length
        ? h('dl', { class: 'facts' }, ...rows.map(([k, v]) => h('div', { class: k === 'verdict' ? 'bad' : '' }, h('dt', {}, k), h('dd', {}, v))))
        : h('p', { class: 'note' }, this.player ? 'A recording holds no plan.' : 'No motion is planned. It is shown when one begins, with its clearance where there is a map.'),
    );
  }

  private update(): void {
    if (this.root.hidden) return;
    if (!this.player) {
      this.watchGhosts();
      const { panel, session } = this.link;
      const steps = panel?.parameters.map((p) => /^\/task\/(step_\d+)\/to\/x_m$/.exec(p.name)?.[1]).filter((s): s is string => s !== undefined) ?? [];
      const now = `step_${session?.step ?? 0}`;
      this.goal.update(steps.includes(now) ? now : (steps[0] ?? ''));
      this.source.hidden = this.link.state === 'live';
      write(this.source, this.link.everLive ? 'not live: the link is down' : 'waiting for the machine');
    } else this.goal.update('');
  }

  // ---- pointer and keys ----

  private click(event: PointerEvent): void {
    const from = this.pressed;
    this.pressed = null;
    if (!from || this.measure.mode === 'none' || event.button !== 0 || this.goal.busy) return;
    if (Math.hypot(event.clientX - from.x, event.clientY - from.y) > 5) return; // that was a turn
    const box = this.site.renderer.domElement.getBoundingClientRect();
    this.take((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
  }

  private take(x: number, y: number): void {
    const at = this.site.ground(x, y);
    if (at) this.measure.take(at);
  }

  private key(event: KeyboardEvent): void {
    const { camera, controls } = this.site;
    const turn = (angle: number, up: number) => {
      const d = camera.position.clone().sub(controls.target);
      const flat = Math.hypot(d.x, d.y);
      const azimuth = Math.atan2(d.y, d.x) + angle;
      const height = Math.max(-0.05, Math.min(1.5, Math.atan2(d.z, flat) + up));
      const r = d.length();
      camera.position.set(controls.target.x + r * Math.cos(height) * Math.cos(azimuth), controls.target.y + r * Math.cos(height) * Math.sin(azimuth), controls.target.z + r * Math.sin(height));
    };
    const near = (k: number) => camera.position.sub(controls.target).multiplyScalar(k).add(controls.target);
    const act: Record<string, () => void> = {
      ArrowLeft: () => turn(-0.08, 0),
      ArrowRight: () => turn(0.08, 0),
      ArrowUp: () => turn(0, 0.06),
      ArrowDown: () => turn(0, -0.06),
      '+': () => near(0.9),
      '=': () => near(0.9),
      '-': () => near(1.1),
      f: () => this.site.frameView(),
      Enter: () => (event.shiftKey || this.measure.mode === 'none' ? this.closeArea() : this.take(0, 0)),
    };
    const f = act[event.key];
    if (!f || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    f();
    controls.update();
    this.site.draw();
  }

  // ---- a recording ----

  private recordingCard(): HTMLElement {
    const file = h('input', { type: 'file', accept: '.mcap', id: newId(), class: 'hidden', change: () => void open() });
    const why = h('p', { class: 'error', role: 'alert', hidden: true });
    const slider = h('input', { type: 'range', id: newId(), min: 0, max: 1000, step: 'any', value: 0, 'aria-label': 'Time in the recording' });
    const clock = h('output', { class: 'clock' });
    const play = h('button', { type: 'button', click: () => (timer ? halt() : run()) }, 'Play');
    const back = h('button', { type: 'button', click: () => this.backToLive() }, 'Back to live');
    const speed = h('select', { id: newId(), 'aria-label': 'Speed' }, ...['0.5', '1', '4', '20'].map((v) => h('option', { value: v }, `× ${v}`)));
    speed.value = '1';
    const controls = h('div', { class: 'player', hidden: true }, slider, h('div', { class: 'bar-row' }, play, speed, clock, back));
    let timer = 0;
    const tell = () => {
      const p = this.player;
      if (!p) return;
      slider.value = String(p.time_s);
      write(clock, `${number(p.time_s, 2)} of ${number(p.recording.end_s, 1)} s`);
      slider.setAttribute('aria-valuetext', `${number(p.time_s, 1)} s`);
      write(this.source, `recording ${file.files?.[0]?.name ?? ''} at ${number(p.time_s, 2)} s – not live`);
      controls.dataset.slowest = p.slowest_ms.toFixed(1);
    };
    const halt = () => {
      cancelAnimationFrame(timer);
      timer = 0;
      write(play, 'Play');
    };
    const run = () => {
      const p = this.player;
      if (!p) return;
      write(play, 'Stop');
      if (p.time_s >= p.recording.end_s - 0.01) void p.seek(p.recording.start_s);
      let last = performance.now();
      const next = (now: number) => {
        const to = p.time_s + ((now - last) / 1000) * Number(speed.value);
        last = now;
        void p.seek(Math.min(to, p.recording.end_s));
        if (to >= p.recording.end_s || p !== this.player) halt();
        else timer = requestAnimationFrame(next);
      };
      timer = requestAnimationFrame(next);
    };
    slider.addEventListener('input', () => {
      halt();
      void this.player?.seek(Number(slider.value));
    });
    this.leaveRecording = () => {
      halt();
      controls.hidden = true;
      file.value = '';
    };
    const open = async () => {
      const chosen = file.files?.[0];
      if (!chosen) return;
      why.hidden = true;
      try {
        const player = new Player(await Recording.open(chosen));
        this.player = player;
        player.onTime = tell;
        this.root.classList.add('replay');
        this.source.hidden = false;
        this.use(player);
        this.update();
        const r = player.recording;
        slider.min = String(r.start_s);
        slider.max = String(r.end_s);
        controls.hidden = false;
        await player.seek(r.start_s);
        void this.sketch(player);
      } catch (e) {
        why.hidden = false;
        write(why, `${chosen.name}: ${e instanceof Error ? e.message : String(e)}`);
      }
    };
    return card('Recording', h('p', { class: 'note' }, 'A recording.mcap from this disk, read here and sent nowhere.'), h('div', { class: 'bar-row' }, file, h('label', { for: file.id, class: 'button' }, 'Open a recording …')), why, controls);
  }

  private leaveRecording: () => void = () => undefined;

  private backToLive(): void {
    this.leaveRecording();
    this.player = null;
    this.root.classList.remove('replay');
    this.motion = '';
    this.use(this.link);
    this.update();
  }

  /** The tool's path of the whole recording, from some of its messages. */
  private async sketch(player: Player): Promise<void> {
    const r = player.recording;
    const channel = [...r.channels].find(([, c]) => c.topic === '/tool')?.[0];
    if (channel === undefined) return;
    const points: { x: number; y: number; z: number }[] = [];
    const n = 600;
    for (let i = 0; i <= n && player === this.player; i++) {
      const found = await r.at(channel, r.start_s + ((r.end_s - r.start_s) * i) / n);
      if (!found) continue;
      points.push(((await found.read()) as PoseInFrame).pose.position);
      if (i % 50 === 0 || i === n) {
        this.site.predicted.set(points);
        this.site.draw();
      }
    }
  }
}

export function mount(root: HTMLElement, link: Link): void {
  new SiteView(root, link);
}
