// The paper's 3.2: pictures of a target, the marks found in them, up to nine clicks to number them where a person must say which
// is which, what the views cover, and the calibration with its σ.

import '../pictures/pictures.css';
import { card, h, number, s, write } from '../dom';
import type { Link } from '../link';
import { Bench, chooser, offer } from '../pictures/bench';
import { Pane, type Line, type Mark } from '../pictures/pane';
import { resultTable, type Result } from '../pictures/result';

export const id = 'calibrate';
export const title = 'Calibrate';
export const order = 40;

interface Click {
  mark: number;
  x: number;
  y: number;
}
interface Found {
  found: boolean;
  reason: string;
  seen: number;
  points: ([number, number] | null)[];
  clicks: Click[];
}
interface CameraCoverage {
  camera: string;
  views: number;
  width: number;
  height: number;
  columns: number;
  rows: number;
  cells: number[];
  image_share: number;
  nearest_m: number | null;
  farthest_m: number | null;
  tilt_rad: number | null;
  missing: string;
}
interface Coverage {
  cameras: CameraCoverage[];
  views: { frame: string; camera: string; found: boolean; reason: string; clicks: number }[];
  next: { camera: string; text: string; outline: [number, number][]; enough: boolean; sigma_px: number | null } | null;
  rms_px: number | null;
  trouble: string;
}

const MOST_CLICKS = 9;
const LEAST_CLICKS = 4;

/** Nine marks that determine a plane well: corners first, then the middle of the sides, then the middle. */
function proposal(columns: number, rows: number): number[] {
  const c = [0, columns - 1, Math.floor((columns - 1) / 2)];
  const r = [0, rows - 1, Math.floor((rows - 1) / 2)];
  const order: [number, number][] = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [1, 2], [2, 1], [0, 2], [2, 2]];
  return [...new Set(order.map(([i, j]) => r[j] * columns + c[i]))];
}

class View {
  private readonly bench: Bench;
  private readonly pane = new Pane('Picture');
  private readonly list = h('div', { class: 'list', role: 'listbox', tabindex: 0, 'aria-label': 'Pictures', 'data-arrows': true });
  private readonly said = h('p', { class: 'told', role: 'status' });
  private readonly facts = h('p', { class: 'note' });
  private readonly grid = h('div', { class: 'grid' });
  private readonly clickList = h('ul', { class: 'clicks' });
  private readonly again = h('button', { type: 'button', id: 'find', click: () => void this.find([]) }, 'Find by itself');
  private readonly clickHelp = h('p', { class: 'note' });
  private readonly numbering: HTMLElement;
  private readonly cover = h('div', { class: 'covers' });
  private readonly wish = h('p', { class: 'wish' });
  private readonly look = h('button', { type: 'button', id: 'coverage', click: () => void this.coverage() }, 'Look at all pictures');
  private readonly solve = h('button', { type: 'button', id: 'solve', click: () => void this.calibrate() }, 'Calibrate');
  private readonly solveWhy = h('p', { class: 'note' });
  private readonly solveTold = h('p', { class: 'told', role: 'status' });
  private readonly result = h('div', { class: 'result' });
  private rows: { frame: string; camera: string; row: HTMLElement }[] = [];
  private current = -1;
  private mark = 0;
  private clicks: Click[] = [];
  private kept = new Map<string, Click[]>(); // of pictures whose numbering they gave; asked for anew when the bench is
  private found = new Map<string, Found>();
  private covered: Coverage | null = null;
  private solving = false;
  private last = ''; // the picture that was looked at

  constructor(
    root: HTMLElement,
    private readonly link: Link,
  ) {
    this.bench = new Bench(link, 'calibrate');
    this.numbering = card('Which mark is which', this.clickHelp, this.grid, this.clickList, this.again);
    this.pane.onPick = (x, y) => this.click(x, y);
    this.list.addEventListener('keydown', (event) => this.onListKey(event));
    const shown = h(
      'div',
      { class: 'bench' },
      h('div', { class: 'side' }, card('Dataset', chooser(this.bench, () => true, 'Pictures of a target'), this.list), this.numbering),
      h(
        'div',
        { class: 'wide' },
        card('Marks in the picture', this.pane.root, this.said, this.facts),
        h('div', { class: 'halves' }, card('What the views cover', this.look, this.cover, this.wish), card('Calibration', this.solveWhy, this.solve, this.solveTold, this.result)),
      ),
    );
    offer(root, link, 'OpenBench', shown);
    link.onChange(() => this.update());
    this.bench.onChange((what) => {
      if (what === 'opened') void this.opened();
    });
    root.addEventListener('shown', () => void this.bench.refresh());
    this.pane.clear('Choose a dataset.');
    this.update();
  }

  private key(frame: string, camera: string): string {
    return `${this.bench.opened?.bench}/${frame}/${camera}`;
  }

  // ---- what is open ----

  private async opened(): Promise<void> {
    const o = this.bench.opened!;
    this.found.clear();
    this.covered = null;
    this.result.replaceChildren();
    this.cover.replaceChildren();
    write(this.wish, '');
    write(this.solveTold, '');
    this.rows = o.frames.flatMap((f) => o.cameras.flatMap((camera, c) => (f.images[c] ? [{ frame: f.frame, camera, row: this.listRow(f.frame, o.cameras.length > 1 ? camera : '') }] : [])));
    this.list.replaceChildren(...this.rows.map((r) => r.row));
    this.rows.forEach((r, i) => r.row.addEventListener('click', () => void this.choose(i)));
    this.makeGrid();
    this.pane.clear('no picture');
    this.current = -1;
    this.update();
    await this.askAgain();
    if (this.rows.length) await this.choose(Math.max(0, this.rows.findIndex((r) => this.key(r.frame, r.camera) === this.last)));
  }

  /** Clicks that were given before the bench was lost. */
  private async askAgain(): Promise<void> {
    for (const r of this.rows) {
      const clicks = this.kept.get(this.key(r.frame, r.camera));
      if (clicks) await this.bench.ask('FindMarks', { frame: r.frame, camera: r.camera, clicks });
    }
  }

  private listRow(frame: string, camera: string): HTMLElement {
    return h('div', { role: 'option', 'aria-selected': 'false', id: `picture-${frame}-${camera}` }, h('span', {}, camera ? `${frame} ${camera}` : frame), h('span', { class: 'how' }, ''));
  }

  private onListKey(event: KeyboardEvent): void {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step || !this.rows.length) return;
    event.preventDefault();
    event.stopPropagation();
    void this.choose(Math.max(0, Math.min(this.rows.length - 1, this.current + step)));
  }

  private async choose(i: number): Promise<void> {
    this.current = i;
    const { frame, camera, row } = this.rows[i];
    this.last = this.key(frame, camera);
    for (const r of this.rows) r.row.setAttribute('aria-selected', String(r === this.rows[i]));
    this.list.setAttribute('aria-activedescendant', row.id);
    row.scrollIntoView({ block: 'nearest' });
    this.clicks = this.found.get(this.key(frame, camera))?.clicks.slice() ?? this.kept.get(this.key(frame, camera))?.slice() ?? [];
    this.nextMark();
    this.drawMarks();
    const answer = await this.bench.picture(frame, camera);
    if (this.current !== i) return;
    if (!answer.ok) {
      this.pane.clear(answer.text);
      return;
    }
    this.pane.rename(this.bench.opened!.cameras.length > 1 ? `${frame} ${camera}` : frame);
    await this.pane.show(answer.value.format, answer.value.data);
    write(this.facts, `${answer.value.width} × ${answer.value.height} px, focus ${number(answer.value.focus, 1)}, at white ${number(100 * (answer.value.saturated_share ?? 0), 2)} %`);
    if (!this.bench.opened?.target) write(this.said, 'Its dataset does not say what target is seen: there is nothing to find.');
    else if (!this.found.has(this.key(frame, camera))) await this.find(this.clicks);
    else this.tellFound();
    this.drawMarks();
  }

  // ---- marks ----

  private async find(clicks: Click[]): Promise<void> {
    const at = this.rows[this.current];
    if (!at || !this.bench.opened?.target) return;
    const answer = await this.bench.ask<Found>('FindMarks', { frame: at.frame, camera: at.camera, ...(clicks.length ? { clicks } : {}) });
    if (this.rows[this.current] !== at) return;
    if (!answer.ok) {
      this.said.className = 'told bad';
      write(this.said, answer.text);
      return;
    }
    const key = this.key(at.frame, at.camera);
    this.found.set(key, answer.value);
    if (!clicks.length) {
      this.clicks = [];
      this.kept.delete(key);
    } else if (answer.value.found) this.kept.set(key, clicks.slice());
    this.tellFound();
    this.drawMarks();
    this.nextMark();
  }

  private tellFound(): void {
    const at = this.rows[this.current];
    const f = at && this.found.get(this.key(at.frame, at.camera));
    if (!f) return;
    const all = this.bench.opened?.target?.points ?? 0;
    this.said.className = `told ${f.found ? 'good' : 'bad'}`;
    write(this.said, f.found ? `${f.seen} of ${all} found${f.clicks.length ? `, numbered by ${f.clicks.length} clicks` : ''}${f.reason ? `: ${f.reason}` : ''}` : `Not found: ${f.reason}${this.bench.opened?.target?.clickable ? ' Say which mark is which by clicks.' : ''}`);
    this.tellList(at.frame, at.camera, f.found, f.clicks.length);
  }

  private tellList(frame: string, camera: string, found: boolean, clicks: number): void {
    const row = this.rows.find((r) => r.frame === frame && r.camera === camera)?.row;
    if (!row) return;
    const how = row.lastElementChild!;
    how.className = `how ${found ? 'good' : 'bad'}`;
    write(how, found ? (clicks ? `${clicks} clicks` : 'found') : 'not found');
  }

  private makeGrid(): void {
    const t = this.bench.opened?.target;
    this.numbering.hidden = !t?.clickable;
    if (!t?.clickable) return;
    this.grid.style.gridTemplateColumns = `repeat(${t.columns}, 1fr)`;
    this.grid.replaceChildren(
      ...Array.from({ length: t.points }, (_, k) =>
        h('button', { type: 'button', 'aria-pressed': 'false', 'aria-label': `mark ${k}, row ${Math.floor(k / t.columns) + 1}, column ${(k % t.columns) + 1}`, click: () => this.chooseMark(k) }, String(k)),
      ),
    );
    this.nextMark();
  }

  private chooseMark(k: number): void {
    this.mark = k;
    this.update();
  }

  /** The next of the proposed marks that has no click. */
  private nextMark(): void {
    const t = this.bench.opened?.target;
    if (!t?.clickable) return;
    const clicked = new Set(this.clicks.map((c) => c.mark));
    const next = proposal(t.columns, t.rows).find((k) => !clicked.has(k));
    this.mark = this.clicks.length >= MOST_CLICKS ? -1 : (next ?? -1);
    this.update();
  }

  private click(x: number, y: number): void {
    const t = this.bench.opened?.target;
    if (!t) return;
    if (!t.clickable) return this.refuse('Only marks are numbered by clicks; this target is found by itself.');
    const mark = this.mark;
    if (mark < 0) return this.refuse(`Nine clicks are the most. Take one back, or choose a mark to click anew.`);
    const clicks = this.clicks.filter((c) => c.mark !== mark);
    if (clicks.length >= MOST_CLICKS) return this.refuse('Nine clicks are the most. Take one back first.');
    this.clicks = [...clicks, { mark, x: Math.round(10 * x) / 10, y: Math.round(10 * y) / 10 }];
    this.nextMark();
    this.drawMarks();
    if (this.clicks.length >= LEAST_CLICKS) void this.find(this.clicks);
    else {
      this.said.className = 'told';
      write(this.said, `${this.clicks.length} of at least ${LEAST_CLICKS} clicks.`);
    }
  }

  private refuse(text: string): void {
    this.said.className = 'told bad';
    write(this.said, text);
  }

  private takeBack(mark: number): void {
    this.clicks = this.clicks.filter((c) => c.mark !== mark);
    this.mark = mark;
    this.drawMarks();
    this.update();
    if (this.clicks.length >= LEAST_CLICKS) void this.find(this.clicks);
  }

  private drawMarks(): void {
    const at = this.rows[this.current];
    const f = at && this.found.get(this.key(at.frame, at.camera));
    const marks: Mark[] = [];
    const lines: Line[] = [];
    f?.points.forEach((p, k) => {
      if (p) marks.push({ x: p[0], y: p[1], kind: 'ring', colour: '--p3', label: f.points.length <= 80 ? String(k) : undefined });
    });
    for (const c of this.clicks) marks.push({ x: c.x, y: c.y, kind: 'cross', colour: '--p5', strong: true, label: f?.found ? undefined : String(c.mark) });
    const next = this.covered?.next;
    if (next && !next.enough && at && next.camera === at.camera && next.outline.every((p) => p.every(Number.isFinite))) lines.push({ points: next.outline, colour: '--p2', dashed: true, closed: true });
    this.pane.marks = marks;
    this.pane.lines = lines;
    this.pane.draw();
  }

  // ---- coverage ----

  private async coverage(): Promise<void> {
    this.look.disabled = true;
    write(this.look, 'Looking …');
    const answer = await this.bench.ask<Coverage>('Coverage', {}, 300);
    write(this.look, 'Look at all pictures');
    this.look.disabled = false;
    this.covered = answer.ok ? answer.value : null;
    this.cover.replaceChildren();
    if (!answer.ok) {
      this.wish.className = 'wish error';
      write(this.wish, answer.text);
      return;
    }
    for (const v of answer.value.views) this.tellList(v.frame, v.camera, v.found, v.clicks);
    this.cover.append(...answer.value.cameras.map((c) => coverageMap(c)));
    const { next, rms_px, trouble } = answer.value;
    this.wish.className = 'wish';
    write(this.wish, [next ? (next.enough ? 'More pictures no longer help.' : `Wished for next: ${next.text}${next.camera && this.bench.opened!.cameras.length > 1 ? ` (camera ${next.camera})` : ''}.`) : '', trouble || (rms_px !== null ? `Fit so far: ${number(rms_px, 3)} px RMS.` : '')].filter(Boolean).join(' '));
    this.drawMarks();
  }

  // ---- the solve ----

  private async calibrate(): Promise<void> {
    this.solving = true;
    const begun = performance.now();
    const tick = setInterval(() => write(this.solve, `Calibrating … ${number((performance.now() - begun) / 1000, 0)} s`), 250);
    this.update();
    const answer = await this.bench.ask<Result>('Calibrate', {}, 900);
    clearInterval(tick);
    this.solving = false;
    write(this.solve, 'Calibrate');
    this.solveTold.className = `told ${answer.ok ? '' : 'bad'}`;
    write(this.solveTold, answer.ok ? `Written to ${answer.value.folder}.` : answer.text);
    this.result.replaceChildren(...(answer.ok ? [resultTable(answer.value)] : []));
    this.update();
    void this.bench.refresh();
  }

  private update(): void {
    const o = this.bench.opened;
    const leads = this.link.leads;
    this.solve.disabled = !leads || !o?.target || this.solving;
    this.solve.classList.toggle('main', !this.solve.disabled);
    write(this.solveWhy, leads ? '' : 'It leaves files at the server, so it is for who leads: take control.');
    this.solveWhy.hidden = leads;
    this.look.disabled = !o?.target || this.look.textContent !== 'Look at all pictures';
    const clicked = new Map(this.clicks.map((c) => [c.mark, c]));
    [...this.grid.children].forEach((b, k) => {
      b.setAttribute('aria-pressed', String(k === this.mark));
      b.classList.toggle('done', clicked.has(k));
    });
    write(this.clickHelp, this.mark >= 0 ? `Where marks are not found or wrongly numbered: click on mark ${this.mark} in the picture (${this.clicks.length} of 9 clicks; 4 suffice).` : 'Nine clicks are given. Choose a mark to click it anew.');
    this.clickList.replaceChildren(
      ...this.clicks.map((c) => h('li', {}, `mark ${c.mark}: ${number(c.x, 1)}, ${number(c.y, 1)} px`, h('button', { type: 'button', class: 'small', 'aria-label': `take the click on mark ${c.mark} back`, click: () => this.takeBack(c.mark) }, '×'))),
    );
    this.again.hidden = !this.clicks.length;
  }
}

const SHADES = 5;

function coverageMap(c: CameraCoverage): HTMLElement {
  const cell = 10;
  const most = Math.max(1, ...c.cells);
  const rects = c.cells.map((n, i) => s('rect', { x: (i % c.columns) * cell, y: Math.floor(i / c.columns) * cell, width: cell - 1, height: cell - 1, class: n ? `cell shade${Math.min(SHADES, Math.ceil((SHADES * n) / most))}` : 'cell' }));
  const text = `${c.views} ${c.views === 1 ? 'view' : 'views'}, ${number(100 * c.image_share, 0)} % of the image${c.nearest_m !== null ? `, ${number(c.nearest_m, 2)} to ${number(c.farthest_m, 2)} m, tilted by up to ${number(((c.tilt_rad ?? 0) * 180) / Math.PI, 0)}°` : ''}`;
  return h(
    'figure',
    { class: 'cover' },
    h('figcaption', {}, c.camera),
    s('svg', { viewBox: `0 0 ${c.columns * cell} ${c.rows * cell}`, role: 'img', 'aria-label': `Points over the image of ${c.camera}: ${text}` }, ...rects) as unknown as HTMLElement,
    h('p', { class: 'note' }, text),
    ...(c.missing ? [h('p', { class: 'note warn' }, c.missing.replace(`${c.camera}: `, ''))] : []),
  );
}

export function mount(root: HTMLElement, link: Link): void {
  new View(root, link);
}
