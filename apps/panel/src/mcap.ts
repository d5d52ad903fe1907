// Recordings (https://mcap.dev/spec) from a file on disk, by their indices: a seek reads a chunk or two of it, whatever its
// size. Chunks without compression, as this program writes them.

import type { Feed } from './link';

const MAGIC = [0x89, 0x4d, 0x43, 0x41, 0x50, 0x30, 0x0d, 0x0a];
const OP = { footer: 2, channel: 4, message: 5, chunk: 6, messageIndex: 7, chunkIndex: 8 } as const;
const FOOTER_SIZE = 1 + 8 + 20 + 8; // with the magic behind it
const CHUNK_HEAD = 1 + 8 + 8 + 8 + 8 + 4 + 4; // its compression's name is empty
const CACHED = 400; // indices
const KEPT = 24; // whole chunks
const SMALL = 4 << 20; // bytes of a chunk that is read as a whole

interface Chunk {
  offset: number; // of the record
  start_s: number;
  end_s: number;
  data: number; // where its records begin in the file
  index: Map<number, number>; // channel: offset of its message index
  size: number; // of the record with its message indices behind it
}

class Cursor {
  private readonly view: DataView;
  at = 0;

  constructor(readonly bytes: Uint8Array) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }
  get left(): number {
    return this.bytes.byteLength - this.at;
  }
  u8(): number {
    return this.view.getUint8(this.at++);
  }
  u16(): number {
    this.at += 2;
    return this.view.getUint16(this.at - 2, true);
  }
  u32(): number {
    this.at += 4;
    return this.view.getUint32(this.at - 4, true);
  }
  u64(): number {
    this.at += 8;
    return Number(this.view.getBigUint64(this.at - 8, true));
  }
  text(): string {
    const size = this.u32();
    this.at += size;
    return new TextDecoder().decode(this.bytes.subarray(this.at - size, this.at));
  }
  skip(size: number): void {
    this.at += size;
  }
  part(size: number): Cursor {
    this.at += size;
    return new Cursor(this.bytes.subarray(this.at - size, this.at));
  }
}

/** The last index whose time is not after t; -1: none. */
export function lastNotAfter(times: ArrayLike<number>, t: number): number {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

interface Index {
  times: Float64Array;
  offsets: Float64Array;
}

export class Recording {
  start_s = Infinity;
  end_s = 0;
  readonly channels = new Map<number, { topic: string; encoding: string }>();
  private chunks: Chunk[] = [];
  private readonly indices = new Map<string, Promise<Index>>();
  private readonly kept = new Map<number, Promise<Uint8Array>>();

  private constructor(private readonly file: Blob) {}

  static async open(file: Blob): Promise<Recording> {
    const r = new Recording(file);
    await r.readSummary();
    return r;
  }

  private async slice(from: number, to: number, chunk?: Chunk): Promise<Cursor> {
    if (chunk && chunk.size <= SMALL) {
      const bytes = await this.whole(chunk);
      return new Cursor(bytes.subarray(from - chunk.offset, to - chunk.offset));
    }
    return new Cursor(new Uint8Array(await this.file.slice(from, to).arrayBuffer()));
  }

  /** Most of what a seek asks for stands in one chunk: it is read at once, and kept for the next. */
  private whole(chunk: Chunk): Promise<Uint8Array> {
    let bytes = this.kept.get(chunk.offset);
    if (!bytes) {
      if (this.kept.size >= KEPT) this.kept.delete(this.kept.keys().next().value!);
      bytes = this.file.slice(chunk.offset, chunk.offset + chunk.size).arrayBuffer().then((b) => new Uint8Array(b));
      this.kept.set(chunk.offset, bytes);
    }
    return bytes;
  }

  private async readSummary(): Promise<void> {
    const size = this.file.size;
    const head = await this.slice(0, MAGIC.length);
    if (size < 2 * MAGIC.length + FOOTER_SIZE || MAGIC.some((b, i) => head.bytes[i] !== b)) throw new Error('this is no MCAP recording');
    const footer = await this.slice(size - FOOTER_SIZE, size);
    if (footer.u8() !== OP.footer || MAGIC.some((b, i) => footer.bytes[FOOTER_SIZE - 8 + i] !== b))
      throw new Error('it has no end: it was cut off (a recording is whole when its program has ended)');
    footer.skip(8);
    const summary = footer.u64();
    if (summary === 0) throw new Error('it has no index');
    const c = await this.slice(summary, size - FOOTER_SIZE);
    while (c.left >= 9) {
      const op = c.u8();
      const record = c.part(c.u64());
      if (op === OP.channel) this.addChannel(record);
      else if (op === OP.chunkIndex) this.addChunk(record);
    }
    if (this.chunks.length === 0) throw new Error('it holds no messages');
  }

  private addChannel(c: Cursor): void {
    const id = c.u16();
    c.skip(2);
    const topic = c.text();
    this.channels.set(id, { topic, encoding: c.text() });
  }

  private addChunk(c: Cursor): void {
    const start_s = c.u64() * 1e-9;
    const end_s = c.u64() * 1e-9;
    const offset = c.u64();
    const length = c.u64();
    const map = c.part(c.u32());
    const index = new Map<number, number>();
    while (map.left >= 10) index.set(map.u16(), map.u64());
    const size = length + c.u64();
    const compression = c.text();
    if (compression !== '') throw new Error(`its chunks are compressed (${compression}): write it without (mcap compress --compression none)`);
    this.chunks.push({ offset, start_s, end_s, data: offset + CHUNK_HEAD + 8, index, size });
    if (index.size === 0) return;
    this.start_s = Math.min(this.start_s, start_s);
    this.end_s = Math.max(this.end_s, end_s);
  }

  private index(chunk: Chunk, channel: number): Promise<Index> {
    const key = `${chunk.offset} ${channel}`;
    let found = this.indices.get(key);
    if (!found) {
      if (this.indices.size > CACHED) this.indices.delete(this.indices.keys().next().value!);
      this.indices.set(key, (found = this.readIndex(chunk, chunk.index.get(channel)!)));
    }
    return found;
  }

  private async readIndex(chunk: Chunk, offset: number): Promise<Index> {
    const head = await this.slice(offset, offset + 15, chunk);
    if (head.u8() !== OP.messageIndex) throw new Error('an index is damaged');
    head.skip(8 + 2);
    const size = head.u32();
    const c = await this.slice(offset + 15, offset + 15 + size, chunk);
    const rows: [number, number][] = [];
    while (c.left >= 16) rows.push([c.u64() * 1e-9, c.u64()]);
    rows.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    return { times: Float64Array.from(rows, (r) => r[0]), offsets: Float64Array.from(rows, (r) => r[1]) };
  }

  /** The newest message of that channel at time t. `key` tells whether it is another than before. */
  async at(channel: number, t: number): Promise<{ key: string; time_s: number; read: () => Promise<unknown> } | null> {
    for (let i = this.chunks.length - 1; i >= 0; i--) {
      const chunk = this.chunks[i];
      if (chunk.start_s > t || !chunk.index.has(channel)) continue;
      const { times, offsets } = await this.index(chunk, channel);
      const k = lastNotAfter(times, t);
      if (k < 0) continue;
      return { key: `${chunk.offset} ${offsets[k]}`, time_s: times[k], read: () => this.message(chunk, chunk.data + offsets[k]) };
    }
    return null;
  }

  private async message(chunk: Chunk, offset: number): Promise<unknown> {
    const head = await this.slice(offset, offset + 9, chunk);
    if (head.u8() !== OP.message) throw new Error('a message is damaged');
    const size = head.u64();
    const c = await this.slice(offset + 9 + 22, offset + 9 + size, chunk); // behind channel, sequence, times
    return JSON.parse(new TextDecoder().decode(c.bytes));
  }
}

/** A recording as a feed: what held at the time that was sought. */
export class Player implements Feed {
  time_s: number;
  /** Of the slowest seek, ms. */
  slowest_ms = 0;
  private readonly takers = new Map<string, Set<(message: unknown, time_s: number) => void>>();
  private readonly shown = new Map<number, string>();
  private wanted: number | null = null;
  private busy = false;
  onTime: () => void = () => undefined;

  constructor(readonly recording: Recording) {
    this.time_s = recording.start_s;
  }

  topics(): string[] {
    return [...this.recording.channels.values()].map((c) => c.topic);
  }

  on<T>(topic: string, take: (message: T, time_s: number) => void): () => void {
    let set = this.takers.get(topic);
    if (!set) this.takers.set(topic, (set = new Set()));
    set.add(take as (message: unknown, time_s: number) => void);
    return () => set.delete(take as (message: unknown, time_s: number) => void);
  }

  /** The last one that was asked for is gone to; those in between are left out. */
  async seek(t: number): Promise<void> {
    this.wanted = t;
    if (this.busy) return;
    this.busy = true;
    while (this.wanted !== null) {
      const to = this.wanted;
      this.wanted = null;
      const begun = performance.now();
      await this.show(to);
      this.slowest_ms = Math.max(this.slowest_ms, performance.now() - begun);
    }
    this.busy = false;
  }

  private async show(t: number): Promise<void> {
    const jobs = [...this.recording.channels].map(async ([id, { topic, encoding }]) => {
      const set = this.takers.get(topic);
      if (!set?.size || encoding !== 'json') return;
      const found = await this.recording.at(id, t);
      if (!found || this.shown.get(id) === found.key) return;
      const message = await found.read();
      this.shown.set(id, found.key);
      for (const take of set) take(message, found.time_s);
    });
    await Promise.all(jobs);
    this.time_s = t;
    this.onTime();
  }
}
