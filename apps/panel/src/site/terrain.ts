// The ground: an elevation map as a surface whose colours say height, sigma, where the height is from, or what has changed.
// Its light is in the colours, so that drawing it costs a texture and no more.

import { BufferAttribute, BufferGeometry, ClampToEdgeWrapping, DataTexture, LinearFilter, Mesh, RGBAFormat, Sphere, Vector3 } from 'three';
import type { Grid } from '../messages';
import { draped } from './shade';

export type Colouring = 'height' | 'sigma' | 'provenance' | 'difference';

export interface Map2 {
  columns: number;
  rows: number;
  cell: number;
  x: number; // of the first cell's centre
  y: number;
  frame: string;
  height: Float32Array;
  sigma: Float32Array;
  provenance: Uint8Array | null;
  time_s: number;
}

export interface Legend {
  title: string;
  /** Colours from low to high with their labels; or kinds. */
  stops?: { colours: string[]; labels: string[] };
  kinds?: { colour: string; label: string }[];
  note?: string;
}

export function decodeGrid(m: Grid, time_s: number): Map2 {
  const text = atob(m.data);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const view = new DataView(bytes.buffer);
  const columns = m.column_count;
  const rows = Math.floor(bytes.length / m.row_stride);
  const offset = (name: string) => m.fields.find((f) => f.name === name)?.offset ?? -1;
  const [h, s, p] = [offset('height'), offset('sigma'), offset('provenance')];
  const height = new Float32Array(columns * rows);
  const sigma = new Float32Array(columns * rows).fill(NaN);
  const provenance = p >= 0 ? new Uint8Array(columns * rows) : null;
  for (let r = 0, i = 0; r < rows; r++)
    for (let c = 0, at = r * m.row_stride; c < columns; c++, i++, at += m.cell_stride) {
      height[i] = view.getFloat32(at + h, true);
      if (s >= 0) sigma[i] = view.getFloat32(at + s, true);
      if (provenance) provenance[i] = view.getUint8(at + p);
    }
  const cell = m.cell_size.x;
  return { columns, rows, cell, x: m.pose.position.x + cell / 2, y: m.pose.position.y + cell / 2, frame: m.frame_id, height, sigma, provenance, time_s };
}

/** Bilinear; NaN beside the unknown. */
export function heightAt(map: Map2, x: number, y: number, of: Float32Array = map.height): number {
  const u = (x - map.x) / map.cell;
  const v = (y - map.y) / map.cell;
  const c = Math.floor(u);
  const r = Math.floor(v);
  if (c < 0 || r < 0 || c + 1 >= map.columns || r + 1 >= map.rows) return NaN;
  const i = r * map.columns + c;
  const a = u - c;
  const b = v - r;
  return (1 - b) * ((1 - a) * of[i] + a * of[i + 1]) + b * ((1 - a) * of[i + map.columns] + a * of[i + map.columns + 1]);
}

// Viridis and friends, sampled; the difference from blue over grey to orange, which all eyes tell apart.
type Rgb = [number, number, number];
const RAMPS: Record<'height' | 'sigma' | 'difference', Rgb[]> = {
  height: [[68, 1, 84], [70, 50, 126], [54, 92, 141], [39, 127, 142], [31, 161, 135], [74, 193, 109], [160, 218, 57], [253, 231, 37]],
  sigma: [[255, 247, 188], [254, 217, 118], [253, 174, 97], [240, 110, 60], [200, 50, 40], [120, 10, 40]],
  difference: [[5, 70, 140], [60, 140, 200], [160, 200, 228], [205, 205, 205], [244, 190, 140], [230, 120, 40], [160, 60, 0]],
};
// core/elevation.h, td_provenance.
export const PROVENANCE: { label: string; rgb: Rgb }[] = [
  { label: 'unknown', rgb: [110, 110, 110] },
  { label: 'given before', rgb: [185, 100, 170] },
  { label: 'measured once', rgb: [0, 130, 200] },
  { label: 'fused of several', rgb: [0, 160, 110] },
  { label: 'filled in', rgb: [230, 170, 40] },
  { label: 'simulated', rgb: [215, 110, 50] },
];

const css = (c: Rgb): string => `rgb(${c.map((v) => Math.round(v)).join(' ')})`;

function ramp(list: Rgb[], share: number, out: Rgb): Rgb {
  const k = Math.max(0, Math.min(1, share)) * (list.length - 1);
  const i = Math.min(list.length - 2, Math.floor(k));
  for (let n = 0; n < 3; n++) out[n] = list[i][n] + (k - i) * (list[i + 1][n] - list[i][n]);
  return out;
}

/** The values between which 98 % lie. */
function range(values: Float32Array): [number, number] {
  const step = Math.max(1, Math.floor(values.length / 20000));
  const some: number[] = [];
  for (let i = 0; i < values.length; i += step) if (Number.isFinite(values[i])) some.push(values[i]);
  if (some.length === 0) return [0, 1];
  some.sort((a, b) => a - b);
  const low = some[Math.floor(0.01 * (some.length - 1))];
  const high = some[Math.ceil(0.99 * (some.length - 1))];
  return high > low ? [low, high] : [low - 0.5, high + 0.5];
}

const MOST = 1 << 17; // vertices of the surface; the colours keep every cell

export class Terrain {
  readonly mesh = new Mesh(new BufferGeometry(), draped());
  map: Map2 | null = null;
  /** What a difference is against: the first that was seen. */
  before: Map2 | null = null;
  colouring: Colouring = 'height';
  legend: Legend = { title: '' };
  private texture: DataTexture | null = null;
  private step = 1;
  private level = 0;
  private indices: BufferAttribute[] = [];

  constructor() {
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
  }

  forget(): void {
    this.map = this.before = null;
    this.mesh.visible = false;
  }

  set(map: Map2): void {
    const same = this.map && this.map.columns === map.columns && this.map.rows === map.rows && this.map.x === map.x && this.map.y === map.y;
    this.map = map;
    if (!same || !this.before) this.before = map;
    this.step = Math.max(1, Math.ceil(Math.sqrt((map.columns * map.rows) / MOST)));
    this.shape(!same);
    this.paint();
    this.mesh.visible = true;
  }

  private shape(anew: boolean): void {
    const m = this.map!;
    const s = this.step;
    const nc = Math.floor((m.columns - 1) / s) + 1;
    const nr = Math.floor((m.rows - 1) / s) + 1;
    const geometry = this.mesh.geometry;
    if (anew) {
      this.mesh.geometry.dispose();
      const uv = new Float32Array(2 * nc * nr);
      for (let r = 0, k = 0; r < nr; r++)
        for (let c = 0; c < nc; c++, k += 2) {
          uv[k] = (c * s + 0.5) / m.columns;
          uv[k + 1] = (r * s + 0.5) / m.rows;
        }
      geometry.setAttribute('position', new BufferAttribute(new Float32Array(3 * nc * nr), 3));
      geometry.setAttribute('uv', new BufferAttribute(uv, 2));
    }
    const middle = new Vector3(m.x + (m.columns * m.cell) / 2, m.y + (m.rows * m.cell) / 2, 0);
    geometry.boundingSphere = new Sphere(middle, m.cell * Math.hypot(m.columns, m.rows));
    const position = geometry.getAttribute('position') as BufferAttribute;
    const at = position.array as Float32Array;
    for (let r = 0, k = 0; r < nr; r++)
      for (let c = 0; c < nc; c++, k++) {
        at[3 * k] = m.x + c * s * m.cell;
        at[3 * k + 1] = m.y + r * s * m.cell;
        const z = m.height[r * s * m.columns + c * s];
        at[3 * k + 2] = z; // NaN is never drawn: no triangle has it
      }
    position.needsUpdate = true;
    this.indices = [1, 2, 4].map((skip) => this.triangles(at, nc, nr, skip));
    geometry.setIndex(this.indices[this.level]);
  }

  /** Of each skip-th vertex; the last row and column are kept. */
  private triangles(at: Float32Array, nc: number, nr: number, skip: number): BufferAttribute {
    const along = (n: number) => {
      const list: number[] = [];
      for (let i = 0; i < n - 1; i += skip) list.push(i);
      list.push(n - 1);
      return list;
    };
    const columns = along(nc);
    const rows = along(nr);
    const index = new Uint32Array(6 * (columns.length - 1) * (rows.length - 1));
    let n = 0;
    for (let r = 0; r + 1 < rows.length; r++)
      for (let c = 0; c + 1 < columns.length; c++) {
        const a = rows[r] * nc + columns[c];
        const b = rows[r] * nc + columns[c + 1];
        const d = rows[r + 1] * nc + columns[c];
        const e = rows[r + 1] * nc + columns[c + 1];
        if (!Number.isFinite(at[3 * a + 2] + at[3 * b + 2] + at[3 * d + 2] + at[3 * e + 2])) continue;
        index.set([a, b, d, b, e, d], n);
        n += 6;
      }
    return new BufferAttribute(index.slice(0, n), 1);
  }

  /** 0: as fine as it is kept; more is coarser. The colours stay as they are. */
  detail(level: number): void {
    if (level === this.level) return;
    this.level = level;
    if (this.indices.length > 0) this.mesh.geometry.setIndex(this.indices[level]);
  }

  /** Colours and legend by what is to be seen. */
  paint(): void {
    const m = this.map;
    if (!m) return;
    const n = m.columns * m.rows;
    if (!this.texture || this.texture.image.width !== m.columns || this.texture.image.height !== m.rows) {
      this.texture?.dispose();
      const t = new DataTexture(new Uint8Array(4 * n), m.columns, m.rows, RGBAFormat);
      t.magFilter = t.minFilter = LinearFilter;
      t.wrapS = t.wrapT = ClampToEdgeWrapping;
      this.texture = t;
      this.mesh.material.uniforms.map.value = t;
    }
    const data = this.texture.image.data as Uint8Array;
    const value = this.values(m);
    const rgb: Rgb = [0, 0, 0];
    for (let r = 0, i = 0; r < m.rows; r++)
      for (let c = 0; c < m.columns; c++, i++) {
        value(i, rgb);
        const light = this.light(m, r, c, i);
        data[4 * i] = Math.min(255, rgb[0] * light);
        data[4 * i + 1] = Math.min(255, rgb[1] * light);
        data[4 * i + 2] = Math.min(255, rgb[2] * light);
        data[4 * i + 3] = 255;
      }
    this.texture.needsUpdate = true;
  }

  /** Lambert's, of a sun in the north-west at 45 degrees, and some from everywhere. */
  private light(m: Map2, r: number, c: number, i: number): number {
    const west = c > 0 ? i - 1 : i;
    const east = c + 1 < m.columns ? i + 1 : i;
    const south = r > 0 ? i - m.columns : i;
    const north = r + 1 < m.rows ? i + m.columns : i;
    const gx = (m.height[east] - m.height[west]) / ((east - west || 1) * m.cell);
    const gy = (m.height[north] - m.height[south]) / (((north - south) / m.columns || 1) * m.cell);
    const lit = (0.5 * gx - 0.5 * gy + 0.7071) / Math.sqrt(1 + gx * gx + gy * gy);
    return Number.isFinite(lit) ? 0.42 + 0.72 * Math.max(0, lit) : 0.9;
  }

  private values(m: Map2): (i: number, out: Rgb) => void {
    const scale = (kind: 'height' | 'sigma' | 'difference', of: (i: number) => number, low: number, high: number) => {
      const list = RAMPS[kind];
      return (i: number, out: Rgb) => {
        const v = of(i);
        if (Number.isFinite(v)) ramp(list, (v - low) / (high - low), out);
        else out[0] = out[1] = out[2] = 120;
      };
    };
    if (this.colouring === 'sigma') {
      const [, high] = range(m.sigma);
      this.legend = { title: 'σ of the height', stops: { colours: RAMPS.sigma.map(css), labels: ['0', `${(500 * high).toFixed(0)}`, `${(1000 * high).toFixed(0)} mm`] }, note: 'grey: not known' };
      return scale('sigma', (i) => m.sigma[i], 0, high);
    }
    if (this.colouring === 'provenance') {
      this.legend = { title: 'Where the height is from', kinds: PROVENANCE.map((p) => ({ colour: css(p.rgb), label: p.label })), note: m.provenance ? undefined : 'this map does not say' };
      return (i, out) => {
        const p = PROVENANCE[m.provenance?.[i] ?? 0] ?? PROVENANCE[0];
        out[0] = p.rgb[0];
        out[1] = p.rgb[1];
        out[2] = p.rgb[2];
      };
    }
    if (this.colouring === 'difference') {
      const before = this.before!;
      const change = (i: number) => m.height[i] - before.height[i];
      let most = 0.05;
      for (let i = 0; i < m.height.length; i++) if (Math.abs(change(i)) > most) most = Math.abs(change(i));
      const label = most.toFixed(2);
      this.legend = {
        title: 'Height, now less before',
        stops: { colours: RAMPS.difference.map(css), labels: [`−${label}`, '0', `+${label} m`] },
        note: before === m ? 'there is one map so far' : `before: the map at ${before.time_s.toFixed(1)} s, the first seen`,
      };
      return scale('difference', change, -most, most);
    }
    const [low, high] = range(m.height);
    this.legend = { title: 'Height', stops: { colours: RAMPS.height.map(css), labels: [`${low.toFixed(2)}`, `${((low + high) / 2).toFixed(2)}`, `${high.toFixed(2)} m`] } };
    return scale('height', (i) => m.height[i], low, high);
  }

  /** Where a ray meets the ground first, in the map's frame; null: nowhere. */
  meet(origin: Vector3, direction: Vector3): Vector3 | null {
    const m = this.map;
    if (!m) return null;
    const at = new Vector3();
    let before = NaN;
    const step = m.cell / 2;
    const most = 400;
    for (let t = 0; t < most; t += Math.max(step, step * 0.02 * t)) {
      at.copy(direction).multiplyScalar(t).add(origin);
      const above = at.z - heightAt(m, at.x, at.y);
      if (Number.isFinite(before) && before > 0 && above <= 0) {
        let low = t - Math.max(step, step * 0.02 * t) * 1.1;
        let high = t;
        for (let k = 0; k < 20; k++) {
          const middle = (low + high) / 2;
          at.copy(direction).multiplyScalar(middle).add(origin);
          if (at.z - heightAt(m, at.x, at.y) > 0) low = middle;
          else high = middle;
        }
        return at;
      }
      before = above;
    }
    return null;
  }
}
