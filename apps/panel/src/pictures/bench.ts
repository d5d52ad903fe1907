// This client's bench at the server: which dataset is open for a view, and what is asked of it. Calibrating and matching each
// have one open, so that neither ends the other's work.
//
// A bench that was lost (its process ended, or the connection) is opened again by itself when it is next needed; what was
// clicked is then asked for anew by the views ("reopened").

import { h, newId, write } from '../dom';
import type { Answer, Link } from '../link';

export interface BenchRow {
  bench: string;
  frames?: number;
  cameras?: string[];
  target?: string;
  rig?: '' | 'own' | 'calibrated';
  trouble?: string;
}

export interface Opened {
  bench: string;
  cameras: string[];
  frames: { frame: string; images: boolean[] }[];
  target: { text: string; kind: string; columns: number; rows: number; points: number; clickable: boolean } | null;
  rig: '' | 'own' | 'calibrated';
}

export interface Picture {
  format: string;
  width: number;
  height: number;
  data: string;
  focus: number | null;
  saturated_share: number | null;
}

export interface Asked<T> {
  ok: boolean;
  text: string;
  value: T;
}

export class Bench {
  rows: BenchRow[] = [];
  opened: Opened | null = null;
  private wanted = '';
  private me = 0;
  private listeners = new Set<(what: 'rows' | 'opened' | 'lost') => void>();

  constructor(
    readonly link: Link,
    readonly use: 'calibrate' | 'match',
  ) {
    // Another connection has another bench; one that is silent for a while has the same.
    link.onChange(() => {
      if (!link.me) this.me = 0;
      if (link.me === this.me || !this.there) return;
      this.me = link.me;
      const lost = this.opened !== null;
      this.opened = null;
      if (lost) this.tell('lost');
      void this.refresh();
    });
  }

  get there(): boolean {
    return this.link.has('OpenBench');
  }

  onChange(f: (what: 'rows' | 'opened' | 'lost') => void): void {
    this.listeners.add(f);
    f('rows');
    if (this.opened) f('opened');
  }

  private tell(what: 'rows' | 'opened' | 'lost'): void {
    for (const f of this.listeners) f(what);
  }

  async refresh(): Promise<void> {
    if (!this.there) return;
    const answer = await this.link.call('Benches', {}, 20);
    if (!answer.ok) return;
    this.rows = (answer.response as { benches: BenchRow[] }).benches;
    this.tell('rows');
    // Pictures that were stored meanwhile. (A pair's points would be lost by it: there a person opens it again.)
    const row = this.rows.find((r) => r.bench === this.opened?.bench);
    if (this.use === 'calibrate' && row?.frames !== undefined && row.frames !== this.opened!.frames.length) await this.open(row.bench);
  }

  async open(name: string): Promise<Answer> {
    const answer = await this.link.call('OpenBench', { bench: name, for: this.use }, 20);
    if (answer.ok) {
      this.wanted = name;
      this.opened = answer.response as Opened;
      this.tell('opened');
    }
    return answer;
  }

  picture(frame: string, camera: string): Promise<Asked<Picture>> {
    return this.ask<Picture>('Picture', { frame, camera, for: this.use });
  }

  /** Never rejects. Where the bench was lost it is opened again, and asked once more. */
  async ask<T>(service: string, request: object = {}, within_s = 30): Promise<Asked<T>> {
    let answer = await this.link.call(service, request, within_s);
    if (!answer.ok && answer.text.startsWith('no bench is open') && this.wanted) {
      this.opened = null;
      this.tell('lost');
      if ((await this.open(this.wanted)).ok) answer = await this.link.call(service, request, within_s);
    }
    return { ok: answer.ok, text: answer.text, value: answer.response as T };
  }
}

/** A select with its label; what is wrong stands under it. */
export function select(label: string, change: (value: string) => void): { root: HTMLElement; set: (values: [string, string][], chosen: string) => void; value: () => string; fail: (text: string) => void } {
  const id = newId();
  const box = h('select', { id, change: () => change(box.value) });
  const error = h('p', { class: 'error', role: 'alert', hidden: true });
  return {
    root: h('div', { class: 'field' }, h('label', { for: id }, label), h('div', { class: 'input' }, box), error),
    set(values, chosen) {
      const now = JSON.stringify(values);
      if (box.dataset.now !== now) {
        box.dataset.now = now;
        box.replaceChildren(...values.map(([value, text]) => h('option', { value }, text)));
      }
      box.value = chosen;
      box.disabled = values.length === 0;
    },
    value: () => box.value,
    fail(text) {
      error.hidden = !text;
      write(error, text);
    },
  };
}

/** Chooses what is open; for both views that work on it. */
export function chooser(bench: Bench, wants: (row: BenchRow) => boolean, label: string): HTMLElement {
  const choice = select(label, (name) => void open(name));
  const open = async (name: string) => {
    if (!name) return;
    choice.fail('');
    const answer = await bench.open(name);
    if (!answer.ok) choice.fail(answer.text);
  };
  bench.onChange(() => {
    const rows = bench.rows.filter((row) => row.trouble || wants(row) || row.bench === bench.opened?.bench);
    const values: [string, string][] = rows.map((row) => [row.bench, row.trouble ? `${row.bench} (cannot be read)` : `${row.bench}${row.target ? `: ${row.target}` : ''}`]);
    choice.set(bench.opened ? values : [['', values.length ? 'choose…' : 'none'], ...values], bench.opened?.bench ?? '');
  });
  return choice.root;
}

/** A view of pictures: what it shows, or, where the server has none to work on, how it is begun with some. */
export function offer(root: HTMLElement, link: Link, service: 'OpenBench' | 'Store', shown: HTMLElement): void {
  const [text, command] = {
    OpenBench: ['This panel was begun without datasets. Those that may be worked on are named on its command line:', 'teledimos panel SCENARIO -o DIR --bench DATASET'],
    Store: ['This panel was begun without cameras. A camera, a video or a folder of pictures can be named on its command line:', 'teledimos panel SCENARIO -o DIR --left /dev/video0 --right /dev/video2'],
  }[service];
  const lonely = h('div', { class: 'card lonely', hidden: true }, h('p', {}, text), h('pre', {}, h('code', {}, command)));
  root.append(lonely, shown);
  link.onChange(() => {
    const live = link.state === 'live';
    lonely.hidden = !live || link.has(service);
    if (live) shown.hidden = !link.has(service);
  });
}
