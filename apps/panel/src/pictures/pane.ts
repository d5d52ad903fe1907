// A picture to be pointed at: zoomed, moved, and clicked on to a tenth of a pixel.
//
// Wheel, pinch, + and − zoom; dragging moves; 0 shows all. The cursor follows the mouse, or is moved by the arrow keys, by one
// pixel, with Shift by ten, with Alt by a tenth; Enter clicks. The loupe shows what is under it. Pixel (0, 0) is the centre of
// the first pixel, as everywhere in Teledimos.

import { colour, h, newId, number, write } from '../dom';

export interface Mark {
  x: number;
  y: number;
  kind: 'cross' | 'ring' | 'dot';
  colour: string; // of the style sheet: --p1
  label?: string;
  strong?: boolean;
  below?: boolean; // its label
}

export interface Line {
  points: [number, number][];
  colour: string;
  dashed?: boolean;
  closed?: boolean;
}

interface View {
  scale: number; // CSS px for an image px
  x: number; // image px at the middle
  y: number;
}

const LOUPE_PX = 132;
const LOUPE_TIMES = 9;
const MOST_SCALE = 60;
const CLICK_PX = 5; // further is a drag

export class Pane {
  readonly root: HTMLElement;
  /** Whether it can be clicked on, and who takes the clicks. */
  onPick: ((x: number, y: number) => void) | null = null;
  marks: Mark[] = [];
  lines: Line[] = [];
  width = 0;
  height = 0;

  private image: CanvasImageSource | null = null;
  private view: View = { scale: 1, x: 0, y: 0 };
  private fitted = true;
  private cursor: { x: number; y: number } | null = null;
  private byKeys = false;
  private pointers = new Map<number, { x: number; y: number }>();
  private moved = 0;
  private due = false;
  private shown = 0; // the newest picture that was asked for
  private readonly canvas = h('canvas', { class: 'picture' });
  private readonly loupe = h('canvas', { class: 'loupe', hidden: true });
  private readonly place = h('output', { class: 'place' });
  private readonly spoken = h('p', { class: 'hidden', 'aria-live': 'polite' });
  private readonly box: HTMLElement;
  private readonly empty = h('p', { class: 'empty' }, 'no picture');

  private readonly name = h('span', { class: 'name' });

  constructor(name: string) {
    write(this.name, name);
    const help = newId();
    const button = (label: string, text: string, click: () => void) => h('button', { type: 'button', class: 'small', 'aria-label': `${label}, ${name}`, title: label, click }, text);
    this.box = h('div', { class: 'pane', tabindex: 0, role: 'application', 'aria-label': name, 'aria-describedby': help, 'data-arrows': true }, this.canvas, this.loupe, this.empty);
    this.root = h(
      'figure',
      { class: 'picture-box' },
      h('figcaption', {}, this.name, this.place, h('span', { class: 'zooms' }, button('Larger', '+', () => this.zoom(1.5)), button('Smaller', '−', () => this.zoom(1 / 1.5)), button('All of it', '⤢', () => this.fit()))),
      this.box,
      h('p', { class: 'hidden', id: help }, 'Arrow keys move the cursor by one pixel, with Shift by ten, with Alt by a tenth. Enter clicks, plus and minus zoom, 0 shows all.'),
      this.spoken,
    );
    this.box.addEventListener('wheel', (event) => this.onWheel(event), { passive: false });
    this.box.addEventListener('pointerdown', (event) => this.onDown(event));
    this.box.addEventListener('pointermove', (event) => this.onMove(event));
    this.box.addEventListener('pointerup', (event) => this.onUp(event));
    this.box.addEventListener('pointercancel', (event) => this.pointers.delete(event.pointerId));
    this.box.addEventListener('pointerleave', () => this.leave());
    this.box.addEventListener('keydown', (event) => this.onKey(event));
    this.box.addEventListener('blur', () => this.leave());
    new ResizeObserver(() => this.resize()).observe(this.box);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.draw());
  }

  /** The picture of an answer or a message: base64. Older ones that come late are left out. */
  async show(format: string, data: string): Promise<void> {
    const number = ++this.shown;
    const image = new Image();
    image.src = `data:image/${format};base64,${data}`;
    await image.decode().catch(() => undefined);
    if (number !== this.shown || !image.naturalWidth) return;
    const same = this.image && image.naturalWidth === this.width && image.naturalHeight === this.height;
    this.image = image;
    this.width = image.naturalWidth;
    this.height = image.naturalHeight;
    this.empty.hidden = true;
    this.box.style.aspectRatio = `${this.width} / ${this.height}`;
    if (!same) this.fit();
    this.draw();
  }

  rename(name: string): void {
    write(this.name, name);
    this.box.setAttribute('aria-label', `Picture ${name}`);
  }

  clear(text: string): void {
    this.shown++;
    this.image = null;
    this.width = this.height = 0;
    this.marks = [];
    this.lines = [];
    this.leave();
    this.empty.hidden = false;
    write(this.empty, text);
    this.draw();
  }

  /** Image px that so many px of the screen are. */
  reach(px: number): number {
    return px / this.view.scale;
  }

  /** Brings a place into sight, and the cursor there. */
  goTo(x: number, y: number): void {
    this.cursor = { x, y };
    this.keepInSight();
    this.draw();
  }

  draw(): void {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.drawNow();
    });
  }

  // ---- the view ----

  private get size(): { w: number; h: number } {
    return { w: this.box.clientWidth, h: this.box.clientHeight };
  }

  private resize(): void {
    if (this.fitted) this.fit();
    this.draw();
  }

  private fit(): void {
    const { w, h: high } = this.size;
    if (!this.width || !w) return;
    this.view = { scale: Math.min(w / this.width, high / this.height), x: this.width / 2 - 0.5, y: this.height / 2 - 0.5 };
    this.fitted = true;
    this.draw();
  }

  private zoom(times: number, about?: { x: number; y: number }): void {
    if (!this.width) return;
    const { w, h: high } = this.size;
    const least = Math.min(w / this.width, high / this.height);
    const scale = Math.max(least, Math.min(MOST_SCALE, this.view.scale * times));
    const at = about ?? this.cursor ?? { x: this.view.x, y: this.view.y };
    const keep = 1 - this.view.scale / scale;
    this.view = { scale, x: this.view.x + (at.x - this.view.x) * keep, y: this.view.y + (at.y - this.view.y) * keep };
    this.fitted = scale <= least;
    if (this.fitted) this.fit();
    this.bound();
    this.draw();
  }

  private bound(): void {
    this.view.x = Math.max(0, Math.min(this.width - 1, this.view.x));
    this.view.y = Math.max(0, Math.min(this.height - 1, this.view.y));
  }

  private toScreen(x: number, y: number): [number, number] {
    const { w, h: high } = this.size;
    return [w / 2 + (x - this.view.x) * this.view.scale, high / 2 + (y - this.view.y) * this.view.scale];
  }

  private fromEvent(event: { clientX: number; clientY: number }): { x: number; y: number } {
    const r = this.box.getBoundingClientRect();
    return { x: this.view.x + (event.clientX - r.left - r.width / 2) / this.view.scale, y: this.view.y + (event.clientY - r.top - r.height / 2) / this.view.scale };
  }

  private keepInSight(): void {
    const { w, h: high } = this.size;
    const [x, y] = this.toScreen(this.cursor!.x, this.cursor!.y);
    if (x < 20) this.view.x -= (20 - x) / this.view.scale;
    if (y < 20) this.view.y -= (20 - y) / this.view.scale;
    if (x > w - 20) this.view.x += (x - w + 20) / this.view.scale;
    if (y > high - 20) this.view.y += (y - high + 20) / this.view.scale;
  }

  // ---- hands ----

  private onWheel(event: WheelEvent): void {
    if (!this.width) return;
    event.preventDefault();
    this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.06 : 0.002)), this.fromEvent(event));
  }

  private onDown(event: PointerEvent): void {
    this.box.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (this.pointers.size === 1) this.moved = 0;
    else this.moved = CLICK_PX + 1;
    this.hover(event);
  }

  private onMove(event: PointerEvent): void {
    const before = this.pointers.get(event.pointerId);
    if (before) {
      const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
      const dx = event.clientX - before.x;
      const dy = event.clientY - before.y;
      this.moved += Math.hypot(dx, dy);
      if (this.moved > CLICK_PX || others.length) this.drag(event, before, others[0], dx, dy);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    }
    this.hover(event);
  }

  private drag(event: PointerEvent, before: { x: number; y: number }, other: { x: number; y: number } | undefined, dx: number, dy: number): void {
    const share = other ? 0.5 : 1;
    this.view.x -= (share * dx) / this.view.scale;
    this.view.y -= (share * dy) / this.view.scale;
    this.fitted = false;
    if (other) {
      const was = Math.hypot(before.x - other.x, before.y - other.y);
      const is = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (was > 0) this.zoom(is / was, this.fromEvent({ clientX: (event.clientX + other.x) / 2, clientY: (event.clientY + other.y) / 2 }));
    }
    this.bound();
    this.draw();
  }

  private onUp(event: PointerEvent): void {
    this.pointers.delete(event.pointerId);
    if (this.moved <= CLICK_PX && event.button === 0) this.pick(this.fromEvent(event));
  }

  private hover(event: PointerEvent): void {
    if (!this.width) return;
    this.byKeys = false;
    this.cursor = this.fromEvent(event);
    this.draw();
  }

  private leave(): void {
    if (this.byKeys && document.activeElement === this.box) return;
    this.cursor = null;
    write(this.place, '');
    this.draw();
  }

  private onKey(event: KeyboardEvent): void {
    const steps: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[event.key];
    const times = event.shiftKey ? 10 : event.altKey ? 0.1 : 1;
    if (!this.width || event.ctrlKey || event.metaKey) return;
    if (step) {
      const at = this.cursor ?? { x: Math.round(this.view.x), y: Math.round(this.view.y) };
      const within = (v: number, size: number) => Math.max(0, Math.min(size - 1, Math.round(10 * v) / 10));
      this.byKeys = true;
      this.goTo(within(at.x + times * step[0], this.width), within(at.y + times * step[1], this.height));
      write(this.spoken, `x ${this.cursor!.x.toFixed(1)}, y ${this.cursor!.y.toFixed(1)}`);
    } else if (event.key === 'Enter' && this.cursor) this.pick(this.cursor);
    else if (event.key === '+' || event.key === '=') this.zoom(1.5);
    else if (event.key === '-') this.zoom(1 / 1.5);
    else if (event.key === '0') this.fit();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  private pick(at: { x: number; y: number }): void {
    if (!this.width || !this.onPick) return;
    if (at.x < -0.5 || at.y < -0.5 || at.x > this.width - 0.5 || at.y > this.height - 0.5) return;
    this.onPick(at.x, at.y);
  }

  // ---- drawing ----

  private drawNow(): void {
    const { w, h: high } = this.size;
    const ratio = devicePixelRatio || 1;
    if (!w || !high) return;
    if (this.canvas.width !== Math.round(w * ratio) || this.canvas.height !== Math.round(high * ratio)) {
      this.canvas.width = Math.round(w * ratio);
      this.canvas.height = Math.round(high * ratio);
    }
    const c = this.canvas.getContext('2d')!;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, w, high);
    if (this.image) {
      const [x, y] = this.toScreen(-0.5, -0.5);
      c.imageSmoothingEnabled = this.view.scale < 3;
      c.drawImage(this.image, x, y, this.width * this.view.scale, this.height * this.view.scale);
      this.drawOver(c, (px, py) => this.toScreen(px, py));
      this.drawCursor(c);
    }
    this.drawLoupe(ratio);
    this.box.classList.toggle('picks', this.onPick !== null && this.width > 0);
  }

  /** Everything twice: a dark edge, so that it is seen on any ground. */
  private drawOver(c: CanvasRenderingContext2D, to: (x: number, y: number) => [number, number]): void {
    for (const edge of [true, false]) {
      for (const line of this.lines) {
        c.setLineDash(line.dashed ? [7, 5] : []);
        c.lineWidth = edge ? 4 : 2;
        c.strokeStyle = edge ? 'rgba(0,0,0,.45)' : bright(line.colour);
        c.beginPath();
        line.points.forEach(([x, y], i) => (i ? c.lineTo(...to(x, y)) : c.moveTo(...to(x, y))));
        if (line.closed) c.closePath();
        c.stroke();
      }
      c.setLineDash([]);
      for (const mark of this.marks) drawMark(c, mark, to(mark.x, mark.y), edge);
    }
  }

  private drawCursor(c: CanvasRenderingContext2D): void {
    if (!this.cursor) return;
    const { x, y } = this.cursor;
    write(this.place, `x ${number(x, 1)}  y ${number(y, 1)} px`);
    if (!this.byKeys) return;
    const [sx, sy] = this.toScreen(x, y);
    for (const [width, stroke] of [[4, 'rgba(0,0,0,.55)'], [1.6, '#fff']] as [number, string][]) {
      c.lineWidth = width;
      c.strokeStyle = stroke;
      c.beginPath();
      for (const [ax, ay] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        c.moveTo(sx + 4 * ax, sy + 4 * ay);
        c.lineTo(sx + 15 * ax, sy + 15 * ay);
      }
      c.stroke();
    }
  }

  private drawLoupe(ratio: number): void {
    const at = this.cursor;
    this.loupe.hidden = !at || !this.image || !this.onPick;
    if (this.loupe.hidden || !at) return;
    const [sx, sy] = this.toScreen(at.x, at.y);
    const { w } = this.size;
    this.loupe.classList.toggle('left', sx > w / 2 && sy < LOUPE_PX + 60);
    this.loupe.width = this.loupe.height = LOUPE_PX * ratio;
    const c = this.loupe.getContext('2d')!;
    const times = Math.max(LOUPE_TIMES, Math.min(2 * this.view.scale, MOST_SCALE));
    const half = LOUPE_PX / 2;
    const to = (x: number, y: number): [number, number] => [half + (x - at.x) * times, half + (y - at.y) * times];
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.imageSmoothingEnabled = false;
    const [x, y] = to(-0.5, -0.5);
    c.drawImage(this.image!, x, y, this.width * times, this.height * times);
    this.drawOver(c, to);
    for (const [width, stroke] of [[3, 'rgba(0,0,0,.5)'], [1, '#fff']] as [number, string][]) {
      c.lineWidth = width;
      c.strokeStyle = stroke;
      c.beginPath();
      c.moveTo(half, 0);
      c.lineTo(half, half - 5);
      c.moveTo(half, half + 5);
      c.lineTo(half, LOUPE_PX);
      c.moveTo(0, half);
      c.lineTo(half - 5, half);
      c.moveTo(half + 5, half);
      c.lineTo(LOUPE_PX, half);
      c.stroke();
    }
  }
}

// On pictures the bright set of the palette is seen best, by day too.
const BRIGHT: Record<string, string> = { '--p1': '#56b4e9', '--p2': '#f58b3c', '--p3': '#2ec49a', '--p4': '#e39ac7', '--p5': '#f3c94a', '--bad': '#ff8f7e' };
const bright = (name: string): string => BRIGHT[name] ?? (colour(name) || '#fff');

function drawMark(c: CanvasRenderingContext2D, m: Mark, [x, y]: [number, number], edge: boolean): void {
  const size = m.kind === 'dot' ? 2.5 : m.strong ? 10 : 7;
  c.strokeStyle = edge ? 'rgba(0,0,0,.5)' : bright(m.colour);
  c.fillStyle = c.strokeStyle;
  c.lineWidth = edge ? 4.5 : m.strong ? 2.5 : 1.8;
  c.beginPath();
  if (m.kind === 'cross') {
    c.moveTo(x - size, y);
    c.lineTo(x + size, y);
    c.moveTo(x, y - size);
    c.lineTo(x, y + size);
    c.stroke();
  } else {
    c.arc(x, y, size + (edge && m.kind === 'dot' ? 1 : 0), 0, 2 * Math.PI);
    if (m.kind === 'dot') c.fill();
    else c.stroke();
  }
  if (!m.label) return;
  c.font = `${m.strong ? 700 : 600} 12px system-ui, sans-serif`;
  c.lineWidth = 3;
  const down = m.below ? size + 11 : 1 - size;
  if (edge) c.strokeText(m.label, x + size + 2, y + down);
  else c.fillText(m.label, x + size + 2, y + down);
}
