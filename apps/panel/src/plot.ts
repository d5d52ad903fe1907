// Curves over the session's time.

import uPlot from 'uplot';
import { colour, h, number, write } from './dom';

export interface Curve {
  name: string;
  colour: string; // of the style sheet: "--p1"
  wanted?: boolean; // desired: dashed
}

const KEEP = 40000;

/** Samples by time; one store for several plots. */
export class Store {
  readonly time: number[] = [];
  readonly values: (number | null)[][];

  constructor(readonly width: number) {
    this.values = Array.from({ length: width }, () => []);
  }

  add(time_s: number, row: (number | null)[]): void {
    const last = this.time[this.time.length - 1];
    if (last !== undefined && time_s < last) this.clear(); // another session
    else if (time_s === last) return;
    this.time.push(time_s);
    for (let i = 0; i < this.width; i++) this.values[i].push(row[i] ?? null);
    if (this.time.length < 2 * KEEP) return;
    this.time.splice(0, KEEP);
    for (const column of this.values) column.splice(0, KEEP);
  }

  /** What is not known in between is not drawn as known. */
  gap(): void {
    const last = this.time[this.time.length - 1];
    if (last === undefined || this.values[0][this.time.length - 1] === null) return;
    this.time.push(last + 1e-6);
    for (const column of this.values) column.push(null);
  }

  clear(): void {
    this.time.length = 0;
    for (const column of this.values) column.length = 0;
  }

  /** Index of the first sample not before t. */
  from(t: number): number {
    let low = 0;
    let high = this.time.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

export class Plot {
  readonly root: HTMLElement;
  /** s that are shown; Infinity: all. */
  window_s = 30;
  private chart: uPlot | null = null;
  private shown = 0;
  private readonly holder = h('div', { class: 'chart' });
  private readonly values: HTMLElement[] = [];

  constructor(
    readonly title: string,
    private readonly digits: number,
    private readonly store: Store,
    private readonly columns: number[],
    private readonly curves: Curve[],
    private readonly scale = 1,
  ) {
    this.holder.setAttribute('role', 'img');
    this.holder.setAttribute('aria-label', `${title} over time: ${curves.map((c) => c.name).join(', ')}`);
    const items = curves.map((c) => {
      const value = h('span', {});
      this.values.push(value);
      return c.wanted ? null : h('li', { class: `c${c.colour.slice(3)}` }, c.name, value);
    });
    const dashed = curves.some((c) => c.wanted) && h('li', { class: 'wanted' }, 'desired');
    this.root = h('figure', { class: 'plot' }, h('figcaption', {}, title), h('ul', { class: 'legend' }, ...items, dashed), this.holder);
    new ResizeObserver(() => this.resize()).observe(this.holder);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.rebuild());
  }

  get points(): number {
    return this.shown;
  }

  private rebuild(): void {
    this.chart?.destroy();
    this.chart = null;
    this.draw();
  }

  private size(): { width: number; height: number } {
    return { width: Math.max(200, this.holder.clientWidth), height: innerWidth < 700 ? 180 : 200 };
  }

  private resize(): void {
    if (this.holder.clientWidth > 0) this.chart?.setSize(this.size());
  }

  private make(data: uPlot.AlignedData): uPlot {
    const axis = { stroke: colour('--muted'), grid: { stroke: colour('--faint'), width: 1 }, ticks: { stroke: colour('--line'), width: 1, size: 5 }, font: '12px system-ui, sans-serif' };
    return new uPlot(
      {
        ...this.size(),
        scales: { x: { time: false }, y: { range: (_u, low, high) => span(low, high, Math.pow(10, -this.digits)) } },
        cursor: { sync: { key: 'time' }, drag: { x: false, y: false }, points: { size: 6 } },
        legend: { show: false },
        hooks: { setCursor: [(u) => this.tell(u)] },
        axes: [
          { ...axis, size: 34, values: (_u, ticks) => ticks.map((t) => `${t} s`) },
          { ...axis, size: 58 },
        ],
        series: [
          {},
          ...this.curves.map((c) => ({
            label: c.name,
            stroke: colour(c.colour),
            width: c.wanted ? 1.5 : 2,
            dash: c.wanted ? [6, 5] : undefined,
            points: { show: false },
          })),
        ],
      },
      data,
      this.holder,
    );
  }

  /** The values where the pointer is. */
  private tell(u: uPlot): void {
    const i = u.cursor.idx;
    this.values.forEach((e, k) => {
      const v = i === null || i === undefined ? null : u.data[k + 1]?.[i];
      write(e, v === null || v === undefined ? '' : number(v, this.digits));
    });
  }

  draw(): void {
    if (this.holder.clientWidth === 0) return;
    const { time, values } = this.store;
    const end = time[time.length - 1] ?? 0;
    const first = Number.isFinite(this.window_s) ? this.store.from(end - this.window_s) : 0;
    // No more samples than a screen has columns would show anything but more work.
    const step = Math.max(1, Math.floor((time.length - first) / 4000));
    const take = (list: (number | null)[], k: number): (number | null)[] => {
      const out: (number | null)[] = [];
      for (let i = first; i < list.length; i += step) out.push(list[i] === null ? null : (list[i] as number) * k);
      return out;
    };
    const data = [take(time, 1), ...this.columns.map((c) => take(values[c], this.scale))] as uPlot.AlignedData;
    this.shown = data[0].length;
    this.root.dataset.points = String(time.length);
    if (!this.chart) this.chart = this.make(data);
    else this.chart.setData(data);
  }
}

/** A range that holds low to high with some room, and is never so narrow that noise fills it. */
function span(low: number | null, high: number | null, least: number): [number, number] {
  if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const middle = (low + high) / 2;
  const half = Math.max((high - low) * 0.55, 5 * least);
  return [middle - half, middle + half];
}
