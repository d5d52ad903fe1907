// Points and triangles seen from above: the surface as it grows, its height by colour.

import { h, number, s, write } from '../dom';
import type { Points } from '../views/match';

const SIZE = 260;
const EDGE = 26;

/** Dark to light, the same lightness steps everywhere; blue is low (after Crameri's batlow). */
const RAMP: [number, number, number][] = [[1, 33, 89], [16, 63, 96], [28, 90, 98], [60, 109, 86], [104, 123, 62], [157, 137, 43], [210, 147, 67], [248, 161, 123], [253, 183, 188], [250, 204, 250]];

export function ramp(share: number): string {
  const at = Math.max(0, Math.min(0.999, Number.isFinite(share) ? share : 0.5)) * (RAMP.length - 1);
  const i = Math.floor(at);
  const mix = RAMP[i].map((v, k) => Math.round(v + (RAMP[i + 1][k] - v) * (at - i)));
  return `rgb(${mix.join(',')})`;
}

export class Plan {
  private readonly svg = s('svg', { class: 'plan', viewBox: `0 0 ${SIZE} ${SIZE}`, role: 'img', 'aria-label': 'The surface from above' });
  private readonly low = h('span', {}, '');
  private readonly high = h('span', {}, '');
  private readonly legend: HTMLElement;
  readonly root: HTMLElement;

  constructor() {
    const steps = Array.from({ length: 20 }, (_, k) => s('rect', { x: 5 * k, y: 0, width: 5.2, height: 8, fill: ramp(k / 19) }));
    this.legend = h('div', { class: 'ramp', hidden: true }, this.low, s('svg', { viewBox: '0 0 100 8', 'aria-hidden': 'true', preserveAspectRatio: 'none' }, ...steps) as unknown as HTMLElement, this.high);
    this.root = h('div', { class: 'plan-box' }, this.svg as unknown as HTMLElement, this.legend);
  }

  show(points: Points | null): void {
    const list = points?.points ?? [];
    this.svg.replaceChildren();
    this.root.hidden = list.length === 0;
    this.legend.hidden = list.length < 2;
    if (!list.length) return;
    const axis = (k: number) => list.map((p) => p.p![k]);
    const low = [0, 1, 2].map((k) => Math.min(...axis(k)));
    const high = [0, 1, 2].map((k) => Math.max(...axis(k)));
    const span = Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
    const scale = (SIZE - 2 * EDGE) / span;
    const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    // x to the right, y up, as on a map.
    const at = (p: [number, number, number]) => [SIZE / 2 + (p[0] - middle[0]) * scale, SIZE / 2 - (p[1] - middle[1]) * scale];
    const height = (z: number) => (high[2] > low[2] ? (z - low[2]) / (high[2] - low[2]) : 0.5);
    for (const t of points!.triangles) {
      const corners = t.map((i) => list[i].p!);
      this.svg.append(s('polygon', { points: corners.map((p) => at(p).join(',')).join(' '), fill: ramp(height(corners.reduce((sum, p) => sum + p[2] / 3, 0))), class: 'triangle' }));
    }
    list.forEach((p, i) => {
      const [x, y] = at(p.p!);
      const newest = i === list.length - 1;
      this.svg.append(s('circle', { cx: x, cy: y, r: newest ? 5 : 3.5, fill: ramp(height(p.p![2])), class: newest ? 'spot newest' : 'spot' }));
      if (list.length <= 40) this.svg.append(s('text', { x: x + 6, y: y - 5 }, p.point));
    });
    this.svg.setAttribute('aria-label', `The surface from above: ${list.length} points, ${points!.triangles.length} triangles, heights from ${number(low[2], 3)} to ${number(high[2], 3)} m`);
    write(this.low, `${number(low[2], 3)} m`);
    write(this.high, `${number(high[2], 3)} m`);
  }
}
