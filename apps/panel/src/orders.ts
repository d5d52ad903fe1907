// The operator's orders: by buttons, by keys, and what was answered.

import type { Answer, Link } from './link';

export interface Order {
  name: string; // of the service, and of the event among the offers
  key: string; // KeyboardEvent.key
  shown: string;
}

/** In the order of a session. */
export const ORDERS: Order[] = [
  { name: 'Prepare', key: 'p', shown: 'P' },
  { name: 'StartSim', key: 's', shown: 'S' },
  { name: 'Pause', key: ' ', shown: 'Space' },
  { name: 'Resume', key: ' ', shown: 'Space' },
  { name: 'Abort', key: 'a', shown: 'A' },
  { name: 'Reinit', key: 'r', shown: 'R' },
  { name: 'Validate', key: 'v', shown: 'V' },
  { name: 'Download', key: 'D', shown: '⇧ D' },
  { name: 'Execute', key: 'E', shown: '⇧ E' },
  { name: 'Manual', key: 'm', shown: 'M' },
  { name: 'Automatic', key: 'm', shown: 'M' },
];

/** Backwards, forwards: of the first, second … joint, as `teledimos simulate --live` has them. */
export const JOG_KEYS: [string, string][] = [
  ['ArrowLeft', 'ArrowRight'],
  ['ArrowDown', 'ArrowUp'],
  ['u', 'j'],
  ['i', 'k'],
];

const JOG_EVERY_MS = 100;
const JOG_HOLDS_S = 0.3; // what a lost link leaves of it

export type Told = { what: string; answer: Answer };

export class Orders {
  static of = new WeakMap<Link, Orders>();
  /** Of full speed. */
  stick = 0.5;
  /** Letters are orders: can be switched off. */
  keys = localStorage.getItem('keys') !== 'off';
  private listeners = new Set<(told: Told) => void>();
  private held: { joint: string; sign: number; timer: number } | null = null;
  private heldKey = '';

  constructor(private readonly link: Link) {
    Orders.of.set(link, this);
    addEventListener('blur', () => this.release());
    document.addEventListener('visibilitychange', () => this.release());
  }

  onTold(listener: (told: Told) => void): void {
    this.listeners.add(listener);
  }

  private tell(what: string, answer: Answer): Answer {
    for (const listener of this.listeners) listener({ what, answer });
    return answer;
  }

  async give(name: string, request: object = {}): Promise<Answer> {
    return this.tell(name, await this.link.call(name, request));
  }

  /** Whoever leads may stop; where nobody does, control is taken first. */
  async stop(): Promise<void> {
    this.release();
    if (this.link.session?.operator === 0) await this.link.call('TakeControl');
    await this.give('UserStop');
  }

  setKeys(on: boolean): void {
    this.keys = on;
    localStorage.setItem('keys', on ? 'on' : 'off');
  }

  // ---- jog: as long as a button or key is held ----

  hold(joint: string, sign: number): void {
    if (this.held?.joint === joint && this.held.sign === sign) return;
    this.release();
    if (!this.link.offers('Jog')) return;
    const jog = async () => {
      const answer = await this.link.call('Jog', { joint, stick: sign * this.stick, for_s: JOG_HOLDS_S });
      if (!answer.ok) {
        this.tell('Jog', answer);
        this.release();
      }
    };
    this.held = { joint, sign, timer: window.setInterval(() => void jog(), JOG_EVERY_MS) };
    void jog();
  }

  release(): void {
    if (!this.held) return;
    clearInterval(this.held.timer);
    void this.link.call('Jog', { joint: this.held.joint, stick: 0, for_s: 0.01 });
    this.held = null;
    this.heldKey = '';
  }

  // ---- keys ----

  key(event: KeyboardEvent): void {
    if (event.key === 'Escape') {
      event.preventDefault();
      void this.stop();
      return;
    }
    const at = event.target as HTMLElement;
    const typing = at.matches('input:not([type=checkbox]):not([type=radio]):not([type=range]), select, textarea');
    if (event.ctrlKey || event.altKey || event.metaKey || !this.keys || typing) return;
    const presses = event.key === ' ' || event.key === 'Enter';
    if (presses && at.closest('button, a, summary, [role=button], input')) return;
    if (event.key.startsWith('Arrow') && at.closest('[data-arrows], input')) return;
    const joint = JOG_KEYS.findIndex((pair) => pair.includes(event.key));
    const name = this.link.panel?.joints[joint]?.name;
    if (name && this.link.offers('Jog')) {
      event.preventDefault();
      this.heldKey = event.key;
      this.hold(name, JOG_KEYS[joint][0] === event.key ? -1 : 1);
      return;
    }
    if (event.repeat) return;
    const order = ORDERS.find((o) => o.key === event.key && this.link.offers(o.name));
    if (order) {
      event.preventDefault();
      void this.give(order.name);
    } else if (event.key === 't' && this.link.session?.operator === 0) void this.give('TakeControl');
  }

  keyUp(event: KeyboardEvent): void {
    if (event.key === this.heldKey) this.release();
  }
}
