// Lengths and volumes on the ground, by points that are clicked.

import { BufferGeometry, CanvasTexture, Group, Line, LineBasicMaterial, Sprite, SpriteMaterial, Vector3 } from 'three';
import { colour, number } from '../dom';
import type { SiteScene } from './scene';
import { heightAt, type Map2 } from './terrain';

export type Mode = 'none' | 'line' | 'volume';

function dot(at: Vector3, tone: string): Sprite {
  const canvas = document.createElement('canvas');
  canvas.width = canvas.height = 32;
  const c = canvas.getContext('2d')!;
  c.fillStyle = tone;
  c.strokeStyle = '#fff';
  c.lineWidth = 5;
  c.beginPath();
  c.arc(16, 16, 12, 0, 7);
  c.fill();
  c.stroke();
  const sprite = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), depthTest: false, sizeAttenuation: false }));
  sprite.scale.setScalar(0.022);
  sprite.position.copy(at);
  sprite.renderOrder = 9;
  return sprite;
}

function inside(x: number, y: number, corner: Vector3[]): boolean {
  let yes = false;
  for (let i = 0, j = corner.length - 1; i < corner.length; j = i++)
    if (corner[i].y > y !== corner[j].y > y && x < ((corner[j].x - corner[i].x) * (y - corner[i].y)) / (corner[j].y - corner[i].y) + corner[i].x) yes = !yes;
  return yes;
}

/** z = a x + b y + c through the corners, by least squares about their middle. */
function plane(corner: Vector3[]): (x: number, y: number) => number {
  const n = corner.length;
  const m = corner.reduce((sum, p) => sum.add(p), new Vector3()).divideScalar(n);
  let [xx, xy, yy, xz, yz] = [0, 0, 0, 0, 0];
  for (const p of corner) {
    const [x, y, z] = [p.x - m.x, p.y - m.y, p.z - m.z];
    xx += x * x;
    xy += x * y;
    yy += y * y;
    xz += x * z;
    yz += y * z;
  }
  const det = xx * yy - xy * xy;
  const a = det > 1e-12 ? (xz * yy - yz * xy) / det : 0;
  const b = det > 1e-12 ? (yz * xx - xz * xy) / det : 0;
  return (x, y) => m.z + a * (x - m.x) + b * (y - m.y);
}

/** Volumes above and below `floor` within the corners, m³, and what sigma makes of them: if cells err each by itself, and if
 *  all err together. */
export function volume(map: Map2, corner: Vector3[], floor: (x: number, y: number, i: number) => number, of: Float32Array | null): { above: number; below: number; area: number; unknown: number; alone: number; together: number } {
  const cell = map.cell * map.cell;
  let [above, below, unknown, squares, sum] = [0, 0, 0, 0, 0];
  for (let r = 0, i = 0; r < map.rows; r++)
    for (let c = 0; c < map.columns; c++, i++) {
      const x = map.x + c * map.cell;
      const y = map.y + r * map.cell;
      if (!inside(x, y, corner)) continue;
      const d = map.height[i] - floor(x, y, i);
      if (!Number.isFinite(d)) {
        unknown += cell;
        continue;
      }
      if (d > 0) above += d * cell;
      else below -= d * cell;
      const s2 = map.sigma[i] * map.sigma[i] + (of ? of[i] * of[i] : 0);
      if (Number.isFinite(s2)) {
        squares += s2;
        sum += Math.sqrt(s2);
      }
    }
  const area = Math.abs(corner.reduce((a, p, i) => a + p.x * corner[(i + 1) % corner.length].y - corner[(i + 1) % corner.length].x * p.y, 0)) / 2;
  return { above, below, area, unknown, alone: cell * Math.sqrt(squares), together: cell * sum };
}

export class Measure {
  mode: Mode = 'none';
  private points: Vector3[] = [];
  private closed = false;
  private readonly drawn = new Group();
  onResult: (lines: string[]) => void = () => undefined;

  constructor(private readonly site: SiteScene) {
    site.marks.add(this.drawn);
  }

  set(mode: Mode): void {
    this.mode = mode;
    this.clear();
    this.tell();
  }

  clear(): void {
    this.points = [];
    this.closed = false;
    this.redraw();
  }

  take(at: Vector3): void {
    if (this.mode === 'none') return;
    if (this.closed || (this.mode === 'line' && this.points.length === 2)) this.clear();
    this.points.push(at);
    this.redraw();
    this.tell();
  }

  close(): void {
    if (this.mode !== 'volume' || this.points.length < 3) return;
    this.closed = true;
    this.redraw();
    this.tell();
  }

  get canClose(): boolean {
    return this.mode === 'volume' && this.points.length >= 3 && !this.closed;
  }

  private redraw(): void {
    this.drawn.clear();
    const tone = colour('--p4');
    if (this.points.length > 1) {
      const list = this.closed ? [...this.points, this.points[0]] : this.points;
      const line = new Line(new BufferGeometry().setFromPoints(this.draped(list)), new LineBasicMaterial({ color: tone, depthTest: false, linewidth: 2 }));
      line.renderOrder = 8;
      this.drawn.add(line);
    }
    for (const p of this.points) this.drawn.add(dot(p, tone));
    this.site.draw();
  }

  /** A volume's rim lies on the ground; a line is straight. */
  private draped(list: Vector3[]): Vector3[] {
    const map = this.site.terrain.map;
    if (this.mode === 'line' || !map) return list;
    const out: Vector3[] = [];
    for (let i = 0; i + 1 < list.length; i++)
      for (let k = 0; k < 20; k++) {
        const p = list[i].clone().lerp(list[i + 1], k / 20);
        const z = heightAt(map, p.x, p.y);
        if (Number.isFinite(z)) p.z = z;
        out.push(p);
      }
    out.push(list[list.length - 1]);
    return out;
  }

  /** Again, on a map that has changed. */
  tell(): void {
    this.onResult(this.mode === 'line' ? this.tellLine() : this.mode === 'volume' ? this.tellVolume() : []);
  }

  private sigma(p: Vector3): number {
    const map = this.site.terrain.map;
    return map ? heightAt(map, p.x, p.y, map.sigma) : NaN;
  }

  private tellLine(): string[] {
    if (this.points.length < 2) return [this.points.length === 0 ? 'Click the first point on the ground.' : 'Click the second point.'];
    const [a, b] = this.points;
    const across = Math.hypot(b.x - a.x, b.y - a.y);
    const rise = b.z - a.z;
    const s = Math.hypot(this.sigma(a), this.sigma(b));
    const known = Number.isFinite(s) ? ` ± ${number(1000 * s, 0)} mm` : '';
    return [
      `length ${number(a.distanceTo(b), 3)} m`,
      `level ${number(across, 3)} m, rise ${number(rise, 3)} m${known}`,
      `slope ${number((Math.atan2(rise, across) * 180) / Math.PI, 1)}°`,
      `from ${number(a.x, 2)}, ${number(a.y, 2)}, ${number(a.z, 2)} to ${number(b.x, 2)}, ${number(b.y, 2)}, ${number(b.z, 2)} m`,
    ];
  }

  private tellVolume(): string[] {
    const { map, before } = this.site.terrain;
    if (!map) return ['There is no map to measure on.'];
    if (!this.closed) return [this.points.length < 3 ? `Click the corners of the area (${this.points.length} so far).` : 'Click more corners, or close the area (Enter).'];
    const flat = plane(this.points);
    const v = volume(map, this.points, flat, null);
    const lines = [`area ${number(v.area, 2)} m²${v.unknown > 0 ? `, ${number(v.unknown, 2)} m² of it not known` : ''}`];
    const sigma = (w: typeof v) => (w.together > 0 ? ` (σ ${number(w.alone, 3)} m³ if cells err apart, ${number(w.together, 3)} together)` : '');
    lines.push(`below the plane of its corners ${number(v.below, 3)} m³, above it ${number(v.above, 3)} m³${sigma(v)}`);
    if (before && before !== map && before.height.length === map.height.length) {
      const w = volume(map, this.points, (_x, _y, i) => before.height[i], before.sigma);
      lines.push(`since the first map: cut ${number(w.below, 3)} m³, fill ${number(w.above, 3)} m³${sigma(w)}`);
    }
    return lines;
  }
}
