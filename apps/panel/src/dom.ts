// Elements, and how numbers are written.

type Child = Node | string | null | undefined | false;
type Properties = Record<string, string | number | boolean | null | undefined | ((event: never) => void)>;

function set(e: Element, properties: Properties): void {
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === 'function') e.addEventListener(name, value as unknown as EventListener);
    else e.setAttribute(name, value === true ? '' : String(value));
  }
}

/** h('button', {class: 'main', click: f}, 'Start') */
export function h<K extends keyof HTMLElementTagNameMap>(name: K, properties: Properties = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const e = document.createElement(name);
  set(e, properties);
  e.append(...children.filter((c): c is Node | string => c !== null && c !== undefined && c !== false));
  return e;
}

export function s<K extends keyof SVGElementTagNameMap>(name: K, properties: Properties = {}, ...children: Child[]): SVGElementTagNameMap[K] {
  const e = document.createElementNS('http://www.w3.org/2000/svg', name);
  set(e, properties);
  e.append(...children.filter((c): c is Node | string => c !== null && c !== undefined && c !== false));
  return e;
}

/** Only when it is another: screen readers and the browser's layout are spared. */
export function write(e: Element, text: string): void {
  if (e.textContent !== text) e.textContent = text;
}

/** With a true minus, and no "-0". */
export function number(value: number | null | undefined, digits: number): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace('-', '') : text.replace('-', '−');
}

/** "StartSim" of "START": names of the table in a reader's letters. */
export function words(name: string): string {
  return name.toLowerCase().replaceAll('_', ' ');
}

export const degrees = (rad: number): number => (rad * 180) / Math.PI;

/** Phases in which steps and shares of a motion mean something. */
export const inMotion = (phase: string): boolean => /^(simulat|the simulation|the machine (executes|is paused)|executed)/.test(phase);

let ids = 0;
export const newId = (): string => `e${++ids}`;

/** As a colour of the style sheet stands now: light or dark. */
export function colour(name: string): string {
  return getComputedStyle(document.body).getPropertyValue(name).trim();
}

/** A card with a heading, and the age of what it shows when that is not now. */
export function card(title: string, ...children: Child[]): HTMLElement {
  const id = newId();
  return h(
    'section',
    { class: 'card', 'aria-labelledby': id },
    h('div', { class: 'head' }, h('h2', { id }, title), h('span', { class: 'age' })),
    ...children,
  );
}
