"""Recordings are what others read: every record, sum, index and JSON message of an MCAP of ours against the format's
description, by a parser of its own (struct, zlib, json); and by Foxglove's own reader (npm's @mcap/core, when
TELEDIMOS_NODE_MODULES or NODE_PATH names a folder that holds it), which also writes a file for ours to read. The
schemas against Foxglove's (npm's @foxglove/schemas, when it is there). Blind to: how Foxglove draws them.
"""

import base64
import json
import os
import shutil
import struct
import subprocess
import tempfile
import zlib

from common import SOURCE, check, finish, schema_fault, skip

RECORD = os.path.join(os.environ["TELEDIMOS_TESTS"], "record_machine")
URDF = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, SUMMARY_OFFSET, DATA_END = 11, 14, 15


class Fields:
    """The fields of a record, one after another."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, code):
        value, = struct.unpack_from("<" + code, self.data, self.at)
        self.at += struct.calcsize("<" + code)
        return value

    def bytes(self, code="I"):
        size = self.take(code)
        part = self.data[self.at:self.at + size]
        assert len(part) == size
        self.at += size
        return part

    def text(self):
        return self.bytes().decode()

    def map(self, key, value):
        inner, found = Fields(self.bytes()), {}
        while inner.at < len(inner.data):
            k = inner.take(key)
            assert k not in found
            found[k] = inner.take(value)
        return found

    def pairs(self):
        inner, found = Fields(self.bytes()), []
        while inner.at < len(inner.data):
            found.append((inner.take("Q"), inner.take("Q")))
        return found

    def rest(self):
        part = self.data[self.at:]
        self.at = len(self.data)
        return part

    def done(self):
        assert self.at == len(self.data), "bytes behind the last field"


def records(data, start, end):
    """(kind, place, length with its head, content)"""
    at = start
    while at < end:
        kind, size = struct.unpack_from("<BQ", data, at)
        assert at + 9 + size <= end, "a record is longer than its place"
        yield kind, at, 9 + size, data[at + 9:at + 9 + size]
        at += 9 + size


def schema_of(content):
    f = Fields(content)
    found = f.take("H"), (f.text(), f.text(), f.bytes())
    f.done()
    return found


def channel_of(content):
    f = Fields(content)
    found = f.take("H"), (f.take("H"), f.text(), f.text())
    assert f.bytes() == b""
    f.done()
    return found


def message_of(content):
    f = Fields(content)
    return f.take("H"), f.take("I"), f.take("Q"), f.take("Q"), f.rest()


class Recording:
    """Everything of a file, checked against everything else."""

    def __init__(self, data):
        self.data = data
        self.schemas, self.channels, self.messages, self.chunks = {}, {}, [], []
        assert data[:8] == MAGIC and data[-8:] == MAGIC, "magic"
        self.end = self.footer()
        self.data_section()
        self.summary()

    def footer(self):
        at = len(self.data) - 8 - 29
        kind, size = struct.unpack_from("<BQ", self.data, at)
        assert (kind, size) == (FOOTER, 20), "footer"
        self.summary_at, self.offsets_at, total = struct.unpack_from("<QQI", self.data, at + 9)
        assert zlib.crc32(self.data[self.summary_at:at + 25]) == total, "sum of the summary"
        return at

    def data_section(self):
        expected = None  # the lists of messages that must follow a chunk
        kinds = []
        for kind, at, length, content in records(self.data, 8, self.summary_at):
            kinds.append(kind)
            if kind == MESSAGE_INDEX:
                f = Fields(content)
                channel, pairs = f.take("H"), f.pairs()
                f.done()
                assert sorted(expected.pop(channel)) == sorted(pairs), "list of messages"
                self.chunks[-1]["map"][channel] = at
                self.chunks[-1]["map_length"] += length
                continue
            assert not expected, "messages of a chunk that are not listed"
            if kind == CHUNK:
                expected = self.chunk(at, length, content)
            if kind == DATA_END:
                total, = struct.unpack("<I", content)
                assert zlib.crc32(self.data[:at]) == total, "sum of the data"
        assert kinds[0] == HEADER and kinds[-1] == DATA_END and kinds.count(DATA_END) == 1, "order of records"
        assert set(kinds) <= {HEADER, CHUNK, MESSAGE_INDEX, DATA_END}

    def chunk(self, at, length, content):
        f = Fields(content)
        start, end, size, total = f.take("Q"), f.take("Q"), f.take("Q"), f.take("I")
        assert f.text() == "", "compression"
        inner = f.bytes("Q")
        f.done()
        assert size == len(inner) and zlib.crc32(inner) == total, "sum of a chunk"
        listed, times = {}, []
        for kind, place, _, record in records(inner, 0, len(inner)):
            if kind == SCHEMA:
                number, schema = schema_of(record)
                assert self.schemas.setdefault(number, schema) == schema
            elif kind == CHANNEL:
                number, channel = channel_of(record)
                assert channel[0] in self.schemas and self.channels.setdefault(number, channel) == channel
            else:
                assert kind == MESSAGE
                number, sequence, log, publish, data = message_of(record)
                assert number in self.channels and publish == log
                listed.setdefault(number, []).append((log, place))
                times.append(log)
                self.messages.append((self.channels[number][1], log, sequence, data))
        assert (start, end) == ((min(times), max(times)) if times else (0, 0)), "times of a chunk"
        self.chunks.append(dict(start=start, end=end, at=at, length=length, size=size, map={}, map_length=0))
        return listed

    def summary(self):
        schemas, channels, chunks, groups = {}, {}, [], {}
        for kind, at, length, content in records(self.data, self.summary_at, self.offsets_at):
            groups.setdefault(kind, [at, 0])
            assert groups[kind][0] + groups[kind][1] == at, "records of one kind stand together"
            groups[kind][1] += length
            f = Fields(content)
            if kind == SCHEMA:
                schemas.update([schema_of(content)])
            elif kind == CHANNEL:
                channels.update([channel_of(content)])
            elif kind == CHUNK_INDEX:
                one = dict(zip(("start", "end", "at", "length"), (f.take("Q") for _ in range(4))))
                one["map"], one["map_length"] = f.map("H", "Q"), f.take("Q")
                assert f.text() == ""
                one["size"] = f.take("Q")
                assert f.take("Q") == one["size"]
                f.done()
                chunks.append(one)
            else:
                assert kind == STATISTICS
                self.statistics(f)
        assert (schemas, channels, chunks) == (self.schemas, self.channels, self.chunks), "summary"
        offsets = {}
        for kind, _, _, content in records(self.data, self.offsets_at, self.end):
            assert kind == SUMMARY_OFFSET
            group, start, length = struct.unpack("<BQQ", content)
            offsets[group] = [start, length]
        assert offsets == groups, "offsets of the summary"

    def statistics(self, f):
        counts = [f.take(code) for code in "QHIIII"]
        times = [m[1] for m in self.messages]
        assert counts == [len(times), len(self.schemas), len(self.channels), 0, 0, len(self.chunks)], "counts"
        assert [f.take("Q"), f.take("Q")] == [min(times), max(times)], "times"
        by_topic = [m[0] for m in self.messages]
        assert f.map("H", "Q") == {k: by_topic.count(c[1]) for k, c in self.channels.items()}, "counts of channels"
        f.done()


def check_messages(recording):
    by_topic = {c[1]: recording.schemas[c[0]] for c in recording.channels.values()}
    faults, seen = [], {}
    for topic, log, _, data in recording.messages:
        name, encoding, text = by_topic[topic]
        value = json.loads(data)
        seen.setdefault(topic, []).append(value)
        schema = json.loads(text)
        if encoding != "jsonschema" or schema["title"] != name:
            faults.append(f"{topic}: schema {name}")
        faults.append(schema_fault(value, schema, topic))
        stamp = value.get("timestamp") or (value.get("transforms") or value.get("entities"))[0]["timestamp"]
        if stamp["sec"] * 10**9 + stamp["nsec"] != log:
            faults.append(f"{topic}: its time is not that of the recording")
    check(not any(faults), "every message is of its schema, its time that of the record " + str([f for f in faults if f][:3]))
    check({t: len(v) for t, v in seen.items()} == {"/tf": 100, "/pose": 100, "/log": 100, "/joints": 100, "/machine": 1,
                                                  "/map": 1, "/cloud": 1, "/image": 1}, "as many messages as were written")
    grid = seen["/map"][0]
    cells = list(struct.iter_unpack("<ffB", base64.b64decode(grid["data"])))
    check(grid["column_count"] == 6 and grid["row_stride"] == 54 and cells[8][0] == 0.25 and cells[7][0] != cells[7][0] and len(cells) == 30
          and grid["pose"]["position"] == {"x": 2.75, "y": -2.25, "z": 0}, "the map's cells, its unknown one, its corner")
    cloud = seen["/cloud"][0]
    point = struct.unpack_from("<4f4B", base64.b64decode(cloud["data"]), 3 * cloud["point_stride"])
    check(cloud["pose"]["position"]["x"] == 100 and point[:3] == (3, 1.5, -3) and point[4:] == (255, 128, 0, 255),
          "the cloud's last point from the first, its colour")
    check(base64.b64decode(seen["/image"][0]["data"])[1:4] == b"PNG", "the image is a PNG")
    check(seen["/log"][3]["message"] == 'frame 3: "böse" \\ text\n' and seen["/log"][3]["level"] == 3, "text as it was")
    frames = {t["child_frame_id"]: t["parent_frame_id"] for t in seen["/tf"][0]["transforms"]}
    check(frames == {"undercarriage": "site", "upper": "undercarriage", "boom": "upper", "arm": "boom", "bucket": "arm",
                     "bucket_tip": "bucket"}, "the frames are a tree from the ground to the bucket's tip")


def listed(path):
    done = subprocess.run([RECORD, "list", path], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


READ = """
const fs = require("fs");
const { McapIndexedReader, McapStreamReader, McapWriter } = require("@mcap/core");
class Source {
  constructor(path) { this.bytes = fs.readFileSync(path); }
  async size() { return BigInt(this.bytes.length); }
  async read(at, size) { return this.bytes.subarray(Number(at), Number(at + size)); }
}
class Sink {
  constructor(path) { this.file = fs.openSync(path, "w"); this.at = 0n; }
  position() { return this.at; }
  async write(bytes) { fs.writeSync(this.file, bytes); this.at += BigInt(bytes.length); }
}
const line = (topic, m) => `${topic} ${m.logTime} ${m.sequence} ${Buffer.from(m.data).toString("hex")}`;
async function main() {
  const [from, to] = process.argv.slice(2);
  const reader = await McapIndexedReader.Initialize({ readable: new Source(from) });
  for await (const m of reader.readMessages({ validateCrcs: true }))
    console.log(line(reader.channelsById.get(m.channelId).topic, m));
  const stream = new McapStreamReader({ validateCrcs: true });
  stream.append(fs.readFileSync(from));
  let count = 0;
  for (let r; (r = stream.nextRecord()); ) if (r.type === "Message") count++;
  console.log(`stream ${count} ${stream.done()}`);
  const writer = new McapWriter({ writable: new Sink(to), chunkSize: 2000 });
  await writer.start({ profile: "", library: "theirs" });
  const ids = new Map();
  for (const c of reader.channelsById.values()) {
    const s = reader.schemasById.get(c.schemaId);
    const schemaId = await writer.registerSchema({ name: s.name, encoding: s.encoding, data: s.data });
    ids.set(c.id, await writer.registerChannel({ topic: c.topic, schemaId, messageEncoding: c.messageEncoding, metadata: new Map([["a", "b"]]) }));
  }
  for await (const m of reader.readMessages())
    await writer.addMessage({ channelId: ids.get(m.channelId), sequence: m.sequence, logTime: m.logTime, publishTime: m.publishTime, data: m.data });
  await writer.end();
}
main().catch((e) => { console.error(String(e)); process.exit(1); });
"""

COMPARE = """
const theirs = require("@foxglove/schemas/jsonschema");
const faults = [];
function compare(path, a, b) {
  for (const key of ["type", "title", "contentEncoding", "minimum", "maximum"])
    if (a[key] !== b[key]) faults.push(`${path}: ${key} ${a[key]} against ${b[key]}`);
  const list = (x) => JSON.stringify((x.oneOf ?? []).map((o) => [o.title, o.const]));
  if (list(a) !== list(b)) faults.push(`${path}: choices`);
  const sorted = (x) => JSON.stringify([...(x ?? [])].sort());
  if (b.required && sorted(a.required) !== sorted(b.required)) faults.push(`${path}: required`);
  const names = new Set([...Object.keys(a.properties ?? {}), ...Object.keys(b.properties ?? {})]);
  for (const n of names)
    if (!a.properties?.[n] || !b.properties?.[n]) faults.push(`${path}.${n} is missing`);
    else compare(`${path}.${n}`, a.properties[n], b.properties[n]);
  if (!a.items !== !b.items) faults.push(`${path}: items`);
  else if (a.items) compare(`${path}[]`, a.items, b.items);
}
const ours = JSON.parse(require("fs").readFileSync(process.argv[2]));
for (const [name, schema] of Object.entries(ours)) compare(name, schema, theirs[name.replace("foxglove.", "")] ?? {});
console.log(JSON.stringify(faults));
"""


def node(folder, script, *arguments):
    """Exit status, output, errors of a script of ours; None when node or what it requires is not there."""
    modules = os.environ.get("TELEDIMOS_NODE_MODULES") or os.environ.get("NODE_PATH") or ""
    program, package = shutil.which("node"), "@mcap/core" if script is READ else "@foxglove/schemas"
    if not program or not any(os.path.isdir(os.path.join(m, package)) for m in modules.split(":") if m):
        return None
    path = os.path.join(folder, "script.js")
    with open(path, "w") as f:
        f.write(script)
    done = subprocess.run([program, path, *arguments], capture_output=True, text=True, timeout=60,
                          env=dict(os.environ, NODE_PATH=modules))
    return done.returncode, done.stdout, done.stderr


def check_others(folder, path, recording, ours):
    theirs = os.path.join(folder, "theirs.mcap")
    done = node(folder, READ, path, theirs)
    if done is None:
        skip("Foxglove's reader: no @mcap/core in TELEDIMOS_NODE_MODULES (npm i @mcap/core)")
    else:
        code, output, errors = done
        *lines, stream = output.splitlines() or [""]
        check(code == 0 and "\n".join(lines) + "\n" == ours, "Foxglove's reader gives the same messages " + errors[:200])
        check(stream == f"stream {len(recording.messages)} true", f"and reads it as a stream: {stream}")
        code, again, errors = listed(theirs)
        check(code == 0 and again == ours, "ours gives the messages of a file that Foxglove's wrote " + errors)
    schemas = os.path.join(folder, "schemas.json")
    with open(schemas, "w") as f:
        json.dump({s[0]: json.loads(s[2]) for s in recording.schemas.values() if s[0].startswith("foxglove.")}, f)
    done = node(folder, COMPARE, schemas)
    if done is None:
        skip("Foxglove's schemas: no @foxglove/schemas in TELEDIMOS_NODE_MODULES (npm i @foxglove/schemas)")
    else:
        check(done[0] == 0 and json.loads(done[1] or "0") == [], "schemas are Foxglove's " + done[1][:400] + done[2][:400])


def main():
    with tempfile.TemporaryDirectory() as folder:
        data = []
        for name in ("1.mcap", "2.mcap"):
            path = os.path.join(folder, name)
            done = subprocess.run([RECORD, "write", path, URDF], capture_output=True, text=True)
            check(done.returncode == 0, "a recording is written " + done.stderr)
            with open(path, "rb") as f:
                data.append(f.read())
        check(data[0] == data[1], "twice the same bytes")
        try:
            recording = Recording(data[0])
            check(True, f"records, sums, indices of {len(data[0])} bytes, {len(recording.chunks)} chunks agree")
        except (AssertionError, struct.error, UnicodeDecodeError) as e:
            check(False, f"records, sums, indices agree: {e!r}")
            finish()
        check(len(recording.chunks) > 5, "several chunks")
        check_messages(recording)
        code, ours, errors = listed(path)
        expected = "".join(f"{t} {log} {n} {d.hex()}\n" for t, log, n, d in recording.messages)
        check(code == 0 and ours == expected, "our reader gives the messages of the independent one " + errors)
        check_others(folder, path, recording, ours)
    finish()


main()
