// Parameters as fields: what the server offers, with unit and range, and its refusal under the field.

import { h, newId, number, write } from './dom';
import type { Link } from './link';
import type { ParameterAbout } from './messages';

const UNITS: [string, string][] = [
  ['_1_s', '1/s'],
  ['_m', 'm'],
  ['_s', 's'],
  ['_deg', '°'],
  ['_rad', 'rad'],
  ['_n', 'N'],
];
const LABELS: Record<string, string> = {
  '/simulation/duration_s': 'Simulation lasts',
  '/control/period_s': 'Control period',
  '/control/gain_1_s': 'Control gain',
  '/generator/alpha': 'Weight α of the joints’ middle',
  '/generator/power': 'Power p of the norm',
};
const LAST: Record<string, string> = { duration: 'Motion lasts', law: 'Law of motion' };

function unitOf(name: string): [string, string] {
  for (const [end, unit] of UNITS) if (name.endsWith(end)) return [name.slice(0, -end.length), unit];
  return [name, ''];
}

export function labelOf(name: string): { group: string; label: string; unit: string } {
  const [bare, unit] = unitOf(name);
  const parts = bare.split('/').filter(Boolean);
  const last = parts[parts.length - 1];
  if (LABELS[name]) return { group: parts[0] === 'generator' ? 'Generator' : parts[0] === 'simulation' ? 'Simulation' : 'Control', label: LABELS[name], unit };
  const step = /^step_(\d+)$/.exec(parts[1] ?? '');
  if (step) {
    const via = /^via_(\d+)$/.exec(parts[2]);
    const where = parts[2] === 'to' ? ' · desired place' : via ? ` · via point ${via[1]}` : '';
    return { group: `Step ${step[1]}${where}`, label: LAST[last] ?? last, unit };
  }
  return { group: parts[0] ?? '', label: last ?? name, unit };
}

function range(p: ParameterAbout, unit: string): string {
  if (p.low === undefined || p.high === undefined) return '';
  if (Math.abs(p.low) >= 1e5 && Math.abs(p.high) >= 1e5) return '';
  const u = unit ? ` ${unit}` : '';
  if (p.high >= 1e4) return p.low === 0 && unit === 's' ? '0: as fast as the limits allow' : `at least ${number(p.low, p.low < 1 && p.low > 0 ? 3 : 0)}${u}`;
  return `${number(p.low, 0)} to ${number(p.high, 0)}${u}`;
}

function shown(value: unknown): string {
  return typeof value === 'number' ? String(Number(value.toPrecision(9))) : String(value ?? '');
}

abstract class Field {
  readonly root: HTMLElement;
  protected readonly error = h('p', { class: 'error', id: newId(), hidden: true });
  private readonly hint = h('span', { class: 'hint', id: newId() });
  protected busy = false;

  constructor(
    protected readonly link: Link,
    protected readonly about: ParameterAbout,
    protected readonly control: HTMLInputElement | HTMLSelectElement,
    label: string,
    unit: string,
  ) {
    control.id = newId();
    control.name = about.name;
    control.setAttribute('aria-describedby', `${this.hint.id} ${this.error.id}`);
    this.hint.textContent = range(about, unit);
    this.root = h(
      'div',
      { class: 'field' },
      h('label', { for: control.id }, label),
      h('div', { class: 'input' }, control, unit ? h('span', { class: 'unit', 'aria-hidden': 'true' }, unit) : null),
      this.hint,
      this.error,
    );
  }

  protected tell(text: string): void {
    write(this.error, text);
    this.error.hidden = text === '';
    if (text) this.control.setAttribute('aria-invalid', 'true');
    else this.control.removeAttribute('aria-invalid');
  }

  protected async send(value: number | string): Promise<void> {
    this.busy = true;
    this.root.classList.add('busy');
    const answer = await this.link.set(this.about.name, value);
    this.busy = false;
    this.root.classList.remove('busy');
    const still = shown(this.link.parameters.get(this.about.name));
    this.tell(answer.ok ? '' : `${answer.text.replace(`${this.about.name} is `, 'It is ')}. ${still} holds.`);
    if (answer.ok) this.update(true);
  }

  allow(yes: boolean): void {
    this.control.disabled = !yes;
  }

  /** The value in force. One that is being typed, or was refused, stays. */
  update(always = false): void {
    const value = shown(this.link.parameters.get(this.about.name));
    if (!always && (this.busy || document.activeElement === this.control || this.control.hasAttribute('aria-invalid'))) return;
    if (this.control.value !== value) this.control.value = value;
  }
}

class NumberField extends Field {
  constructor(link: Link, about: ParameterAbout, label: string, unit: string) {
    const input = h('input', { type: 'text', inputmode: 'decimal', autocomplete: 'off', spellcheck: 'false' });
    super(link, about, input, unit ? `${label}` : label, unit);
    input.addEventListener('change', () => void this.take());
    input.addEventListener('keydown', (event) => {
      if (event.key === 'Enter') input.blur();
    });
  }

  private take(): Promise<void> | void {
    const text = this.control.value.trim().replace('−', '-').replace(',', '.');
    const value = Number(text);
    const { low, high } = this.about;
    if (text === '') {
      this.tell('');
      return this.update(true);
    }
    if (!Number.isFinite(value)) return this.tell('This is no number.');
    if (low !== undefined && high !== undefined && (value < low || value > high)) return this.tell(`It is a number from ${number(low, 3).replace(/\.?0+$/, '')} to ${number(high, 0)}.`);
    this.tell('');
    return this.send(value);
  }
}

class ChoiceField extends Field {
  constructor(link: Link, about: ParameterAbout, label: string) {
    const select = h('select', {}, ...(about.choices ?? []).map((c) => h('option', { value: c }, c.replace('-', ' '))));
    super(link, about, select, label, '');
    select.addEventListener('change', () => {
      this.tell('');
      void this.send(select.value);
    });
  }
}

/** All that can be set, in groups; what can only be read stands below. */
export class Fields {
  readonly root = h('div', { class: 'fields' });
  private fields: Field[] = [];
  private made: ParameterAbout[] | null = null;
  private readonly why = h('p', { class: 'note' });

  /** `which`: of the names, those that are shown. */
  constructor(
    private readonly link: Link,
    private readonly which: (name: string) => boolean = () => true,
  ) {}

  update(): void {
    const list = this.link.panel?.parameters ?? null;
    if (list && list !== this.made) this.make(list);
    const free = /^(ready|nothing is prepared|simulated|validated|failed|executed|the machine holds)/.test(this.link.session?.phase ?? '');
    const may = this.link.leads && free;
    write(this.why, may ? '' : !this.link.leads ? 'Take control to set them.' : 'They can be set while nothing runs.');
    this.why.hidden = may;
    for (const field of this.fields) {
      field.allow(may);
      field.update();
    }
  }

  private make(list: ParameterAbout[]): void {
    this.made = list;
    this.fields = [];
    const groups = new Map<string, HTMLElement>();
    for (const p of list.filter((q) => q.settable && this.which(q.name))) {
      const { group, label, unit } = labelOf(p.name);
      let set = groups.get(group);
      if (!set) groups.set(group, (set = h('fieldset', { class: group.includes('·') ? 'place' : '' }, h('legend', {}, group))));
      const field = p.choices ? new ChoiceField(this.link, p, label) : new NumberField(this.link, p, label, unit);
      this.fields.push(field);
      set.append(field.root);
    }
    this.root.replaceChildren(this.why, ...groups.values());
  }
}
