"""teledimos machine: the simulated machine as a process of its own, and its master.

A validated task is executed, its end where it was predicted; the same task with one byte changed is refused. With two network
namespaces and a wire of packets between them (TLS, a certificate made here): the link is cut, delayed by 500 ms, loses 5 % of
its packets, goes half-open (the master hears and does not answer): the stop is commanded within the timeout and one period of
the heartbeat (0.3 + 0.1 s) of what was done to the wire, by the machine's own record on the same clock (and what other processes kept the
machine from looking, which it records too); its time and angle are
told; motion again only after Reinit. Whoever has no token, a wrong one, another version, who comes second, says again what was
said before, sends what is too large, malformed or too slow is refused and recorded, and the machine goes on; as it does where it
finds no room for the process that would check a task. A task that follows at once upon the last one is judged like any other.

Reference: the wire format of core/link.h and core/machine_messages.h, spoken here a second time with Python's hmac. The clock
is CLOCK_MONOTONIC, which all processes share. Tolerances: joints 0.01 rad, as the machine itself allows a master.
Blind to: networks that reorder; many hours."""

import ctypes
import fcntl
import hashlib
import heapq
import hmac
import json
import math
import os
import random
import resource
import select
import shutil
import signal
import socket
import ssl
import struct
import subprocess
import tempfile
import threading
import time
import traceback

import numpy

from common import PROGRAM, SANITIZED, SOURCE, check, finish, run, skip

try:
    from osgeo import gdal
    gdal.UseExceptions()
except ImportError:
    skip("the readers of GDAL are not installed (python3-gdal)")
    finish()

ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
PERIOD = 1.0 if SANITIZED else 0.1  # of the heartbeat
TIMEOUT = 3 * PERIOD
PATIENCE = 6 if SANITIZED else 1
WELCOME, TASK, ORDER, JOINTS, ANSWER, STATE, STOPPED, IMAGE = range(1, 9)
EXECUTE, STOP, PAUSE, RESUME, REINIT, MANUAL, AUTOMATIC = range(7)
REST, CHECKING, HOLDING, WORKING, PAUSED, IN_MANUAL, FAILED = range(7)
PING, PONG, FAREWELL = 255, 254, 253
folder = tempfile.mkdtemp()
# As a machine in time runs, where that is allowed: others may be busy here.
URGENT = ("chrt", "-f", "10")
if not shutil.which("chrt") or subprocess.run([*URGENT, "true"], capture_output=True).returncode != 0:
    URGENT = ()


# ---- scenarios ----


def write(name, text):
    path = os.path.join(folder, name)
    with open(path, "w") as file:
        file.write(text)
    return path


def write_map(name):
    cell, side, origin = 0.1, 200, (-10.0, -10.0)
    file = gdal.GetDriverByName("GTiff").Create(os.path.join(folder, name), side, side, 1, gdal.GDT_Float32)
    file.SetGeoTransform([origin[0] - cell / 2, cell, 0, origin[1] + (side - 0.5) * cell, 0, -cell])
    file.GetRasterBand(1).SetNoDataValue(math.nan)
    file.GetRasterBand(1).WriteArray(numpy.zeros((side, side), numpy.float32))


def scenario(name, steps, speed=1.0):
    write(f"{name}-task.yaml", f"teledimos: task 1\nname: {name}\nlimits: {{joint_speed_share: {speed}}}\nsteps:\n{steps}")
    return write(f"{name}.yaml", f"teledimos: scenario 1\nname: {name}\nrobot: {ROBOT}\n"
                 "start: {joints: {swing: 0, boom: -0.9, arm: 1.3, bucket: 0.6}}\nduration_s: 90\nlog_s: 0.1\n"
                 f"ground: {{map: flat.tif, sigma_m: 0.02}}\ntask: {name}-task.yaml\n")


# ---- the machine as a process ----


class Machine:
    def __init__(self, name, *arguments, before=(), address="127.0.0.1:0"):
        self.out = os.path.join(folder, name)
        self.process = subprocess.Popen([*before, *URGENT, PROGRAM, "machine", NEAR, "--listen", address, "--token-file", TOKEN, "-o",
                                         self.out, "--period", str(PERIOD), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.port = int(line.split()[-1]) if line.startswith("listening") else 0

    def record(self):
        with open(os.path.join(self.out, "audit.jsonl")) as file:
            return [json.loads(line) for line in file if line.endswith("\n")]

    def lines(self, what, words="", since=0.0):
        return [line for line in self.record() if line["what"] == what and words in line["text"] and line["clock_s"] >= since]

    def await_line(self, what, words="", since=0.0, seconds=60):
        until = time.monotonic() + seconds * PATIENCE
        while time.monotonic() < until:
            found = self.lines(what, words, since)
            if found:
                return found[0]
            time.sleep(0.02)
        return None

    def end(self, name):
        self.process.send_signal(signal.SIGTERM)
        try:
            _, errors = self.process.communicate(timeout=10 * PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            errors = "it hung"
        check(self.process.returncode == 0 and not errors, f"{name}: SIGTERM ends it cleanly {self.process.returncode} {errors[-600:]}")
        check(self.record()[-1]["what"] == "end", f"{name}: its end is recorded")
        numbers = [line["line"] for line in self.record()]
        check(numbers == list(range(1, len(numbers) + 1)), f"{name}: its record is numbered throughout")


def master(verb, *arguments, to, before=(), wait=True):
    words = [*before, PROGRAM, "machine", verb, *map(str, arguments), "--connect", to, "--token-file", TOKEN, "--period", str(PERIOD), "--json"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    return told(process) if wait else process


def told(process, seconds=60):
    try:
        text, errors = process.communicate(timeout=seconds * PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        return None, {}, "it hung"
    return process.returncode, json.loads(text) if text.strip() else {}, errors


# ---- the link, a second time ----


def mac(key, *parts):
    return hmac.new(key, b"".join(parts), hashlib.sha256).digest()


class Closed(Exception):
    pass


class Link:
    """A client after the header of core/link.h."""

    def __init__(self, port, token, channel=0, session=bytes(16), version=1):
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.token, self.data, self.frames, self.sent, self.answers = token, b"", [], 0, True
        self.hello = b"TDLK" + struct.pack(">HBB", version, 0, channel) + session + os.urandom(32)

    def read(self, size, seconds=3):
        until = time.monotonic() + seconds * PATIENCE
        while len(self.data) < size:
            if not select.select([self.socket], [], [], max(0, until - time.monotonic()))[0]:
                raise Closed("silence")
            try:
                more = self.socket.recv(65536)
            except OSError:
                more = b""
            if not more:
                raise Closed("closed")
            self.data += more
        taken, self.data = self.data[:size], self.data[size:]
        return taken

    def open(self):
        self.socket.sendall(self.hello)
        theirs = self.read(56)
        self.transcript = self.hello + theirs + bytes(32)
        self.socket.sendall(mac(self.token, b"teledimos client proof", self.transcript))
        proof = self.read(32)
        if proof != mac(self.token, b"teledimos server proof", self.transcript):
            raise Closed("the machine does not hold the token")
        self.keys = [mac(self.token, side, self.transcript) for side in (b"teledimos client frames", b"teledimos server frames")]
        return self

    def frame(self, kind, payload=b""):
        head = struct.pack(">IBBQ", len(payload), 1, kind, self.sent) + payload
        self.sent += 1
        return head + mac(self.keys[0], head)[:16]

    def send(self, kind, payload=b""):
        try:
            self.socket.sendall(self.frame(kind, payload))
        except OSError:
            raise Closed("closed") from None

    def next(self, seconds=3):
        """The next frame that is no heartbeat."""
        until = time.monotonic() + seconds
        while True:
            head = self.read(14, max(0.001, until - time.monotonic()))
            size, _, kind, _ = struct.unpack(">IBBQ", head)
            rest = self.read(size + 16)
            if mac(self.keys[1], head, rest[:size])[:16] != rest[size:]:
                raise Closed("a frame's tag is wrong")
            if kind == PING and self.answers:
                self.send(PONG, rest[:size])
            elif kind < 200:
                return kind, rest[:size]

    def expect(self, kind, seconds=3, where=lambda payload: True):
        until = time.monotonic() + seconds
        while True:
            came, payload = self.next(max(0.001, until - time.monotonic()))
            if came == kind and where(payload):
                return payload

    def mode(self, mode, seconds=3):
        return self.expect(STATE, seconds, lambda payload: payload[8] == mode)

    def order(self, order):
        """(accepted, text) of its answer."""
        self.send(ORDER, bytes([order]))
        return answer_of(self.expect(ANSWER))

    def is_closed(self, seconds=3):
        try:
            while True:
                self.next(seconds)
        except Closed as how:
            return str(how) == "closed"

    def farewell(self):
        self.send(FAREWELL)
        self.socket.close()


def answer_of(payload):
    size = struct.unpack(">H", payload[3:5])[0]
    return bool(payload[2]), payload[5:5 + size].decode()


class Relay:
    """Between a master and the machine on this computer: keeps what the master says."""

    def __init__(self, port):
        self.said = b""
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.serve, args=(port,), daemon=True).start()

    def serve(self, port):
        first = True
        while True:
            client = self.listener.accept()[0]
            server = socket.create_connection(("127.0.0.1", port))
            for source, target, keep in ((client, server, first), (server, client, False)):
                threading.Thread(target=self.pass_on, args=(source, target, keep), daemon=True).start()
            first = False

    def pass_on(self, source, target, keep):
        try:
            while data := source.recv(65536):
                if keep:
                    self.said += data
                target.sendall(data)
        except OSError:
            pass
        for end in (source, target):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def frames(self):
        """[(kind, payload)] that the master sent."""
        at, found = 56 + 32, []
        while at + 14 <= len(self.said):
            size, _, kind, _ = struct.unpack(">IBBQ", self.said[at:at + 14])
            found.append((kind, self.said[at + 14:at + 14 + size]))
            at += 14 + size + 16
        return found


# ---- on this computer: a task, its master, and who is none ----


def refuse_strangers(machine):
    """While another one commands and the machine works."""
    since = time.monotonic()

    def stranger(name, words, act):
        before = len(machine.lines("refused", words, since))
        try:
            act()
        except Closed:
            pass
        until = time.monotonic() + 4 * PATIENCE
        while len(machine.lines("refused", words, since)) == before and time.monotonic() < until:
            time.sleep(0.02)
        check(len(machine.lines("refused", words, since)) > before, f"{name}: refused and recorded ('{words}')")

    def garbage():
        with socket.create_connection(("127.0.0.1", machine.port)) as end:
            end.sendall(random.Random(1).randbytes(5000))
            check(end.recv(10) == b"" if select.select([end], [], [], 2)[0] else False, "garbage: the connection is closed")

    def half_a_hello():
        with socket.create_connection(("127.0.0.1", machine.port)) as end:
            end.sendall(b"TDLK\x00\x01")
            time.sleep(max(2, 2 * TIMEOUT) + 0.4)

    def wrong_token():
        link = Link(machine.port, b"x" * 32)
        try:
            link.open()
            check(False, "a wrong token opens no link")
        except Closed as how:
            check(str(how) == "closed", f"a wrong token: {how}")
            check(link.data == b"", "a wrong token: the machine gives no proof of its own")

    def other_version():
        link = Link(machine.port, KEY, version=7)
        link.socket.sendall(link.hello)
        check(link.read(56)[4:6] == b"\0\1", "another version: the machine says its own")
        link.read(1)

    def second():
        link = Link(machine.port, KEY).open()
        check(link.expect(WELCOME)[18] == 0, "a second operator: told that he does not command")
        accepted, text = answer_of(link.expect(ANSWER))
        check(not accepted and "another operator" in text, f"a second operator: {text}")
        check(link.is_closed(), "a second operator: closed")

    def pictures():
        check(Link(machine.port, KEY, channel=1, session=os.urandom(16)).open().is_closed(), "images of no session: closed")

    def replayed():
        with socket.create_connection(("127.0.0.1", machine.port)) as end:
            end.sendall(machine.relay.said)
            time.sleep(0.3)

    late = threading.Thread(target=stranger, args=("a hello that does not end", "too slow", half_a_hello))
    late.start()
    stranger("garbage", "no hello of this protocol", garbage)
    stranger("a wrong token", "does not hold the token", wrong_token)
    stranger("another version", "speaks version 7", other_version)
    stranger("a second operator", "a second operator", second)
    stranger("images without a session", "no session under way", pictures)
    stranger("a session said again", "does not hold the token", replayed)
    late.join()
    doors = [socket.create_connection(("127.0.0.1", machine.port)) for _ in range(12)]
    check(machine.await_line("refused", "others are at the door", since) is not None, "many at the door: the last are sent away")
    for door in doors:
        door.close()


def first_task(machine):
    """A task from its simulation to its end; who is not asked, meanwhile."""
    machine.relay = Relay(machine.port)
    images = os.path.join(folder, "images")
    process = master("run", NEAR, "--images", images, to=f"127.0.0.1:{machine.relay.port}", wait=False)
    check(machine.await_line("execute") is not None, "the task is executed")
    refuse_strangers(machine)
    status, result, errors = told(process)
    task = result.get("task", {})
    joints = {name: joint["position"] for name, joint in result.get("machine", {}).get("joints", {}).items()}
    check(status == 0 and not errors, f"run: done {status} {errors}")
    check(abs(joints.get("swing", 9) - math.radians(12)) < 0.01 and abs(joints.get("boom", 9) + math.radians(50)) < 0.01,
          f"run: the joints are where the task wants them {joints}")
    check(task.get("largest_joint_error", 9) < 0.01, f"run: and where they were predicted {task}")
    link = result.get("link", {})
    check(link.get("pings", 0) > 5 / PERIOD and 0 < link.get("round_trip_mean_s", 0) < 0.1, f"run: the link is measured {link}")
    pictures = os.listdir(images)
    check((pictures or SANITIZED) and all(open(os.path.join(images, name), "rb").read(2) == b"\xff\xd8" for name in pictures),
          f"run: {len(pictures)} images came")
    held = machine.lines("accepted", "held: simulated here")
    check(len(held) == 1 and machine.lines("phase", "executed"), "the machine checked it by its own simulator")
    print(f"        {task.get('predicted_s')} s simulated in {task.get('simulated_in_s', 0):.2f} s, joints off by "
          f"{task.get('largest_joint_error', 9):.1e}, round trip {1e3 * link.get('round_trip_mean_s', 0):.2f} ms, {len(pictures)} images")
    return [payload for kind, payload in machine.relay.frames() if kind == TASK][0]


def new_master(machine, reinit=False):
    link = Link(machine.port, KEY).open()
    welcome = link.expect(WELCOME)
    check(welcome[18] == 1, "a master is welcome")
    if reinit:
        accepted, text = link.order(REINIT)
        check(accepted, f"Reinit: {text}")
        link.mode(REST)
    return link


def try_tasks(machine, task):
    """The task that was validated, from the same place; and what is not quite it."""
    link = new_master(machine)

    def sent(name, payload, accepted, words):
        link.send(TASK, payload)
        ok, text = answer_of(link.expect(ANSWER, 20))
        check(ok == accepted and words in text, f"{name}: {text}")

    text = task.index(b"swing_deg: 12")
    sent("one byte of the task changed", task[:text + 11] + b"13" + task[text + 13:], False, "is not the one that was validated")
    sent("one byte of its hash", bytes([ord("0") + (task[0] == ord("0"))]) + task[1:], False, "is not the one that was validated")
    sent("another machine's", task[:64] + bytes([ord("0") + (task[64] == ord("0"))]) + task[65:], False, "on another machine")
    start, duration, end = 129, 129 + 4 * 8, 129 + 5 * 8

    def with_real(at, change):
        return task[:at] + struct.pack(">d", struct.unpack(">d", task[at:at + 8])[0] + change) + task[at + 8:]

    sent("from elsewhere", with_real(start, 0.02), False, "which stands at")
    sent("that takes longer", with_real(duration, 2.0), False, "validated to take")
    sent("that ends elsewhere", with_real(end + 8, 0.02), False, "validated to leave boom")
    sent("that pushes less", with_real(end + 4 * 8 + 8, -90e3), False, "validated to push boom")
    yaml = b"teledimos: task 1\nname: no task\nsteps: [\n"
    size = 129 + 13 * 8
    sent("what is no task", task[:size] + struct.pack(">I", len(yaml)) + yaml, False, "the task that came")
    accepted, words = link.order(EXECUTE)
    check(not accepted and "only a downloaded task" in words, f"nothing is executed: {words}")
    process, files = machine.process.pid, resource.RLIMIT_NOFILE
    before = resource.prlimit(process, files)
    used = {int(number) for number in os.listdir(f"/proc/{process}/fd")}
    resource.prlimit(process, files, (min(set(range(1024)) - used) + 1, before[1]))  # one more: a pipe needs two
    sent("where no process can be begun to check it", task, False, "a pipe: ")
    resource.prlimit(process, files, before)
    sent("as it was validated", task, True, "held")
    link.mode(HOLDING)
    for order, name, mode in ((EXECUTE, "execute", WORKING), (PAUSE, "pause", PAUSED), (RESUME, "resume", WORKING)):
        accepted, text = link.order(order)
        check(accepted, f"{name}: {text}")
        link.mode(mode)
        if order == PAUSE:
            until = time.monotonic() + 1.5
            while time.monotonic() < until:
                last = link.expect(STATE)
            check(last[8] == PAUSED and max(map(abs, rates_of(last))) < 2e-3, "paused: it stands, and waits")
    check(not link.order(EXECUTE)[0], "execute, while it works: refused")
    check(link.order(STOP)[0], "stop")
    took = struct.unpack(">d", link.expect(STOPPED)[16:24])[0]
    check(0 < took < 2, f"stop: it came to rest after {took:.2f} s")
    link.mode(REST)
    return link


def try_frames(machine, link, task):
    """A master whose words are wrong is lost, and the machine stands until Reinit."""
    def lost(name, words, what="lost"):
        since = time.monotonic() - 1.5
        check(link.is_closed(), f"{name}: closed")
        check(machine.await_line(what, words, since) is not None, f"{name}: recorded ('{words}')")

    frame = link.frame(ORDER, bytes([PAUSE]))
    link.socket.sendall(frame + frame)
    lost("a command said again", "it was sent again")
    link = new_master(machine)
    link.mode(FAILED)
    for order, name in ((EXECUTE, "execute"), (MANUAL, "manual")):
        accepted, text = link.order(order)
        check(not accepted and "Reinit first" in text, f"after a lost master {name}: {text}")
    link.send(TASK, task)
    check("Reinit first" in answer_of(link.expect(ANSWER))[1], "after a lost master no task is taken")
    link.farewell()
    link = new_master(machine)
    check(link.mode(FAILED)[8] == FAILED, "a farewell is no Reinit")
    check(link.order(REINIT)[0], "Reinit")
    link.mode(REST)
    link.socket.sendall(struct.pack(">IBBQ", 1 << 24, 1, TASK, link.sent))
    lost("a frame of 16 MB", "above the 262144 allowed")
    link = new_master(machine, reinit=True)
    link.send(TASK, task[:100])
    lost("half a task", "a task is refused: it ends too early", "refused")
    link = new_master(machine, reinit=True)
    link.send(ORDER, b"\x63")
    lost("an order that is none", "there is no such order", "refused")
    link = new_master(machine, reinit=True)
    link.send(STATE, b"")
    lost("what only a machine says", "state is refused", "refused")
    link = new_master(machine, reinit=True)
    whole = bytearray(link.frame(ORDER, bytes([STOP])))
    whole[-1] ^= 1
    link.socket.sendall(whole)
    lost("a changed frame", "tag is wrong")
    link = new_master(machine, reinit=True)
    link.socket.sendall(b"".join(link.frame(ORDER, bytes([STOP])) for _ in range(1500)))
    lost("a flood", "frames a second")
    link = new_master(machine, reinit=True)
    link.socket.sendall(link.frame(ORDER, bytes([STOP]))[:20])
    lost("a frame that does not end", "")
    link = new_master(machine, reinit=True)
    link.answers = False
    lost("a master that does not answer", "no answer for ")
    new_master(machine, reinit=True).farewell()


def try_jog(machine):
    """Joint by joint, through the plant; a hand that is taken away lets the machine stand."""
    status, result, errors = master("jog", NEAR, "--joint", "boom=0.1", "--for", "1", to=f"127.0.0.1:{machine.port}")
    moved = result.get("task", {}).get("moved", {})
    check(status == 0 and 0.05 < moved.get("boom", 0) < 0.12 and abs(moved.get("swing", 1)) < 0.01,
          f"jog: boom at 0.1 rad/s for 1 s {moved} {errors}")
    link = new_master(machine)
    check(link.order(MANUAL)[0], "manual")
    for _ in range(6):
        link.send(JOINTS, bytes([2, 4]) + struct.pack(">4d", 0, 0, 0.2, 0))
        link.expect(STATE)
    since = time.monotonic()
    rate = 1.0
    while abs(rate) > 2e-3 and time.monotonic() < since + 3:
        rate = rates_of(link.mode(IN_MANUAL))[2]
    took = time.monotonic() - since
    check(took < 1.5, f"a hand that is taken away: at rest after {took:.2f} s")
    link.farewell()


def next_at_once(task):
    """A task sent as soon as the last one is told to be done is not refused for coming early, but judged."""
    machine = Machine("at-once")
    link = new_master(machine)
    link.send(TASK, task)
    check(answer_of(link.expect(ANSWER, 20))[0], "at once: the first task")
    check(link.order(EXECUTE)[0], "at once: is executed")
    link.expect(STATE, 60, lambda state: b"executed" in state)
    link.send(TASK, task)
    ok, text = answer_of(link.expect(ANSWER, 20))
    check(not ok and "which stands at" in text, f"at once: the next is looked at, and begins elsewhere: {text}")
    link.farewell()
    machine.end("the machine that had a task at once")


def rates_of(state):
    """dq of a STATE of four joints."""
    at = 9
    for _ in range(2):
        at += 2 + struct.unpack(">H", state[at:at + 2])[0]
    at += 8 + 4 + 13 * 8 + 1
    return struct.unpack(">4d", state[at + 32:at + 64])


def on_this_computer():
    machine = Machine("loopback", "--rig", RIG, "--mount", "upper", "--image-rate", "1", "--mass-sigma", "0.03", "--seed", "2")
    check(machine.port > 0, "the machine listens")
    if not machine.port:
        return
    task = first_task(machine)
    machine.end("the first machine")
    beside = threading.Thread(target=guarded(lambda: next_at_once(task)))
    beside.start()
    machine = Machine("loopback-2")
    link = try_tasks(machine, task)
    try_frames(machine, link, task)
    try_jog(machine)
    machine.end("the second machine")
    beside.join()


# ---- over a wire ----


class Wire:
    """Two network namespaces and the packets between them, which may be late, lost, or go nowhere."""
    TUNSETIFF, IFF_TAP, IFF_NO_PI, CLONE_NEWNET = 0x400454CA, 2, 0x1000, 0x40000000

    def __init__(self):
        self.names = [f"td{os.getpid() % 100000}{side}" for side in "ab"]
        self.delay, self.loss, self.cut = 0.0, 0.0, False
        self.passed = self.lost = self.number = 0
        self.random = random.Random(5)
        self.taps = []
        for k, name in enumerate(self.names):
            self.ip("netns", "add", name)
            self.taps.append(self.tap(name))
            self.ip("-n", name, "addr", "add", f"10.77.0.{k + 1}/24", "dev", "tap0")
            self.ip("-n", name, "link", "set", "tap0", "up")
            self.ip("-n", name, "link", "set", "lo", "up")
        self.running = True
        self.thread = threading.Thread(target=self.carry, daemon=True)
        self.thread.start()

    @staticmethod
    def ip(*words):
        subprocess.run(["ip", *words], check=True, capture_output=True)

    def tap(self, name):
        opened = []

        def there():  # a thread of its own stays in that namespace
            with open(f"/var/run/netns/{name}") as space:
                if ctypes.CDLL(None, use_errno=True).setns(space.fileno(), self.CLONE_NEWNET) != 0:
                    return
            fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(fd, self.TUNSETIFF, struct.pack("16sH22x", b"tap0", self.IFF_TAP | self.IFF_NO_PI))
            opened.append(fd)

        thread = threading.Thread(target=there)
        thread.start()
        thread.join()
        return opened[0]

    def carry(self):
        if URGENT:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))  # of this thread
        waiting = []  # a heap of (when, number, to, packet)
        while self.running:
            until = max(0, waiting[0][0] - time.monotonic()) if waiting else 0.05
            for fd in select.select(self.taps, [], [], min(until, 0.05))[0]:
                packet = os.read(fd, 65536)
                if self.cut or self.random.random() < self.loss:
                    self.lost += 1
                    continue
                self.passed += 1
                self.number += 1
                heapq.heappush(waiting, (time.monotonic() + self.delay, self.number, self.taps[1 - self.taps.index(fd)], packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, to, packet = heapq.heappop(waiting)
                try:
                    os.write(to, packet)
                except OSError:
                    pass

    def end(self):
        self.running = False
        self.thread.join()
        for fd in self.taps:
            os.close(fd)
        for name in self.names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


def make_certificate():
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
                    "-subj", "/CN=machine", "-addext", "subjectAltName=IP:10.77.0.1,IP:127.0.0.1", "-keyout",
                    os.path.join(folder, "key.pem"), "-out", os.path.join(folder, "cert.pem")], check=True, capture_output=True)
    return os.path.join(folder, "cert.pem"), os.path.join(folder, "key.pem")


def trouble(machine, wire, name, act, undo, goes_on=False):
    """A task under way, then what is done to the wire or the master, and what the machine makes of it."""
    there = ("ip", "netns", "exec", wire.names[1])
    ask = dict(to="10.77.0.1:7420", before=there)
    trust = ("--ca", CERTIFICATE)
    begun = time.monotonic()
    far = FAR[trouble.count % 2]
    trouble.count += 1
    process = master("run", far, *trust, wait=False, **ask)
    if machine.await_line("execute", since=begun, seconds=60) is None:
        check(False, f"{name}: nothing is executed: {told(process)}")
        return
    time.sleep(1.2)
    at = time.monotonic()
    wire.passed = wire.lost = 0
    act(process)
    stop = machine.await_line("stop", since=at, seconds=3 / PATIENCE if goes_on else 6)
    if goes_on and stop is None:
        print(f"        {name}: went on, {wire.lost} of {wire.lost + wire.passed} packets lost")
        check(not machine.lines("lost", since=begun), f"{name}: the link held")
        process.send_signal(signal.SIGINT)
        stop = machine.await_line("stop", since=at)  # ordered; or the order itself was lost too long
        status, _, errors = told(process)
        undo(process)
        check(stop is not None and status == 1, f"{name}: the master stops it {stop and stop['text']}, {status} {errors}")
        check(master("reinit", *trust, **ask)[0] == 0, f"{name}: Reinit")
        return
    undo(process)
    if stop is None:
        check(False, f"{name}: no stop was commanded")
        return
    late = stop["clock_s"] - at
    # What other processes took of the machine's time is not its own doing; it says how much.
    allowed = TIMEOUT + PERIOD + stop["starved_s"]
    check(goes_on or late <= allowed, f"{name}: the stop was commanded {late:.3f} s after it, {allowed:.3f} allowed")
    stopped = machine.await_line("stopped", since=at)
    check(stopped is not None and 0 < stopped["took_s"] < 2 and 0 < abs(stopped["angle"]) < 0.6,
          f"{name}: it came to rest {stopped and (stopped['took_s'], stopped['joint'], stopped['angle'])}")
    check(bool(machine.lines("phase", "failed", since=at)), f"{name}: failed")
    if stopped:
        print(f"        {name}: stop after {late:.3f} s (silent for {stop['silent_s']:.3f} s, starved for {stop['starved_s']:.3f} s), at rest after {stopped['took_s']:.2f} s, "
              f"{stopped['joint']} went on by {stopped['angle']:.3f} rad")
    status, _, errors = told(process, 20)
    check(status == 1 and "is closed" in errors or status in (3, -signal.SIGKILL), f"{name}: the master is told: {status} {errors.strip()}")
    status, result, errors = master("run", far, *trust, **ask)
    check(status == 3 and "Reinit" in result.get("answer", {}).get("text", ""), f"{name}: no motion without Reinit: {status} {errors}")
    if stopped:
        check(abs(result.get("stopped", {}).get("angle", 9) - stopped["angle"]) < 1e-9, f"{name}: the next master is told of the stop")
    status, _, errors = master("reinit", *trust, **ask)
    check(status == 0, f"{name}: Reinit {errors}")


trouble.count = 0


def over_a_wire():
    try:
        wire = Wire()
    except (OSError, IndexError, subprocess.CalledProcessError) as why:  # no rights, no /dev/net/tun, no iproute2
        skip(f"no network namespaces or TAP devices here: {why}")
        return
    try:
        machine = Machine("far", "--cert", CERTIFICATE, "--key", PRIVATE, before=("ip", "netns", "exec", wire.names[0]),
                          address="10.77.0.1:7420")
        check(machine.port == 7420, "the machine listens beyond its computer, with TLS")

        def nothing(process):
            pass

        def set_wire(**values):
            def act(process):
                for key, value in values.items():
                    setattr(wire, key, value)
            return act

        trouble(machine, wire, "the wire cut", set_wire(cut=True), set_wire(cut=False))
        if not SANITIZED:  # where each takes half a minute, and runs the same lines
            trouble(machine, wire, "500 ms of delay", set_wire(delay=5 * PERIOD), set_wire(delay=0.0))
            trouble(machine, wire, "a master that hangs", lambda process: process.send_signal(signal.SIGSTOP),
                    lambda process: process.send_signal(signal.SIGCONT))
            trouble(machine, wire, "5 % of packets lost", set_wire(loss=0.05), set_wire(loss=0.0), goes_on=True)
        trouble(machine, wire, "a master that was killed", lambda process: process.kill(), nothing)
        machine.end("the far machine")
    finally:
        wire.end()


# ---- words ----


def on_the_command_line():
    status, text, errors = run("machine", "--help")
    check(status == 0 and text.startswith("teledimos machine ") and not errors, "--help")
    check(not [line for line in text.splitlines() if len(line) > 100 and not line.startswith("  teledimos")], "--help: 100 columns")
    port = "127.0.0.1:1"
    open_token = write("open-token", "0123456789abcdef0123456789abcdef")
    os.chmod(open_token, 0o644)
    for name, status, words, arguments in (
            ("no token", 2, "--token-file is missing", (NEAR, "--listen", "127.0.0.1:0")),
            ("a token for all to read", 1, "others may read", (NEAR, "--listen", "127.0.0.1:0", "--token-file", open_token)),
            ("neither side", 2, "one of --listen and --connect", (NEAR,)),
            ("plain beyond the computer", 2, "is encrypted", (NEAR, "--listen", "0.0.0.0:0", "--token-file", TOKEN)),
            ("no verb", 2, "is none of", ("walk", "--connect", port, "--token-file", TOKEN)),
            ("no scenario", 2, "run goes with SCENARIO", ("run", "--connect", port, "--token-file", TOKEN)),
            ("nobody there", 1, "cannot connect", ("status", "--connect", port, "--token-file", TOKEN)),
            ("a scenario without a ground", 1, "has a task and a ground",
             (os.path.join(SOURCE, "datasets/zx200/paper.yaml"), "--listen", "127.0.0.1:0", "--token-file", TOKEN)),
            ("no certificate", 1, "is no certificate", (NEAR, "--listen", "127.0.0.1:0", "--token-file", TOKEN, "--cert", TOKEN, "--key",
                                                        TOKEN))):
        code, text, errors = run("machine", *arguments, cwd=folder)
        check(code == status and words in errors and errors.count("\n") == 1 and not text, f"{name}: {code} {errors.strip()}")


def try_tls():
    """Both sides with TLS; a plain master, a certificate that is not believed, a man in the middle with one of his own."""
    machine = Machine("tls", "--cert", CERTIFICATE, "--key", PRIVATE)
    to = f"127.0.0.1:{machine.port}"
    check(master("status", "--ca", CERTIFICATE, to=to)[0] == 0, "TLS: status")
    check(master("status", "--tls", to=to)[0] == 0, "TLS, any certificate: status")
    status, _, errors = master("status", to=to)
    check(status == 1 and "TLS" in errors, f"a plain master: {errors.strip()}")
    check(machine.await_line("refused", "TLS") is not None, "a plain master: recorded")
    other = os.path.join(folder, "other")
    os.makedirs(other)
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2", "-subj",
                    "/CN=other", "-keyout", f"{other}/key.pem", "-out", f"{other}/cert.pem"], check=True, capture_output=True)
    status, _, errors = master("status", "--ca", f"{other}/cert.pem", to=to)
    check(status == 1 and "certificate is not believed" in errors, f"another authority: {errors.strip()}")

    def sit_between(listener):
        mine = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        mine.load_cert_chain(f"{other}/cert.pem", f"{other}/key.pem")
        his = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        his.check_hostname, his.verify_mode = False, ssl.CERT_NONE
        try:
            client = mine.wrap_socket(listener.accept()[0], server_side=True)
            server = his.wrap_socket(socket.create_connection(("127.0.0.1", machine.port)))
            for source, target, size in ((client, server, 56), (server, client, 56), (client, server, 32), (server, client, 32)):
                target.sendall(source.recv(size))
        except OSError:
            pass

    listener = socket.create_server(("127.0.0.1", 0))
    since = time.monotonic()
    threading.Thread(target=sit_between, args=(listener,), daemon=True).start()
    status, _, errors = master("status", "--tls", to=f"127.0.0.1:{listener.getsockname()[1]}")
    check(status == 1, f"a man in the middle: {errors.strip()}")
    check(machine.await_line("refused", "does not hold the token", since) is not None, "a man in the middle: refused and recorded")
    machine.end("the machine with TLS")


CAMERA = ("  - {name: %s, model: pinhole, width: 160, height: 120, intrinsics: {fx: 140, fy: 140, cx: 79.5, cy: 59.5},\n"
          "     camera_from_rig: {q: [1, 0, 0, 0], t_m: [%g, 0, 0]}}\n")
RIG = write("rig.yaml", "teledimos: rig 1\ncameras:\n" + CAMERA % ("left", 0) + CAMERA % ("right", -0.4) +
            "vehicle_from_rig: {q: [0.320258044365, -0.575090235484, 0.657693525939, -0.36625842244], t_m: [1.6, 0.75, 2.0]}\n")
KEY = os.urandom(16).hex().encode()
TOKEN = write("token", KEY.decode() + "\n")
os.chmod(TOKEN, 0o600)
write_map("flat.tif")
NEAR = scenario("near", "  - position: {joints: {swing_deg: 12, boom_deg: -50}, law: quintic}\n")
FAR = [scenario(f"far{k}", f"  - position: {{joints: {{swing_deg: {swing}}}, law: quintic}}\n", 0.6) for k, swing in enumerate((120, -120))]
CERTIFICATE, PRIVATE = make_certificate()



def guarded(test):
    """In a thread: what goes wrong there fails the tests."""
    def run_it():
        try:
            test()
        except Exception as why:  # whatever it is
            check(False, f"{test.__name__}: {type(why).__name__}: {why}\n{traceback.format_exc()}")
    return run_it


threads = [threading.Thread(target=guarded(on_this_computer)), threading.Thread(target=guarded(over_a_wire))]
for thread in threads:
    thread.start()
guarded(on_the_command_line)()
guarded(try_tls)()
for thread in threads:
    thread.join()
shutil.rmtree(folder, ignore_errors=True)
finish()
