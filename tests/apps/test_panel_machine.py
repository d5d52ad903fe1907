"""teledimos panel --machine: the master station. A session led over the panel whose task a machine in a process of its own does.

Simulated here, validated, sent, checked by the machine's own simulation, executed: the measured joints end where the task and
the prediction want them, within the 0.01 rad that the machine itself allows a master; the predicted machine moves beside. Pause,
Resume, UserStop, Manual and Jog reach the machine; the operator's connection lost stops it. The panel killed (SIGKILL) while the
machine moves: it stops by its own timeout, and the panel begun again shows it stopped where it stands, refuses to move it until
Reinit, and then does. Its link's figures come; its images do, and cost no deadline. Both records are whole: each line parses,
numbers rise by one, and each order that was answered stands there.

Reference: the machine's own record and its command `machine status`. Blind to: networks that lose (test_machine.py); pixels of
the images."""

import atexit
import base64
import json
import math
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time

import numpy

from common import PROGRAM, SANITIZED, SOURCE, check, finish, run, schema_fault, skip
from websocket import Client

try:
    from osgeo import gdal
    gdal.UseExceptions()
except ImportError:
    skip("the readers of GDAL are not installed (python3-gdal)")
    finish()

ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
PERIOD = 1.0 if SANITIZED else 0.1
PATIENCE = 6 if SANITIZED else 1
folder = tempfile.mkdtemp()
URGENT = ("chrt", "-f", "10")
if not shutil.which("chrt") or subprocess.run([*URGENT, "true"], capture_output=True).returncode != 0:
    URGENT = ()
CAMERA = ("  - {name: %s, model: pinhole, width: 160, height: 120, intrinsics: {fx: 140, fy: 140, cx: 79.5, cy: 59.5},\n"
          "     camera_from_rig: {q: [1, 0, 0, 0], t_m: [%g, 0, 0]}}\n")


def write(name, text):
    path = os.path.join(folder, name)
    with open(path, "w") as file:
        file.write(text)
    return path


def write_map(name):
    cell, side, origin = 0.1, 200, (-10.0, -10.0)
    file = gdal.GetDriverByName("GTiff").Create(os.path.join(folder, name), side, side, 1, gdal.GDT_Float32)
    file.SetGeoTransform([origin[0] - cell / 2, cell, 0, origin[1] + (side - 0.5) * cell, 0, -cell])
    file.GetRasterBand(1).WriteArray(numpy.zeros((side, side), numpy.float32))


def lines_of(out):
    with open(os.path.join(out, "audit.jsonl")) as file:
        return [json.loads(line) for line in file]


started = []


def end_all():
    for process in started:
        process.kill()


atexit.register(end_all)


class Machine:
    def __init__(self):
        self.out = os.path.join(folder, "machine")
        self.process = subprocess.Popen([*URGENT, PROGRAM, "machine", SCENARIO, "--listen", "127.0.0.1:0", "--token-file", TOKEN, "-o",
                                         self.out, "--period", str(PERIOD), "--rig", RIG, "--mount", "upper", "--image-rate", "2"],
                                        stdout=subprocess.PIPE, text=True)
        started.append(self.process)
        self.port = int(self.process.stdout.readline().split()[-1])

    def lines(self, what, words="", since=0.0):
        return [line for line in lines_of(self.out) if line["what"] == what and words in line["text"] and line["clock_s"] >= since]

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        check(self.process.wait(10 * PATIENCE) == 0, "SIGTERM ends the machine")


class Panel:
    def __init__(self, machine, *options):
        self.out = os.path.join(folder, "panel")
        self.process = subprocess.Popen([*URGENT, PROGRAM, "panel", SCENARIO, "-o", self.out, "--port", "0", "--machine",
                                         f"127.0.0.1:{machine.port}", "--machine-token-file", TOKEN, "--machine-period", str(PERIOD),
                                         *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        started.append(self.process)
        line = self.process.stderr.readline()
        found = re.search(r":(\d+)/", line)
        if not found:
            check(False, f"the panel did not begin: {line} {self.process.communicate()[1]}")
            finish()
        self.port = int(found[1])

    def client(self):
        client = Client(self.port).ready()
        client.kept["/log"] = []
        client.subscribe(*client.channels)
        return client

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        text, errors = self.process.communicate(timeout=30)
        return self.process.returncode, text, errors


def measured(client):
    return {joint["name"]: joint["position"] for joint in client.newest("/measured/joints").get("joints", [])}


def predicted(client):
    return {joint["name"]: joint["position"] for joint in client.newest("/joints")["joints"]}


def reaches(client, phase, seconds=20):
    good = client.until(lambda: client.phase() == phase, seconds * PATIENCE)
    check(good, f"'{phase}': {client.phase()}; {client.newest('/link').get('phase')}; "
          f"{[json.loads(text)['message'] for _, text in client.kept['/log'][-8:]] if not good else ''}")
    if not good:
        finish()


def ordered(client, name, **arguments):
    ok, answer = client.order(name, **arguments)
    check(ok, f"{name}: {answer}")


def to_the_machine(client):
    """Simulated, validated, sent and held."""
    ordered(client, "StartSim")
    reaches(client, "simulated to the end", 40)
    ordered(client, "Validate")
    ordered(client, "Download")
    reaches(client, "the machine holds the task")


def first_task(client):
    start = measured(client)
    to_the_machine(client)
    check(max(abs(measured(client)[name] - start[name]) for name in start) < 1e-3, "the machine stands while it is simulated here")
    ordered(client, "Execute")
    reaches(client, "the machine executes the task")
    apart = []
    client.until(lambda: apart.append(max(abs(measured(client)[k] - v) for k, v in predicted(client).items())) or
                 client.phase() == "executed; the machine is watched", 30 * PATIENCE)
    reaches(client, "executed; the machine is watched", 30)
    end = measured(client)
    check(abs(end["swing"] - math.radians(1.5)) < 0.003, f"the machine is where the task wants it: swing {end['swing']:.4f}")
    check(max(abs(end[k] - v) for k, v in predicted(client).items()) < 0.003, "and where it was predicted")
    # The same motion a few periods of the link later, at 0.5 rad/s at most.
    check(max(apart) < (0.5 if SANITIZED else 0.15), f"predicted and measured go together: {max(apart):.3f} rad apart at most")
    frames = {t["child_frame_id"] for t in client.newest("/measured/tf")["transforms"]}
    check("measured/upper" in frames and all(name.startswith("measured/") for name in frames), f"its frames: {sorted(frames)}")
    shapes = client.newest("/measured/machine")["entities"]
    check(shapes and all(e["frame_id"].startswith("measured/") for e in shapes), "its shapes stand in them")
    print(f"        predicted and measured at most {max(apart):.4f} rad apart on the way")


def figures(client):
    link = client.newest("/link")
    check(link["open"] and link["pings"] > 5 and 0 < link["round_trip_mean_s"] < 0.2 and link["state_age_s"] < 1 and
          link["lost_share"] <= 1, f"the link's figures: {link}")
    check(client.until(lambda: "/camera/left" in client.latest and "/camera/right" in client.latest, 20 * PATIENCE), "images come")
    image = client.newest("/camera/left")
    check(image["format"] == "jpeg" and base64.b64decode(image["data"])[:2] == b"\xff\xd8", "as JPEG")
    check(client.until(lambda: (client.newest("/link").get("image_age_s") or 99) < 5, 5), "and their age is told")
    faults = [schema_fault(client.newest(topic), json.loads(client.channels[topic]["schema"]), topic) for topic in client.latest]
    check(len(faults) >= 16 and not any(faults), f"{len(faults)} channels' messages are of their schemas: {[f for f in faults if f]}")
    d = client.newest("/diagnostics")
    busy = SANITIZED or os.getloadavg()[0] > os.cpu_count()
    check(busy or not URGENT or d["misses"] <= 0.02 * d["ticks"], f"deadlines missed: {d['misses']} of {d['ticks']}")
    print(f"        round trip {1e3 * link['round_trip_mean_s']:.2f} ms, {d['misses']} of {d['ticks']} deadlines missed, "
          f"{client.counts['/camera/left']} images")


def by_hand(client, machine):
    ordered(client, "Reinit")
    reaches(client, "ready")
    ordered(client, "Manual")
    reaches(client, "manual: moved by the operator's hand")
    client.until(lambda: client.newest("/link").get("mode") == "manual", 3 * PATIENCE)
    before = measured(client)["boom"]
    ordered(client, "Jog", joint="boom", stick=0.6, for_s=0.8)
    check(client.until(lambda: measured(client)["boom"] > before + 0.01, 4 * PATIENCE),
          f"the machine's boom follows the hand: {before:.4f} to {measured(client)['boom']:.4f}")
    ordered(client, "Automatic")
    reaches(client, "ready")
    client.watch(1.5)
    apart = max(abs(measured(client)[k] - v) for k, v in predicted(client).items())
    check(apart < 0.01, f"then the simulated machine stands where the other one does: {apart:.4f} rad")


def paused_and_stopped(client, machine):
    to_the_machine(client)
    ordered(client, "Execute")
    reaches(client, "the machine executes the task")
    client.watch(0.5)
    ordered(client, "Pause")
    reaches(client, "the machine is paused")
    check(client.until(lambda: client.newest("/link").get("mode") == "paused", 3 * PATIENCE), "the machine pauses")
    client.watch(1.0)
    at = measured(client)["swing"]
    client.watch(0.5)
    check(abs(measured(client)["swing"] - at) < 1e-3, "and stands")
    ordered(client, "Resume")
    reaches(client, "the machine executes the task")
    check(client.until(lambda: client.newest("/link").get("mode") == "working", 3 * PATIENCE), "it goes on")
    since = time.monotonic()
    ordered(client, "UserStop")
    check(client.until(lambda: machine.lines("stop", "ordered", since), 3 * PATIENCE), "UserStop stops the machine")
    reaches(client, "nothing is prepared")
    stop = (machine.lines("stop", "ordered", since) or [{"clock_s": math.inf}])[0]["clock_s"] - since
    check(stop < 0.5 * PATIENCE, f"after {stop:.3f} s")
    client.watch(1.0)
    ordered(client, "Prepare")
    reaches(client, "ready")


def operator_lost(panel, client, machine):
    """The connection of who holds control: the machine is stopped."""
    to_the_machine(client)
    ordered(client, "Execute")
    reaches(client, "the machine executes the task")
    client.watch(0.7)
    since = time.monotonic()
    client.close()
    until = since + 5 * PATIENCE
    while not machine.lines("stop", since=since) and time.monotonic() < until:
        time.sleep(0.02)
    stops = machine.lines("stop", since=since)
    check(len(stops) == 1 and stops[0]["clock_s"] - since < 1 * PATIENCE, f"an operator who is lost: stopped {stops}")
    other = panel.client()
    reaches(other, "nothing is prepared")
    ordered(other, "TakeControl")
    other.watch(1)
    ordered(other, "Prepare")
    reaches(other, "ready")
    return other


def killed(panel, client, machine):
    """SIGKILL of the panel while the machine moves."""
    to_the_machine(client)
    ordered(client, "Execute")
    reaches(client, "the machine executes the task")
    client.until(lambda: abs(client.newest("/measured/joints")["joints"][0]["rate"]) > 0.05, 5 * PATIENCE)
    since = time.monotonic()
    panel.process.kill()
    panel.process.communicate()
    until = since + (3 * PERIOD + 3) * PATIENCE
    while not machine.lines("stopped", since=since) and time.monotonic() < until:
        time.sleep(0.02)
    stop, stopped = machine.lines("stop", "lost", since), machine.lines("stopped", since=since)
    check(stop and stopped, "the machine stops by itself")
    if not stop or not stopped:
        finish()
    late = stop[0]["clock_s"] - since
    check(late < 4 * PERIOD + stop[0]["starved_s"], f"within its timeout: {late:.3f} s")
    print(f"        panel killed: stop after {late:.3f} s, at rest after {stopped[0]['took_s']:.2f} s")
    lines = lines_of(panel.out)
    runs = [i for i, line in enumerate(lines) if line["what"] == "begin"] + [len(lines)]
    for first, last in zip(runs, runs[1:]):
        check([line["line"] for line in lines[first:last]] == list(range(1, last - first + 1)), "the panel's record is whole")
    orders = {line["order"] for line in lines if line["what"] == "order"}
    answers = {line["order"] for line in lines if line["what"] == "answer"}
    check(answers <= orders and len(orders) > 20, f"{len(orders)} orders, {len(answers)} answers")
    executes = [line for line in lines if line["what"] == "order" and line["request"] == "Execute"]
    told = [line for line in lines if line["what"] == "machine told" and line["text"] == "execute"]
    check(len(executes) == len(told) == len(machine.lines("execute")), "what was accepted stands in both records")


def begun_again(machine):
    panel = Panel(machine)
    client = panel.client()
    reaches(client, "failed: waiting for Reinit")
    check(client.until(lambda: client.newest("/link").get("mode") == "failed", 5), f"its own phase is shown: {client.newest('/link')}")
    check("link" in client.newest("/link")["fault"], f"and why: {client.newest('/link')['fault']}")
    client.until(lambda: measured(client), 5)
    true = measured(client)
    swing = true["swing"]
    ordered(client, "TakeControl")
    for order in ("StartSim", "Manual", "Execute"):
        ok, why = client.order(order)
        check(not ok and "Reinit first" in why, f"{order} before Reinit: {why}")
    client.watch(0.5)
    check(abs(measured(client)["swing"] - swing) < 1e-3, "the machine stands")
    check(max(abs(true[k] - v) for k, v in predicted(client).items()) < 0.01, "and the simulated one stands there, too")
    ordered(client, "Reinit")
    reaches(client, "ready")
    to_the_machine(client)
    ordered(client, "Execute")
    reaches(client, "executed; the machine is watched", 40)
    code, text, errors = panel.end()
    check(code == 0, f"the panel ends: {code} {errors.strip()}")
    code, _, errors = run("simulate", SCENARIO, "-o", os.path.join(folder, "again"), "--replay",
                          os.path.join(panel.out, "recording.mcap"))
    check(code == 1 and "machine elsewhere" in errors, f"such a session is not replayed: {code} {errors.strip()}")


def refused_machines(machine):
    def told(*options):
        done = subprocess.run([PROGRAM, "panel", SCENARIO, "-o", os.path.join(folder, "no"), "--port", "0", *options],
                              capture_output=True, text=True, timeout=30)
        return done.returncode, done.stderr

    code, errors = told("--machine", f"127.0.0.1:{machine.port}")
    check(code == 2 and "--machine-token-file" in errors, f"no token: {code} {errors.strip()}")
    other = write("other", "y" * 32)
    os.chmod(other, 0o600)
    panel = subprocess.Popen([PROGRAM, "panel", SCENARIO, "-o", os.path.join(folder, "wrong"), "--port", "0", "--machine",
                              f"127.0.0.1:{machine.port}", "--machine-token-file", other], stderr=subprocess.PIPE, text=True)
    client = Client(int(re.search(r":(\d+)/", panel.stderr.readline())[1])).ready()
    client.subscribe("/session", "/link")
    check(client.until(lambda: client.newest("/link").get("why") and "not reached" not in client.newest("/link")["why"], 8),
          "a wrong token: no link")
    client.until(lambda: client.phase(), 3)
    check(client.phase() == "opening links, reading parameters" and not client.newest("/link")["open"], f"a wrong token: {client.phase()}")
    panel.kill()
    panel.communicate()


write_map("flat.tif")
TOKEN = write("token", os.urandom(16).hex() + "\n")
os.chmod(TOKEN, 0o600)
RIG = write("rig.yaml", "teledimos: rig 1\ncameras:\n" + CAMERA % ("left", 0) + CAMERA % ("right", -0.4) +
            "vehicle_from_rig: {q: [0.320258044365, -0.575090235484, 0.657693525939, -0.36625842244], t_m: [1.6, 0.75, 2.0]}\n")
SCENARIO = write("there.yaml", f"teledimos: scenario 1\nname: there\nrobot: {ROBOT}\n"
                 "start: {joints: {swing: 0, boom: -0.7, arm: 1.3, bucket: 0.6}}\nduration_s: 2.5\nlog_s: 0.05\n"
                 "live: {on_miss: catch-up, tolerance_s: 0.02}\n"
                 "ground: {map: flat.tif, sigma_m: 0.02}\n"
                 "task: {name: there, steps: [{position: {joints: {swing_deg: -1.5}, law: quintic, duration_s: 1.2}},\n"
                 "  {position: {joints: {swing_deg: 1.5}, law: quintic, duration_s: 1.2}}]}\n")


def main():
    machine = Machine()
    panel = Panel(machine)
    client = panel.client()
    reaches(client, "ready")
    ordered(client, "TakeControl")
    first_task(client)
    figures(client)
    by_hand(client, machine)
    paused_and_stopped(client, machine)
    client = operator_lost(panel, client, machine)
    killed(panel, client, machine)
    refused_machines(machine)
    begun_again(machine)
    machine.end()
    shutil.rmtree(folder, ignore_errors=True)
    finish()


main()
