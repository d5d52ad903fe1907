// A calibration's figures, each with its σ.

import { h, number } from '../dom';

interface Stereo {
  first: string;
  second: string;
  baseline_m: number;
  sigma_baseline_m: number | null;
  epipolar_error_px: number | null;
}

export interface Result {
  folder: string;
  verdict: 'accepted' | 'warned' | 'refused';
  reasons: string[];
  rms_px: number;
  cameras: Record<
    string,
    { model: string; rms_px: number; views: number; points: number; outlier_points: number; order: string[]; intrinsics: number[]; distortion: number[]; sigma_intrinsics: (number | null)[]; sigma_distortion: (number | null)[] }
  >;
  stereo?: Stereo | Stereo[] | null;
  leave_one_out?: { rms_px: number | null } | null;
}

function figure(value: number, sigma: number | null, digits: number): string {
  return `${number(value, digits)} ± ${sigma === null ? '–' : number(sigma, digits)}`;
}

/** So many digits that σ has two. */
const digitsOf = (sigma: number | null | undefined): number => (sigma ? Math.max(0, Math.min(8, 1 - Math.floor(Math.log10(sigma)))) : 4);

export function resultTable(r: Result): HTMLElement {
  const names = Object.keys(r.cameras);
  const order = r.cameras[names[0]].order;
  const rows = order.map((name, k) =>
    h(
      'tr',
      {},
      h('th', { scope: 'row' }, k < 4 ? `${name}, px` : name),
      ...names.map((n) => {
        const c = r.cameras[n];
        const value = k < 4 ? c.intrinsics[k] : c.distortion[k - 4];
        const sigma = k < 4 ? c.sigma_intrinsics[k] : c.sigma_distortion[k - 4];
        return h('td', { class: 'n' }, value === undefined ? '–' : figure(value, sigma ?? null, k < 4 ? 2 : digitsOf(sigma)));
      }),
    ),
  );
  const top: [string, (n: string) => string][] = [
    ['RMS, px', (n) => number(r.cameras[n].rms_px, 3)],
    ['views, points', (n) => `${r.cameras[n].views}, ${r.cameras[n].points}${r.cameras[n].outlier_points ? ` (${r.cameras[n].outlier_points} out)` : ''}`],
  ];
  const pairs = [r.stereo ?? []].flat();
  return h(
    'div',
    { class: 'figures' },
    h('p', { class: `verdict ${r.verdict}` }, `Verdict: ${r.verdict}`),
    r.reasons.length ? h('ul', { class: 'reasons' }, ...r.reasons.map((text) => h('li', {}, text))) : null,
    h(
      'div',
      { class: 'scroll plainly', tabindex: 0, role: 'region', 'aria-label': 'The cameras’ figures' },
      h(
        'table',
        {},
        h('thead', {}, h('tr', {}, h('th', { scope: 'col' }, 'Figure'), ...names.map((n) => h('th', { scope: 'col', class: 'n' }, n)))),
        h('tbody', {}, ...top.map(([name, f]) => h('tr', {}, h('th', { scope: 'row' }, name), ...names.map((n) => h('td', { class: 'n' }, f(n))))), ...rows),
      ),
    ),
    ...pairs.map((p) => h('p', { class: 'note' }, `${p.first}–${p.second}: baseline ${figure(1e3 * p.baseline_m, p.sigma_baseline_m === null ? null : 1e3 * p.sigma_baseline_m, 3)} mm, epipolar error ${number(p.epipolar_error_px, 3)} px`)),
    r.leave_one_out?.rms_px ? h('p', { class: 'note' }, `Views left out in turn: ${number(r.leave_one_out.rms_px, 3)} px RMS`) : null,
  );
}
