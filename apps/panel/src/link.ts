// The link to the server: one connection, made again by itself when it is lost, and watched so that nothing old is taken
// for new.
//
// A connection that is cut is told at once by the socket; one that hangs, or a session that does, by the age of what came
// last. `state` says which:
//   connecting   no connection yet, or none any more: a new one is tried
//   silent       connected, but nothing has come for SILENT_S
//   frozen       the server speaks, but the session's periods do not come
//   live         what is shown is now

import { decodeBinary, encodeCall, SUBPROTOCOLS, type Channel, type ParameterValue, type TextMessage } from './protocol';
import type { Panel, Session } from './messages';

export type LinkState = 'connecting' | 'silent' | 'frozen' | 'live';

/** Where messages come from: the link, or a recording. Times are the session's, in seconds. */
export interface Feed {
  /** Each message of that topic from now on, and the newest at once. Returns what ends it. */
  on<T>(topic: string, take: (message: T, time_s: number) => void): () => void;
  /** Tells of topics as they become known. */
  topics(): string[];
}

export interface Answer {
  ok: boolean;
  text: string;
  /** What a service answers besides. */
  response?: unknown;
}

const SILENT_S = 1.2; // diagnostics come each half second
const TICK_MS = 200;

type Taker = (message: unknown, time_s: number) => void;

export class Link implements Feed {
  state: LinkState = 'connecting';
  /** Told by the server: this connection's number, and the session of the program. */
  me = 0;
  everLive = false;
  panel: Panel | null = null;
  session: Session | null = null;
  /** Of the session's clock, s. */
  time_s = 0;
  readonly parameters = new Map<string, ParameterValue['value']>();
  /** What the server says to this client, newest last. */
  lastText = '';

  private socket: WebSocket | null = null;
  private program = '';
  private channels = new Map<string, Channel>();
  private services = new Map<string, number>();
  private takers = new Map<string, Set<Taker>>();
  private newest = new Map<string, { bytes: Uint8Array; time_s: number }>();
  private subscribed = new Map<number, string>();
  private nextSubscription = 1;
  private nextCall = 1;
  private calls = new Map<number, (answer: Answer, response: unknown) => void>();
  private setting: Promise<unknown> = Promise.resolve();
  private settled: { id: string; done: (values: ParameterValue[]) => void } | null = null;
  private warning = '';
  private heard_ms = 0;
  private seen_ms = 0; // the session's last period
  private lost_ms = performance.now();
  private wait_ms = 250;
  private listeners = new Set<() => void>();
  private readonly text = new TextDecoder();

  constructor(private readonly url: string) {
    this.on<Panel>('/panel', (panel) => {
      this.panel = panel;
      this.changed();
    });
    this.on<Session>('/session', (session, time_s) => {
      const before = this.session;
      this.session = session;
      this.time_s = time_s;
      this.seen_ms = performance.now();
      if (
        !before ||
        before.phase !== session.phase ||
        before.operator !== session.operator ||
        before.offers.join() !== session.offers.join() ||
        before.step !== session.step
      )
        this.changed();
      this.judge();
    });
    this.on('/diagnostics', () => undefined);
    setInterval(() => this.judge(), TICK_MS);
    this.connect();
  }

  /** Of what is shown, s. */
  get age_s(): number {
    const since = this.seen_ms || this.lost_ms;
    return (performance.now() - since) / 1000;
  }

  get leads(): boolean {
    return this.state === 'live' && this.me > 0 && this.session?.operator === this.me;
  }

  offers(event: string): boolean {
    return this.leads && (this.session?.offers.includes(event) ?? false);
  }

  /** When the state, control, offers, parameters or what there is have changed. */
  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    listener();
    return () => this.listeners.delete(listener);
  }

  on<T>(topic: string, take: (message: T, time_s: number) => void): () => void {
    let set = this.takers.get(topic);
    if (!set) this.takers.set(topic, (set = new Set()));
    const taker = take as Taker;
    set.add(taker);
    const last = this.newest.get(topic);
    if (last) taker(this.parse(last.bytes), last.time_s);
    else this.subscribe();
    return () => {
      set.delete(taker);
      if (set.size === 0 && this.takers.get(topic) === set) this.unsubscribe(topic);
    };
  }

  /** Whether the server has that service. */
  has(service: string): boolean {
    return this.services.has(service);
  }

  topics(): string[] {
    return [...this.channels.keys()];
  }

  /** An order, or another service. Never rejects: what cannot be sent is an answer too. */
  call(service: string, request: object = {}, within_s = 3): Promise<Answer> {
    const number = this.services.get(service);
    const socket = this.socket;
    if (!socket || socket.readyState !== WebSocket.OPEN || number === undefined)
      return Promise.resolve({ ok: false, text: 'not sent: there is no connection' });
    const call = this.nextCall++;
    return new Promise((resolve) => {
      const late = setTimeout(() => {
        this.calls.delete(call);
        resolve({ ok: false, text: `no answer within ${within_s} s` });
      }, 1000 * within_s);
      this.calls.set(call, (answer, response) => {
        clearTimeout(late);
        resolve({ ...answer, response });
      });
      socket.send(encodeCall(number, call, request));
    });
  }

  /** Sets a parameter. The answer's text is the reason where it is refused. */
  set(name: string, value: number | string): Promise<Answer> {
    const next = this.setting.then(() => this.setNow(name, value));
    this.setting = next;
    return next;
  }

  private setNow(name: string, value: number | string): Promise<Answer> {
    const socket = this.socket;
    if (!socket || socket.readyState !== WebSocket.OPEN)
      return Promise.resolve({ ok: false, text: 'not set: there is no connection' });
    const id = `set-${this.nextCall++}`;
    return new Promise((resolve) => {
      const end = (answer: Answer) => {
        clearTimeout(late);
        this.settled = null;
        resolve(answer);
      };
      const late = setTimeout(() => end({ ok: false, text: 'no answer within 3 s' }), 3000);
      this.warning = '';
      this.settled = {
        id,
        done: (values) => {
          const now = values.find((p) => p.name === name)?.value;
          const same = typeof value === 'number' ? Math.abs(Number(now) - value) < 1e-9 * Math.max(1, Math.abs(value)) : now === value;
          end(same && !this.warning ? { ok: true, text: 'set' } : { ok: false, text: this.warning || 'refused' });
        },
      };
      socket.send(JSON.stringify({ op: 'setParameters', parameters: [{ name, value }], id }));
    });
  }

  // ---- the connection ----

  private connect(): void {
    const socket = new WebSocket(this.url, SUBPROTOCOLS);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onopen = () => {
      this.wait_ms = 250;
      this.heard_ms = performance.now();
    };
    socket.onmessage = (event) => {
      if (socket !== this.socket) return;
      this.heard_ms = performance.now();
      if (typeof event.data === 'string') this.takeText(JSON.parse(event.data) as TextMessage);
      else this.takeBinary(event.data as ArrayBuffer);
    };
    socket.onclose = () => {
      if (socket === this.socket) this.lose();
    };
  }

  /** The connection is gone; what was asked is answered by that, and another is tried. */
  private lose(): void {
    this.socket?.close();
    this.socket = null;
    if (this.everLive && !this.lost_ms) this.lost_ms = performance.now();
    for (const done of this.calls.values()) done({ ok: false, text: 'the connection was lost before the answer came' }, null);
    this.calls.clear();
    this.settled?.done([]);
    this.subscribed.clear();
    this.channels.clear();
    this.services.clear();
    this.newest.clear();
    this.me = 0;
    this.judge();
    setTimeout(() => this.connect(), this.wait_ms);
    this.wait_ms = Math.min(2000, 2 * this.wait_ms);
  }

  private judge(): void {
    const now = performance.now();
    const open = this.socket?.readyState === WebSocket.OPEN;
    const period_s = this.panel?.period_s ?? 0;
    let state: LinkState = 'live';
    if (!open || !this.session || this.subscribed.size === 0) state = 'connecting';
    else if (now - this.heard_ms > 1000 * SILENT_S) state = 'silent';
    else if (now - this.seen_ms > 1000 * Math.max(SILENT_S, 4 * period_s)) state = 'frozen';
    // Nothing at all for long: the socket does not know yet that nobody is there.
    if (open && now - this.heard_ms > 5000) {
      this.heard_ms = now;
      this.lose();
      return;
    }
    if (state === 'live') {
      this.everLive = true;
      this.lost_ms = 0;
    }
    if (state === this.state) return;
    this.state = state;
    this.changed();
  }

  private changed(): void {
    for (const listener of this.listeners) listener();
  }

  private subscribe(): void {
    const socket = this.socket;
    if (!socket || socket.readyState !== WebSocket.OPEN) return;
    const have = new Set(this.subscribed.values());
    const rows: { id: number; channelId: number }[] = [];
    for (const topic of this.takers.keys()) {
      const channel = this.channels.get(topic);
      if (!channel || channel.encoding !== 'json' || have.has(topic)) continue;
      const id = this.nextSubscription++;
      this.subscribed.set(id, topic);
      rows.push({ id, channelId: channel.id });
    }
    if (rows.length > 0) socket.send(JSON.stringify({ op: 'subscribe', subscriptions: rows }));
  }

  /** What nobody here takes any more is not to be sent. */
  private unsubscribe(topic: string): void {
    this.takers.delete(topic);
    this.newest.delete(topic);
    for (const [id, name] of this.subscribed) {
      if (name !== topic) continue;
      this.subscribed.delete(id);
      this.socket?.send(JSON.stringify({ op: 'unsubscribe', subscriptionIds: [id] }));
    }
  }

  // ---- what comes in ----

  private takeText(m: TextMessage): void {
    if (m.op === 'serverInfo') {
      this.me = Number(m.metadata?.client ?? 0);
      // Another run of the program: nothing of the old one holds.
      if (m.sessionId !== this.program) this.panel = null;
      this.program = m.sessionId ?? '';
      this.session = null;
      this.nextCall = 1;
      const all: string[] = [];
      this.socket?.send(JSON.stringify({ op: 'getParameters', parameterNames: all, id: 'all' }));
      this.socket?.send(JSON.stringify({ op: 'subscribeParameterUpdates', parameterNames: all }));
    } else if (m.op === 'advertise') {
      for (const channel of m.channels) this.channels.set(channel.topic, channel);
      this.subscribe();
      this.changed();
    } else if (m.op === 'advertiseServices') {
      for (const service of m.services) this.services.set(service.name, service.id);
      this.changed();
    } else if (m.op === 'serviceCallFailure') {
      this.calls.get(m.callId)?.({ ok: false, text: m.message }, null);
      this.calls.delete(m.callId);
    } else if (m.op === 'parameterValues') {
      for (const p of m.parameters) this.parameters.set(p.name, p.value);
      if (this.settled && m.id === this.settled.id) this.settled.done(m.parameters);
      this.changed();
    } else if (m.op === 'status') {
      if (m.level > 0 && this.settled) this.warning = m.message.replace(/^refused: /, '');
      this.lastText = m.message;
      this.changed();
    }
  }

  private takeBinary(buffer: ArrayBuffer): void {
    const m = decodeBinary(buffer);
    if (m.op === 'response') {
      const response = this.parse(m.bytes) as { answer?: string };
      this.calls.get(m.call)?.({ ok: true, text: response.answer ?? 'done' }, response);
      this.calls.delete(m.call);
    } else if (m.op === 'data') {
      const topic = this.subscribed.get(m.subscription);
      if (topic === undefined) return;
      const time_s = Number(m.time_ns) * 1e-9;
      this.newest.set(topic, { bytes: m.bytes, time_s });
      const takers = this.takers.get(topic);
      if (!takers?.size) return;
      const message = this.parse(m.bytes);
      for (const take of takers) take(message, time_s);
    }
  }

  private parse(bytes: Uint8Array): unknown {
    return JSON.parse(this.text.decode(bytes));
  }
}
