// The session's logic as a diagram: phases and ways from the server's table, which is asked of the proved function itself.
// Only the places of the phases stand here; one that has none is put below the others.

import { h, s, words, write } from './dom';
import type { Behaviour } from './messages';

// Column, row.
const PLACES: Record<string, [number, number]> = {
  IDLE: [0, 0],
  PREPARING: [1, 0],
  READY: [2, 0],
  SIMULATING: [3, 0],
  SIMULATED: [4, 0],
  VALIDATED: [5, 0],
  FAILED: [0, 1],
  MANUAL: [2, 1],
  SIMULATION_PAUSED: [3, 1],
  DOWNLOADING: [5, 1],
  EXECUTION_PAUSED: [4, 1],
  MONITORING: [3, 2],
  EXECUTING: [4, 2],
  DOWNLOADED: [5, 2],
};
// Ways from nearly everywhere: told below the drawing.
const EVERYWHERE = new Set(['UserStop', 'Abort', 'Reinit']);

interface Shape {
  columns: number;
  width: number; // of a box
  height: number;
  gapX: number;
  gapY: number;
  turned: boolean;
}
const WIDE: Shape = { columns: 6, width: 108, height: 46, gapX: 78, gapY: 46, turned: false };
const NARROW: Shape = { columns: 3, width: 104, height: 44, gapX: 22, gapY: 34, turned: true };

type Point = { x: number; y: number };

function lines(name: string): string[] {
  const parts = words(name).split(' ');
  return parts.map((part, i) => (i === 0 ? part[0].toUpperCase() + part.slice(1) : part));
}

class Diagram {
  readonly svg: SVGSVGElement;
  private boxes = new Map<string, SVGGElement>();
  private edges: { from: string; to: string; events: string[]; group: SVGGElement }[] = [];

  constructor(
    private readonly table: Behaviour,
    private readonly shape: Shape,
    label: string,
  ) {
    const last = Math.max(...table.phases.map((p, i) => this.place(p.name, i)[1]), 2);
    const rows = shape.turned ? 6 : last + 1;
    const columns = shape.turned ? last + 1 : 6;
    const w = columns * (shape.width + shape.gapX) - shape.gapX + 8;
    const hgt = rows * (shape.height + shape.gapY) - shape.gapY + 8;
    this.svg = s('svg', { viewBox: `-4 -4 ${w} ${hgt}`, class: `diagram ${shape.turned ? 'narrow' : 'wide'}`, role: 'img', 'aria-label': label });
    const id = `arrow-${shape.turned ? 'n' : 'w'}`;
    this.svg.append(
      s(
        'defs',
        {},
        ...['plain', 'live'].map((kind) =>
          s(
            'marker',
            { id: `${id}-${kind}`, viewBox: '0 0 8 8', refX: 7, refY: 4, markerWidth: 7, markerHeight: 7, orient: 'auto-start-reverse', class: `tip ${kind}` },
            s('path', { d: 'M0 0 8 4 0 8z' }),
          ),
        ),
      ),
    );
    this.drawEdges(id);
    table.phases.forEach((p, i) => this.drawBox(p.name, i));
  }

  private place(name: string, i: number): [number, number] {
    const [c, r] = PLACES[name] ?? [i % 6, 3 + Math.floor(i / 6)];
    return [c, r];
  }

  private centre(name: string): Point {
    const i = this.table.phases.findIndex((p) => p.name === name);
    let [c, r] = this.place(name, i);
    if (this.shape.turned) [c, r] = [r, c];
    const { width, height, gapX, gapY } = this.shape;
    return { x: c * (width + gapX) + width / 2, y: r * (height + gapY) + height / 2 };
  }

  /** Where the way from a to b leaves a's box. */
  private border(a: Point, b: Point): Point {
    const dx = b.x - a.x;
    const dy = b.y - a.y;
    const k = Math.min(this.shape.width / 2 / Math.max(1e-6, Math.abs(dx)), this.shape.height / 2 / Math.max(1e-6, Math.abs(dy)));
    return { x: a.x + k * dx, y: a.y + k * dy };
  }

  private drawEdges(marker: string): void {
    const pairs = new Map<string, string[]>();
    const orders = new Set(this.table.events.filter((e) => e.order).map((e) => e.text));
    for (const way of this.table.ways) {
      const fault = way.to === 'FAILED';
      if (way.from === way.to || fault || (way.event !== '' && !orders.has(way.event) && !['ended', 'downloaded'].includes(way.event))) continue;
      if (EVERYWHERE.has(way.event) && way.from !== 'FAILED') continue;
      if (way.to === 'IDLE') continue;
      const key = `${way.from}>${way.to}`;
      pairs.set(key, [...(pairs.get(key) ?? []), way.event]);
    }
    for (const [key, events] of pairs) {
      const [from, to] = key.split('>');
      const group = this.edge(from, to, events, pairs.has(`${to}>${from}`), marker);
      this.edges.push({ from, to, events, group });
      this.svg.append(group);
    }
  }

  private edge(from: string, to: string, events: string[], both: boolean, marker: string): SVGGElement {
    const a = this.centre(from);
    const b = this.centre(to);
    const begin = this.border(a, b);
    const end = this.border(b, a);
    const length = Math.hypot(b.x - a.x, b.y - a.y) || 1;
    // To the right of its own direction, so that there and back do not cover each other.
    const nx = -(b.y - a.y) / length;
    const ny = (b.x - a.x) / length;
    const off = both ? 9 : 0;
    const p = { x: begin.x + off * nx, y: begin.y + off * ny };
    const q = { x: end.x + off * nx, y: end.y + off * ny };
    const level = Math.abs(ny) > Math.abs(nx);
    const text = events.map((e) => (e === '' ? 'checked' : e)).join(', ');
    const at = { x: (p.x + q.x) / 2, y: (p.y + q.y) / 2 };
    const label = s(
      'text',
      level
        ? { x: at.x, y: at.y + (both && ny > 0 ? 14 : -6), class: 'mid' }
        : { x: at.x + (nx >= 0 ? 5 : -5), y: at.y + 4, class: nx >= 0 ? '' : 'end' },
      text,
    );
    return s(
      'g',
      { class: 'edge' },
      s('path', { d: `M${p.x} ${p.y}L${q.x} ${q.y}`, 'marker-end': `url(#${marker}-plain)`, 'data-marker': marker }),
      label,
    );
  }

  private drawBox(name: string, i: number): void {
    const { width, height } = this.shape;
    const c = this.centre(name);
    const text = lines(name);
    const group = s(
      'g',
      { class: 'phase' },
      s('title', {}, this.table.phases[i].text),
      s('rect', { x: c.x - width / 2, y: c.y - height / 2, width, height, rx: 9 }),
      ...text.map((line, k) => s('text', { x: c.x, y: c.y + 4.5 + 16 * (k - (text.length - 1) / 2), class: 'mid' }, line)),
    );
    this.boxes.set(name, group);
    this.svg.append(group);
  }

  show(name: string, offers: Set<string>): void {
    for (const [other, group] of this.boxes) group.classList.toggle('now', other === name);
    for (const e of this.edges) {
      const live = e.from === name && e.events.some((event) => event === '' || offers.has(event) || event === 'ended' || event === 'downloaded');
      e.group.classList.toggle('live', live);
      const path = e.group.querySelector('path')!;
      path.setAttribute('marker-end', `url(#${path.dataset.marker}-${live ? 'live' : 'plain'})`);
    }
  }
}

/** What the diagram says, in words: for those who do not see it, and what is not drawn. */
function sentence(table: Behaviour, name: string, offers: string[]): string {
  const text = (phase: string) => words(phase);
  const ways = table.ways.filter((w) => w.from === name && w.to !== name && offers.includes(w.event)).map((w) => `${w.event} to ${text(w.to)}`);
  return `From here: ${ways.join(', ')}. A fault leads to failed, UserStop to idle, from everywhere.`;
}

export class BehaviourView {
  readonly root: HTMLElement;
  private table: Behaviour | null = null;
  private diagrams: Diagram[] = [];
  private readonly drawing = h('div', { class: 'drawing' });
  private readonly text = h('p', { class: 'note' });

  constructor() {
    this.root = h('div', {}, this.drawing, this.text);
  }

  show(table: Behaviour, phase: string, offers: string[]): void {
    if (table !== this.table) {
      this.table = table;
      const label = 'State diagram of the session; the sentence below says where it stands';
      this.diagrams = [new Diagram(table, WIDE, label), new Diagram(table, NARROW, label)];
      this.drawing.replaceChildren(...this.diagrams.map((d) => d.svg));
    }
    const name = table.phases.find((p) => p.text === phase)?.name ?? '';
    for (const d of this.diagrams) d.show(name, new Set(offers));
    write(this.text, sentence(table, name, offers));
  }
}
