// The paper's 3.4: a point of the left picture, its candidates along the epipolar curve of the right one, the one that a person
// chooses, and the point in space that it is, with how sure that is. The points make a surface.

import '../pictures/pictures.css';
import { card, degrees, h, newId, number, write } from '../dom';
import type { Link } from '../link';
import { Bench, chooser, offer, select } from '../pictures/bench';
import { Pane, type Line, type Mark } from '../pictures/pane';
import { Plan } from '../pictures/plan';

export const id = 'match';
export const title = 'Match';
export const order = 50;

interface Pair {
  frame: string;
  left: { camera: string; width: number; height: number };
  right: { camera: string; width: number; height: number };
  rig: string;
  calibration_known: boolean;
  in: string;
  baseline_m: number;
}
interface Candidate {
  right: [number, number];
  zncc: number | null;
  refined: boolean;
  sigma_px: [number | null, number | null];
  p: [number, number, number] | null;
  sigma_m: number | null;
  sigma_matching_m: number | null;
}
interface Clicked {
  left: [number, number];
  curve: [number, number][];
  candidates: Candidate[];
}
export interface SpacePoint extends Candidate {
  point: string;
  left: [number, number];
  covariance: (number | null)[];
}
export interface Points {
  in: string;
  calibration_known: boolean;
  points: SpacePoint[];
  triangles: [number, number, number][];
  map: { columns: number; rows: number; cell_m: number } | null;
  remark: string;
}

const NEAR_RING_PX = 14; // a click so near to a candidate's ring chooses it
const SNAP_PX = 9;

/** With calibration where that is known, else of matching alone. */
const sigma = (c: Candidate): string => (c.sigma_m !== null ? `± ${number(1e3 * c.sigma_m, 2)}` : c.sigma_matching_m !== null ? `± ${number(1e3 * c.sigma_matching_m, 2)} *` : 'not known');

class View {
  private readonly bench: Bench;
  private readonly left = new Pane('Left');
  private readonly right = new Pane('Right');
  private readonly frame = select('Frame', () => void this.open());
  private readonly rig = select('Rig', () => void this.open());
  private readonly near = h('input', { id: newId(), type: 'number', min: 0.001, max: 100000, step: 'any', value: 0.5, change: () => void this.open() });
  private readonly far = h('input', { id: newId(), type: 'number', min: 0.001, max: 1000000, step: 'any', placeholder: 'any', change: () => void this.open() });
  private readonly pairTold = h('p', { class: 'told', role: 'status' });
  private readonly fits = h('p', { class: 'told', role: 'status' });
  private readonly helps = h('input', { id: newId(), type: 'checkbox', change: () => void this.help() });
  private readonly told = h('p', { class: 'told', role: 'status' });
  private readonly body = h('tbody', {});
  private readonly candidateBox: HTMLElement;
  private readonly pointBody = h('tbody', {});
  private readonly undo = h('button', { type: 'button', id: 'undo', click: () => void this.takeBack() }, 'Undo', h('kbd', {}, 'U'));
  private readonly save = h('button', { type: 'button', id: 'export', click: () => void this.store() }, 'Export');
  private readonly load = h('button', { type: 'button', id: 'csv', click: () => this.download() }, 'Save as CSV');
  private readonly saveTold = h('p', { class: 'told', role: 'status' });
  private readonly remark = h('p', { class: 'note' });
  private readonly plan = new Plan();
  private pair: Pair | null = null;
  private clicked: Clicked | null = null;
  private points: Points | null = null;
  private interest: [number, number][] = [];
  private opening = 0;

  constructor(
    root: HTMLElement,
    private readonly link: Link,
  ) {
    this.bench = new Bench(link, 'match');
    this.helps.checked = true;
    const field = (label: string, input: HTMLInputElement, unit: string) => h('div', { class: 'field' }, h('label', { for: input.id }, label), h('div', { class: 'input' }, input, h('span', { class: 'unit' }, unit)));
    const table = (label: string, heads: string[], body: HTMLElement) =>
      h('div', { class: 'scroll', tabindex: 0, role: 'region', 'aria-label': label }, h('table', {}, h('thead', {}, h('tr', {}, ...heads.map((t, i) => h('th', { scope: 'col', class: i ? 'n' : '' }, t)))), body));
    this.candidateBox = table('Candidates, best first', ['Candidate', 'zncc', 'σ px', 'x, y, z m', 'σ mm'], this.body);
    this.left.onPick = (x, y) => void this.pickLeft(x, y);
    this.right.onPick = (x, y) => void this.pickRight(x, y);
    const shown = h(
      'div',
      { class: 'bench' },
      h(
        'div',
        { class: 'side' },
        card('Pair', chooser(this.bench, (row) => (row.cameras?.length ?? 0) > 1, 'Dataset with two cameras'), this.frame.root, this.rig.root, h('div', { class: 'two' }, field('Nearest', this.near, 'm'), field('Farthest', this.far, 'm')), h('p', { class: 'note tick' }, this.helps, h('label', { for: this.helps.id }, 'Interest points: a click takes the one beside it')), this.pairTold, this.fits),
        card('Points', this.plan.root, this.remark, h('div', { class: 'orders' }, this.undo, this.save), this.load, this.saveTold),
      ),
      h(
        'div',
        { class: 'wide' },
        card('Left: say which point is meant. Right: choose where it is', h('div', { class: 'panes' }, this.left.root, this.right.root), this.told, this.candidateBox, h('p', { class: 'note' }, 'Candidates are chosen by a click on their ring or row, or by their number’s key; a click elsewhere in the right picture is taken as the place. * of matching alone: the rig does not tell how sure its calibration is.')),
        card('Points in space', table('The points, newest first', ['Point', 'x m', 'y m', 'z m', 'σ mm', 'zncc', 'left px', 'right px'], this.pointBody)),
      ),
    );
    offer(root, link, 'OpenBench', shown);
    root.addEventListener('keydown', (event) => this.onKey(event));
    root.addEventListener('shown', () => void this.bench.refresh());
    link.onChange(() => this.update());
    this.bench.onChange((what) => {
      if (what === 'rows') this.showRigs();
      if (what === 'lost') this.forget('The bench was lost, and its points with it.');
      if (what === 'opened') void this.opened();
    });
    this.forget('');
    this.left.clear('Choose a dataset.');
    this.right.clear('');
  }

  // ---- the pair ----

  private forget(text: string): void {
    this.pair = null;
    this.clicked = null;
    this.points = null;
    this.interest = [];
    this.pairTold.className = 'told bad';
    write(this.pairTold, text);
    write(this.fits, '');
    write(this.told, '');
    write(this.saveTold, '');
    this.showCandidates();
    this.showPoints();
  }

  private showRigs(): void {
    const o = this.bench.opened;
    const rows = this.bench.rows.filter((r) => r.rig && (r.cameras?.length ?? 0) > 1);
    const own = rows.some((r) => r.bench === o?.bench);
    const chosen = own ? o!.bench : rows.some((r) => r.bench === this.rig.value()) ? this.rig.value() : (rows[0]?.bench ?? '');
    this.rig.set(
      rows.map((r) => [r.bench, `${r.bench} (${r.rig === 'own' ? 'its own' : 'calibrated here'})`]),
      chosen,
    );
  }

  private async opened(): Promise<void> {
    const o = this.bench.opened!;
    this.forget('');
    const whole = o.frames.filter((f) => f.images[0] && f.images[1]);
    this.frame.set(
      whole.map((f) => [f.frame, f.frame]),
      whole[0]?.frame ?? '',
    );
    this.showRigs();
    if (o.cameras.length > 1 && whole.length) await this.open();
    else {
      this.left.clear('One camera makes no pair.');
      this.right.clear('');
    }
  }

  private async open(): Promise<void> {
    const frame = this.frame.value();
    if (!frame || !this.bench.opened) return;
    const number_ = ++this.opening;
    this.forget('');
    const far = Number(this.far.value);
    const answer = await this.bench.ask<Pair>('MatchOpen', { frame, ...(this.rig.value() ? { rig: this.rig.value() } : {}), near_m: Number(this.near.value) || 0.5, ...(far > 0 ? { far_m: far } : {}) });
    if (number_ !== this.opening) return;
    this.pairTold.className = `told ${answer.ok ? '' : 'bad'}`;
    if (answer.ok) {
      this.pair = answer.value;
      write(this.pairTold, `Baseline ${number(1e3 * answer.value.baseline_m, 1)} mm; points in the frame of the ${answer.value.in}. ${answer.value.calibration_known ? 'σ holds matching and calibration.' : 'The rig has no covariance: σ is of matching alone.'}`);
    } else write(this.pairTold, answer.text);
    await this.pictures(frame, number_);
    if (answer.ok && number_ === this.opening) await this.help();
    if (answer.ok && number_ === this.opening) void this.checkFit(number_);
    this.update();
  }

  private async pictures(frame: string, number_: number): Promise<void> {
    const o = this.bench.opened;
    if (!o) return;
    for (const [k, pane] of [this.left, this.right].entries()) {
      const answer = await this.bench.picture(frame, o.cameras[k]);
      if (number_ !== this.opening) return;
      if (answer.ok) await pane.show(answer.value.format, answer.value.data);
      else pane.clear(answer.text);
    }
  }

  /** Do the pictures belong to the rig? */
  private async checkFit(number_: number): Promise<void> {
    const answer = await this.bench.ask<{ belongs: boolean; matches: number; rms_px: number; corrected_px: number | null; rotation_rad: number[]; limit_px: number }>('MatchCheck', {}, 60);
    if (number_ !== this.opening) return;
    const f = answer.value;
    this.fits.className = `told ${answer.ok && f.belongs ? 'good' : 'bad'}`;
    if (!answer.ok) write(this.fits, answer.text);
    else if (f.belongs) write(this.fits, `The pictures belong to the rig: ${f.matches} matches lie ${number(f.rms_px, 3)} px from their epipolar curves.`);
    else
      write(
        this.fits,
        `The pictures do not belong to the rig: matches lie ${number(f.rms_px, 2)} px from their epipolar curves (at most ${number(f.limit_px, 1)}). ${f.corrected_px !== null ? `The right camera turned by ${f.rotation_rad.map((r) => number(degrees(r), 3)).join(', ')}° would leave ${number(f.corrected_px, 3)} px. ` : ''}Depths are not to be trusted: calibrate again.`,
      );
  }

  private async help(): Promise<void> {
    this.interest = [];
    if (this.helps.checked && this.pair) {
      const answer = await this.bench.ask<{ points: [number, number][] }>('InterestPoints');
      if (answer.ok && this.helps.checked) this.interest = answer.value.points;
    }
    this.drawMarks();
  }

  // ---- a click ----

  private snapped(x: number, y: number): [number, number] {
    let best: [number, number] = [x, y];
    let least = this.left.reach(SNAP_PX);
    for (const p of this.interest) {
      const d = Math.hypot(p[0] - x, p[1] - y);
      if (d < least) [least, best] = [d, p];
    }
    return best;
  }

  private async pickLeft(x0: number, y0: number): Promise<void> {
    if (!this.pair) return;
    const [x, y] = this.snapped(x0, y0);
    const answer = await this.bench.ask<Clicked>('MatchPoint', { x, y });
    this.clicked = answer.ok ? answer.value : null;
    this.told.className = `told ${answer.ok && answer.value.candidates.length ? '' : 'bad'}`;
    write(this.told, !answer.ok ? answer.text : answer.value.candidates.length ? `(${number(x, 1)}, ${number(y, 1)}): ${answer.value.candidates.length} candidates on its epipolar curve.` : 'Nothing along its epipolar curve looks alike: choose the place by hand, or another point.');
    const first = answer.ok ? answer.value.candidates[0] : null;
    if (first) this.right.goTo(first.right[0], first.right[1]);
    this.showCandidates();
  }

  private pickRight(x: number, y: number): Promise<void> {
    if (!this.clicked) {
      this.told.className = 'told bad';
      write(this.told, 'First click on a point of the left picture.');
      return Promise.resolve();
    }
    const near = this.right.reach(NEAR_RING_PX);
    const k = this.clicked.candidates.findIndex((c) => Math.hypot(c.right[0] - x, c.right[1] - y) < near);
    return this.choose(k >= 0 ? { candidate: k } : { x, y });
  }

  private async choose(what: { candidate: number } | { x: number; y: number }): Promise<void> {
    if (!this.clicked) return;
    const answer = await this.bench.ask<Points>('MatchChoose', what);
    this.told.className = `told ${answer.ok ? 'good' : 'bad'}`;
    if (!answer.ok) {
      write(this.told, answer.text);
      return;
    }
    this.points = answer.value;
    this.clicked = null;
    write(this.saveTold, '');
    const p = answer.value.points.at(-1)!;
    write(this.told, `Point ${p.point}: ${p.p!.map((v) => number(v, 4)).join(', ')} m, σ ${sigma(p)} mm.`);
    this.showCandidates();
    this.showPoints();
  }

  private onKey(event: KeyboardEvent): void {
    const at = event.target as HTMLElement;
    if (event.ctrlKey || event.altKey || event.metaKey || at.matches('input, select')) return;
    const k = Number(event.key) - 1;
    if (event.key === 'u' && this.points?.points.length) void this.takeBack();
    else if (Number.isInteger(k) && k >= 0 && this.clicked?.candidates[k]) void this.choose({ candidate: k });
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  private showCandidates(): void {
    const list = this.clicked?.candidates ?? [];
    this.candidateBox.hidden = !list.length;
    this.body.replaceChildren(
      ...list.map((c, k) =>
        h(
          'tr',
          {},
          h('th', { scope: 'row' }, h('button', { type: 'button', class: 'small', id: `candidate-${k + 1}`, 'aria-keyshortcuts': String(k + 1), 'aria-label': `choose candidate ${k + 1}`, click: () => void this.choose({ candidate: k }) }, String(k + 1))),
          h('td', { class: 'n' }, number(c.zncc, 3)),
          h('td', { class: 'n' }, c.refined ? number(Math.hypot(c.sigma_px[0] ?? NaN, c.sigma_px[1] ?? NaN), 3) : 'to a pixel'),
          h('td', { class: 'n' }, c.p ? c.p.map((v) => number(v, 3)).join(', ') : 'no point'),
          h('td', { class: 'n' }, c.p ? sigma(c) : '–'),
        ),
      ),
    );
    this.drawMarks();
  }

  // ---- points ----

  private async takeBack(): Promise<void> {
    const answer = await this.bench.ask<Points>('MatchUndo');
    if (answer.ok) this.points = answer.value;
    this.told.className = `told ${answer.ok ? '' : 'bad'}`;
    write(this.told, answer.ok ? 'The last point was taken back.' : answer.text);
    this.showPoints();
    this.drawMarks();
  }

  private showPoints(): void {
    const points = this.points?.points ?? [];
    this.pointBody.replaceChildren(
      ...points
        .map((p) =>
          h(
            'tr',
            {},
            h('th', { scope: 'row' }, p.point),
            ...p.p!.map((v) => h('td', { class: 'n' }, number(v, 4))),
            h('td', { class: 'n' }, sigma(p)),
            h('td', { class: 'n' }, number(p.zncc, 3)),
            h('td', { class: 'n' }, p.left.map((v) => number(v, 1)).join(', ')),
            h('td', { class: 'n' }, p.right.map((v) => number(v, 2)).join(', ')),
          ),
        )
        .reverse(),
    );
    this.plan.show(this.points);
    const m = this.points?.map;
    write(this.remark, !points.length ? 'No points yet.' : m ? `${points.length} points, ${this.points!.triangles.length} ${this.points!.triangles.length === 1 ? 'triangle' : 'triangles'}; map of ${m.columns} × ${m.rows} cells of ${number(m.cell_m, 3)} m.` : `${points.length} ${points.length === 1 ? 'point' : 'points'}: three make a surface.`);
    this.update();
  }

  private async store(): Promise<void> {
    const answer = await this.bench.ask<{ folder: string; files: string[] }>('MatchExport');
    this.saveTold.className = `told ${answer.ok ? 'good' : 'bad'}`;
    write(this.saveTold, answer.ok ? `${answer.value.folder}: ${answer.value.files.join(', ')}` : answer.text);
  }

  /** Here, without the server: for who only watches. */
  private download(): void {
    const rows = (this.points?.points ?? []).map((p) => [p.point, ...p.left, ...p.right, p.zncc ?? '', ...p.p!, p.sigma_m ?? '', p.sigma_matching_m ?? ''].join(','));
    const text = ['point,left_x_px,left_y_px,right_x_px,right_y_px,zncc,x_m,y_m,z_m,sigma_m,sigma_matching_m', ...rows].join('\n');
    const url = URL.createObjectURL(new Blob([`${text}\n`], { type: 'text/csv' }));
    h('a', { href: url, download: 'points.csv' }).click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
  }

  private drawMarks(): void {
    const left: Mark[] = this.interest.map(([x, y]) => ({ x, y, kind: 'dot', colour: '--p3' }));
    const right: Mark[] = [];
    for (const p of this.points?.points ?? []) {
      left.push({ x: p.left[0], y: p.left[1], kind: 'cross', colour: '--p1', label: p.point });
      right.push({ x: p.right[0], y: p.right[1], kind: 'cross', colour: '--p1', label: p.point });
    }
    const lines: Line[] = [];
    const c = this.clicked;
    if (c) {
      left.push({ x: c.left[0], y: c.left[1], kind: 'cross', colour: '--p5', strong: true });
      lines.push({ points: c.curve, colour: '--p2' });
      c.candidates.forEach((m, k) => right.push({ x: m.right[0], y: m.right[1], kind: 'ring', colour: '--p5', strong: k === 0, label: String(k + 1), below: k % 2 === 1 }));
    }
    this.left.marks = left;
    this.right.marks = right;
    this.right.lines = lines;
    this.left.draw();
    this.right.draw();
  }

  private update(): void {
    const some = (this.points?.points.length ?? 0) > 0;
    this.undo.disabled = this.load.disabled = !some || this.link.state !== 'live';
    this.save.disabled = !some || !this.link.leads;
    this.save.title = this.link.leads ? '' : 'It leaves files at the server: take control.';
  }
}

export function mount(root: HTMLElement, link: Link): void {
  new View(root, link);
}
