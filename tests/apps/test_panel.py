"""teledimos panel, spoken to over sockets by a client written here (websocket.py) from the protocol's and RFC 6455's text.

What is seen live is what ran: the joints of the live messages against those of the session done again from the recording by
simulate --replay, to their digits. Orders by who holds control alone; it is handed over, refused, and lost with its
connection, which stops the machine. The table of its logic is the documented one. Everything that must not come in is refused,
told and logged, while another client goes on being served: no token, a wrong one, another origin or subprotocol, too many
clients, orders of a watcher, a call sent again, messages that are none, too large, too slow, too many, frames that are none.
The audit log is whole after SIGKILL.

Blind to: what Foxglove's own program draws; networks with loss; many clients (test_panel_watchers.py)."""

import base64
import concurrent.futures
import json
import math
import os
import re
import resource
import signal
import socket
import ssl
import struct
import subprocess
import tempfile
import time

import numpy

from common import PROGRAM, SOURCE, check, fault_of_sentence, finish, run, skip
from websocket import PROTOCOLS, Client, Refused

ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
SCENARIO = (f"teledimos: scenario 1\nname: panel-test\nrobot: {ROBOT}\n"
            "start: {joints: {swing: 0, boom: -0.5, arm: 1.6, bucket: 0.6}}\n"
            "duration_s: 2\nlog_s: 0.05\ncontrol: {gain_1_s: 3, period_s: 0.05}\n"
            "live: {on_miss: catch-up, tolerance_s: 0.02}\n"
            "task: {name: t, steps: [{position: {to: {x_m: 7.0, y_m: 1.0, z_m: 1.2}, law: quintic, duration_s: 2}}]}\n")
TOKEN = "correct-horse-battery-staple"


class Panel:
    """The program, running; as a context it is killed at its end."""

    def __init__(self, folder, *options, scenario=SCENARIO, port=0, before=None):
        self.out = os.path.join(folder, "out")
        path = os.path.join(folder, "scenario.yaml")
        with open(path, "w") as file:
            file.write(scenario)
        self.scenario = path
        where = () if "--listen" in options else ("--port", str(port))
        self.process = subprocess.Popen([PROGRAM, "panel", path, "-o", self.out, *where, *options],
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=before)
        line = self.process.stderr.readline()
        found = re.search(r":(\d+)/", line)
        if not found:
            check(False, f"the panel did not begin: {line.strip()} {self.process.communicate()[1]}")
            finish()
        self.port = int(found[1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.communicate()

    def client(self, *arguments, **how):
        return Client(self.port, *arguments, **how).ready()

    def audit(self):
        with open(os.path.join(self.out, "audit.jsonl")) as file:
            return [json.loads(line) for line in file]

    def end(self, number=signal.SIGTERM):
        """Exit status, standard output and error."""
        self.process.send_signal(number)
        try:
            text, errors = self.process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            return None, "", "it did not end"
        return self.process.returncode, text, errors


def logged(panel, what, **fields):
    """Whether the audit log has such a line; texts by their beginning."""
    return any(line["what"] == what and all(str(line.get(key, "")).startswith(str(value)) for key, value in fields.items())
               for line in panel.audit())


def joints(message):
    return {joint["name"]: joint["position"] for joint in message["joints"]}


def refused(panel, what, words, **how):
    """A connection that is turned away, with the reason in its answer and in the log."""
    try:
        Client(panel.port, **how).close()
        check(False, f"{what}: let in")
    except Refused as why:
        status = str(why).split("\r\n")[0]
        time.sleep(0.05)
        check(" 101 " not in status, f"{what}: {status}")
        check(logged(panel, "turned away", why=words), f"{what}: in the audit log as '{words}'")


# ---- a session, led ----

def test_session(folder):
    with Panel(folder) as panel:
        client = panel.client()
        check("Sec-WebSocket-Protocol: foxglove.sdk.v1" in client.head, "the newer subprotocol is spoken")
        check({"services", "parameters", "time"} <= set(client.info["capabilities"]), "capabilities")
        check({"/tf", "/joints", "/joints/desired", "/tool", "/tool/desired", "/machine", "/log", "/session", "/diagnostics"} <=
              set(client.channels), f"channels: {sorted(client.channels)}")
        check("/terrain" not in client.channels, "no ground, no terrain")
        test_table(client)
        for channel in client.channels.values():
            check(json.loads(channel["schema"])["type"] == "object" and channel["encoding"] == "json",
                  f"{channel['topic']} has a schema")
        check({"StartSim", "Pause", "Resume", "UserStop", "Reinit", "Validate", "Execute", "Jog", "TakeControl",
               "ReleaseControl"} <= set(client.services), f"services: {sorted(client.services)}")
        client.subscribe("/tf", "/joints", "/machine", "/session", "/log")
        client.until(lambda: {"/tf", "/joints", "/machine", "/session"} <= set(client.latest))
        frames = {(t["parent_frame_id"], t["child_frame_id"]) for t in client.newest("/tf")["transforms"]}
        check(("site", "undercarriage") in frames and len(frames) >= 5, f"transforms: {sorted(frames)}")
        check(any(e["id"] == "undercarriage" for e in client.newest("/machine")["entities"]), "the machine's shapes")
        check(client.until(lambda: client.phase() == "ready"), f"it waits prepared: {client.phase()}")

        ok, why = client.order("StartSim")
        check(not ok and "TakeControl" in why, f"StartSim without control: {why}")
        check(client.order("TakeControl") == (True, {"operator": 1}), "control is taken")
        ok, why = client.order("Resume")
        check(not ok and "nothing is paused" in why, f"the behaviour's own refusal: {why}")
        test_parameters(client)
        start = joints(client.newest("/joints"))
        check(client.order("StartSim") == (True, {"answer": "accepted"}), "StartSim")
        check(client.until(lambda: client.phase() == "simulating"), "simulating")
        client.until(lambda: client.newest("/session").get("share", 1) > 0.3)
        check(client.order("Pause")[0] and client.until(lambda: client.phase() == "the simulation is paused"), "Pause")
        check(client.order("Resume")[0], "Resume")
        check(client.until(lambda: client.phase() == "simulated to the end"), f"it ends: {client.phase()}")
        end = joints(client.newest("/joints"))
        check(abs(end["swing"] - start["swing"]) > 0.05, f"and has moved: swing {start['swing']:.3f} to {end['swing']:.3f}")
        check(client.order("Validate")[0], "Validate")
        ok, why = client.order("Download")
        check(not ok and "no machine" in why, f"there is no machine to execute it: {why}")
        check(client.order("Reinit")[0] and client.until(lambda: client.phase() == "ready"), "Reinit")
        check(client.order("Manual")[0], "Manual")
        before = joints(client.newest("/joints"))["boom"]
        check(client.order("Jog", joint="boom", stick=0.5, for_s=0.5) == (True, {"answer": "accepted"}), "Jog")
        check(client.until(lambda: joints(client.newest("/joints"))["boom"] > before + 0.005, 3), "the boom follows the stick")
        for arguments, word in (({"joint": "leg", "stick": 1}, "joint"), ({"joint": "boom", "stick": 2}, "stick"),
                                ({"joint": "boom"}, "stick"), ({"joint": "boom", "stick": 0, "speed": 1}, "argument"),
                                ({"joint": "boom", "stick": 0, "type": 1}, "argument")):
            ok, why = client.order("Jog", **arguments)
            check(not ok and word in why, f"Jog {arguments}: {why}")
        client.watch(0.3)
        last_ns, last = client.latest["/joints"][0], joints(client.newest("/joints"))
        code, text, errors = panel.end()
        check(code == 0 and "nothing is prepared" in text, f"SIGTERM: status {code} {errors.strip()}\n{text}")
        check(client.until(lambda: client.closed is not None, 3), "its clients are let go")
        lines = panel.audit()
        check([line["line"] for line in lines] == list(range(1, len(lines) + 1)), "the audit log is numbered throughout")
        orders = [line["order"] for line in lines if line["what"] == "order"]
        check(sorted(orders) == sorted(line["order"] for line in lines if line["what"] == "answer"), "each order has its answer")
        code, _, errors = run("simulate", panel.scenario, "-o", os.path.join(folder, "again"), "--replay",
                              os.path.join(panel.out, "recording.mcap"))
        check(code == 1 and "parameter" in errors, f"changed parameters are not replayed: {errors.strip()}")
        return last_ns, last


def test_parameters(client):
    client.tell(op="getParameters", parameterNames=[], id="all")
    client.until(lambda: client.parameters)
    values = {p["name"]: p["value"] for p in client.parameters[-1]["parameters"]}
    check(client.parameters[-1]["id"] == "all" and values["/task/step_1/duration_s"] == 2 and
          values["/task/step_1/law"] == "quintic" and values["/scenario"] == "panel-test", f"parameters: {values}")

    def put(name, value):
        seen = len(client.parameters)
        client.tell(op="setParameters", parameters=[{"name": name, "value": value}], id="put")
        client.until(lambda: len(client.parameters) > seen)
        return client.parameters[-1]["parameters"][0]["value"] if client.parameters[-1]["parameters"] else None

    check(put("/generator/alpha", -2) == -2, "alpha is set")
    check(put("/task/step_1/law", "cubic") == "cubic", "the law is set")
    check(put("/task/step_1/law", "dance") == "cubic", "a law that is none is not")
    check(put("/generator/power", 1000) == 6, "a power out of its range is not")
    check(put("/control/period_s", 1) == 0.05, "what can only be read is not")
    check(put("/task/step_1/to/x_m", 500) == 7, "a goal beyond the arm's reach is not")
    check(put("/nothing", 1) is None, "what is not there is not")


PHASE = re.compile(r" \*   ([A-Z_]+)  +(?:rest|stop|hold|simulate|execute|jog, hold)  +(\S.*)")


def documented_ways():
    """{(phase, order or report, phase)} of the table at the head of sim/behaviour.h, which a person wrote."""
    ways = set()
    with open(os.path.join(SOURCE, "sim/behaviour.h")) as file:
        for phase, steps in (found.groups() for found in map(PHASE.match, file) if found):
            named = []
            for step in steps.split(", "):
                named.append(re.sub(r" \(held\)", "", step.split(" -> ")[0]))
                if " -> " not in step:
                    continue
                ways |= {(phase, name, step.split(" -> ")[1].strip()) for name in named}
                named = []
    return ways


def test_table(client):
    """The logic that is drawn: asked of the function, it is the table of its documentation; and faults and stops lead where they
    must."""
    client.subscribe("/panel")
    client.until(lambda: "/panel" in client.latest)
    table = client.newest("/panel")["behaviour"]
    names = {event["text"]: event["name"] for event in table["events"]}
    phases = {phase["name"] for phase in table["phases"]}
    ways = {(way["from"], names.get(way["event"], "links open and parameters read"), way["to"]) for way in table["ways"]}
    everywhere = {"USER_STOP", "ABORT", "UNREACHABLE", "LIMIT", "SINGULARITY", "DEADLINE", "DEVIATION", "PART_FAILED"}
    drawn = {way for way in ways if way[1] not in everywhere}
    # A Pause where it is paused already changes nothing.
    drawn -= {(phase, "PAUSE", phase) for phase in ("SIMULATION_PAUSED", "EXECUTION_PAUSED")}
    written = documented_ways()
    check(len(written) == 25 and drawn == written, f"the table that is served is the documented one: {sorted(drawn ^ written)}")
    for fault in everywhere - {"USER_STOP", "ABORT"}:
        to = {way[0] for way in ways if way[1] == fault and way[2] == "FAILED"}
        check(to == phases - {"IDLE", "FAILED"}, f"{fault} leads to FAILED from everywhere: {sorted(phases - to)}")
    to = {way[0] for way in ways if way[1] == "USER_STOP" and way[2] == "IDLE"}
    check(to == phases - {"IDLE"}, f"UserStop to IDLE: {sorted(phases - to)}")


def test_replay(folder):
    """The same motion from the recording as was seen live, with an older client's subprotocol."""
    with Panel(folder) as panel:
        client = panel.client(PROTOCOLS[1])
        client.kept["/joints"] = []
        client.subscribe("/joints", "/session")
        client.until(lambda: client.phase() == "ready")
        client.order("TakeControl")
        client.order("Manual")
        client.order("Jog", joint="arm", stick=-0.7, for_s=0.6)
        client.watch(0.8)
        client.order("Automatic")
        client.order("StartSim")
        check(client.until(lambda: client.phase() == "simulated to the end"), f"it ends: {client.phase()}")
        seen = {ns: joints(json.loads(text)) for ns, text in client.kept["/joints"]}
        code, _, errors = panel.end(signal.SIGINT)
        check(code == 0, f"SIGINT: status {code} {errors.strip()}")
        again = os.path.join(folder, "again")
        code, _, errors = run("simulate", panel.scenario, "-o", again, "--accept", "--replay",
                              os.path.join(panel.out, "recording.mcap"))
        check(code == 0, f"simulate --replay: status {code} {errors.strip()}")
        if code != 0:
            return
        with open(os.path.join(again, "trajectory.csv")) as file:
            head = file.readline().strip().split(",")
            rows = [dict(zip(head, line.strip().split(","))) for line in file]
        rows = {round(float(row["time_s"]) * 1e9): row for row in rows}
        far = max((abs(value - float(rows[ns][f"{name}_rad"])) for ns, row in seen.items() for name, value in row.items()
                   if ns in rows), default=math.inf)
        check(len(seen) > 20 and far < 1e-9, f"{len(seen)} live samples are those of the session done again, within {far:.1e} rad")


def test_ground(folder):
    """A map, in pieces: as it was given, and again in the recording's order."""
    try:
        from osgeo import gdal
    except ImportError:
        skip("the readers of GDAL are not installed (python3-gdal)")
        return
    side, cell = 200, 0.06
    gdal.UseExceptions()
    site = os.path.join(folder, "site.tif")
    file = gdal.GetDriverByName("GTiff").Create(site, side, side, 1, gdal.GDT_Float32)
    file.SetGeoTransform([-4 - cell / 2, cell, 0, 6 + cell / 2, 0, -cell])
    height = (0.02 * numpy.arange(side)[None, :] * cell + numpy.zeros((side, 1))).astype("float32")
    file.GetRasterBand(1).WriteArray(height)
    del file
    scenario = (f"teledimos: scenario 1\nname: ground\nrobot: {ROBOT}\nstart: {{joints: {{swing: 0, boom: -0.7, arm: 1.3, "
                f"bucket: 0.6}}}}\nduration_s: 20\nlog_s: 0.05\nground: {{map: {site}}}\n"
                "live: {on_miss: catch-up, tolerance_s: 0.02}\n"
                "task: {name: t, frame: site, steps: [{drive: {distance_m: 0.5}}]}\n")
    with Panel(folder, scenario=scenario) as panel:
        client, deaf = panel.client(), panel.client(receive_buffer=4096)
        deaf.subscribe("/terrain")
        deaf.keep_alive()  # it says that it is there, but reads nothing
        deaf_since = time.monotonic()
        client.subscribe("/terrain", "/session", "/tf")
        check(client.until(lambda: client.phase() == "ready" and "/terrain" in client.latest), "the ground is seen")
        grid = client.newest("/terrain")
        cells = numpy.frombuffer(base64.b64decode(grid["data"]), [("height", "<f4"), ("sigma", "<f4"), ("provenance", "u1")])
        cells = cells.reshape(-1, grid["column_count"])
        check(cells.shape[:2] == (side, side) and numpy.array_equal(cells["height"], height[::-1]),
              f"in pieces, as it was given: {cells.shape}, {len(client.latest['/terrain'][1])} bytes")
        client.order("TakeControl")
        before = client.newest("/tf")["transforms"][0]["translation"]["x"]
        client.order("StartSim")
        client.until(lambda: client.newest("/tf")["transforms"][0]["translation"]["x"] > before + 0.05, 8)
        after = client.newest("/tf")["transforms"][0]["translation"]["x"]
        check(after > before + 0.05, f"and the machine drives on it: {before:.3f} to {after:.3f} m")

        gone = client.until(lambda: logged(panel, "disconnect", client=2, why="it reads nothing"), 20)
        waited = time.monotonic() - deaf_since
        check(gone and waited > 8, f"one who takes nothing of the map is put out after {waited:.1f} s")
        check(client.order("UserStop")[0], "while the other leads on")
        code, _, errors = panel.end()
        check(code == 0, f"it ends: {code} {errors.strip()}")


# ---- what must not come in ----

def test_door(folder):
    token = os.path.join(folder, "token")
    with open(token, "w") as file:
        file.write(TOKEN + "\n")
    certificate, key = os.path.join(folder, "cert.pem"), os.path.join(folder, "key.pem")
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost",
                    "-addext", "subjectAltName=DNS:localhost", "-keyout", key, "-out", certificate], check=True,
                   capture_output=True)
    for words, options in ((["--token-file"], ["--listen", "0.0.0.0:0"]),
                           (["--cert", "--insecure"], ["--listen", "0.0.0.0:0", "--token-file", token]),
                           (["IPv4"], ["--listen", "here"]), (["one of them"], ["--listen", "127.0.0.1:1", "--port", "2"]),
                           (["go together"], ["--cert", certificate]), (["SCENARIO is missing"], [])):
        arguments = options if "SCENARIO" in words[0] else [os.path.join(SOURCE, "datasets/zx200/paper.yaml"), *options]
        code, _, errors = run("panel", *arguments, "-o", os.path.join(folder, "none"))
        check(code == 2 and not fault_of_sentence(errors, "panel") and all(word in errors for word in words),
              f"{' '.join(options)}: status {code} {errors.strip()}")
    with Panel(folder, "--listen", "0.0.0.0:0", "--token-file", token, "--cert", certificate, "--key", key, "--clients", "2",
               "--origin", "https://app.foxglove.dev") as panel:
        secure = ssl.create_default_context(cafile=certificate)
        bearer = f"Authorization: Bearer {TOKEN}"
        refused(panel, "no token", "no token", context=secure)
        refused(panel, "a wrong token", "a wrong token", context=secure, path="/?token=correct-horse-battery-stable")
        refused(panel, "a token that is too long", "a wrong token", context=secure, path=f"/?token={TOKEN}x")
        refused(panel, "another origin", "a page of another origin", context=secure,
                headers=[bearer, "Origin: https://elsewhere.example"])
        one = panel.client(context=secure, path=f"/?token={TOKEN}")
        two = panel.client(context=secure, headers=[bearer, "Origin: https://app.foxglove.dev"])
        refused(panel, "a third client of two", "too many clients", context=secure, headers=[bearer])
        one.subscribe("/tf")
        check(one.until(lambda: one.counts.get("/tf", 0) > 2), "over TLS, with its token, it is served")
        two.close()
        try:
            Client(panel.port).close()
            check(False, "without TLS: let in")
        except (Refused, ConnectionError, socket.timeout):
            check(True, "without TLS nobody speaks to it")
    with Panel(folder, "--for", "8") as panel:
        refused(panel, "another origin", "a page of another origin", headers=["Origin: http://127.0.0.1.evil.example"])
        refused(panel, "no subprotocol", "none of the subprotocols", protocol=None)
        try:
            Client(panel.port, protocol="chat").close()
            check(False, "another subprotocol: let in")
        except Refused:
            check(True, "another subprotocol is turned away")
        panel.client(headers=[f"Origin: http://localhost:{panel.port}"]).close()
        both = panel.client(", ".join(PROTOCOLS))
        check("Sec-WebSocket-Protocol: foxglove.sdk.v1" in both.head, "of two subprotocols offered, as browsers do, the first is spoken")
        both.close()
        with socket.create_connection(("127.0.0.1", panel.port)) as page:
            page.sendall(b"GET /connect HTTP/1.1\r\nHost: x\r\n\r\n")
            text = page.recv(4096).decode()
            page.settimeout(2)
            while "</code>." not in text:
                text += page.recv(4096).decode()
        check("200 OK" in text and f"ws://127.0.0.1:{panel.port}/" in text, "GET /connect says how to connect")
        code, _, errors = run("panel", panel.scenario, "-o", os.path.join(folder, "second"), "--port", panel.port)
        check(code == 1 and not fault_of_sentence(errors, "panel") and str(panel.port) in errors, f"a port in use: {errors.strip()}")


def test_refusals(folder):
    with Panel(folder) as panel:
        operator, other, watcher = (panel.client().keep_alive() for _ in range(3))
        watcher.subscribe("/tf", "/session")
        watcher.until(lambda: watcher.phase() == "ready")
        operator.order("TakeControl")
        ok, why = other.order("TakeControl")
        check(not ok and "holds control" in why, f"a second operator: {why}")
        check(operator.until(lambda: any("client 2 asks" in text["message"] for text in operator.texts)), "the first is told")
        ok, why = other.order("UserStop")
        check(not ok and logged(panel, "refused", client=2, request="UserStop"), f"an order of a watcher: {why}")
        ok, why = operator.order("Pause", call_id=1)
        check(not ok and "replayed" in why and logged(panel, "refused", client=1, why="replayed"), f"a call sent again: {why}")
        ok, why = operator.order(99)
        check(not ok and "no service" in why, f"a service that is not there: {why}")
        ok, why = operator.order("StartSim", now=True)
        check(not ok and "argument" in why, f"an argument that is none: {why}")
        for text in ("", "[]", "{\"op\":\"dance\"}", "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":1,\"channelId\":99}]}",
                     "\x00", "[" * 5000):
            seen = len(other.texts)
            other.send(1, text)
            check(other.until(lambda: len(other.texts) > seen) and other.texts[-1]["level"] == 2,
                  f"{text[:60]!r}: {other.texts[-1]['message']}")
        other.send(2, b"\x02\x01\0\0\0\x09\0\0\0\xff\xff\xff\xff")
        check(other.until(lambda: 9 in other.answers) and not other.answers[9][0], f"a call cut off: {other.answers.get(9)}")
        check(logged(panel, "refused", client=2, why="a message that is no JSON object"), "all of it is in the audit log")

        ok, answer = operator.order("ReleaseControl", to=77)
        check(not ok, f"control to nobody: {answer}")
        check(operator.order("ReleaseControl", to=2) == (True, {"operator": 2}), "control is handed over")
        check(not operator.order("StartSim")[0] and other.order("StartSim")[0], "it leads, the first does not")
        watcher.until(lambda: watcher.phase() == "simulating")
        ok, why = other.order("ReleaseControl")
        check(not ok and "Abort" in why, f"control is not laid down while the machine moves: {why}")
        other.close()
        check(watcher.until(lambda: watcher.phase() == "nothing is prepared", 5), f"its connection lost: {watcher.phase()}")
        check(logged(panel, "control", client=2, how="lost: UserStop"), "and that is in the log")
        check(operator.order("TakeControl")[0] and operator.order("Prepare")[0], "another takes it up")
        check(watcher.until(lambda: watcher.phase() == "ready", 5) and operator.order("StartSim")[0], "and goes on")
        check(operator.order("Abort")[0] and watcher.until(lambda: watcher.phase() == "ready", 5), "Abort")
        watcher.watch(0.1)
        check(operator.order("ReleaseControl") == (True, {"operator": 0}), "and lays it down")

        put_out = [
            ("a message of more than 65536 bytes", lambda c: c.send(1, "x" * 70000)),
            ("a message of more than 65536 bytes", lambda c: [c.socket.sendall(c.frame(i == 0, "x" * 30000, final=False)) for i in range(3)]),
            ("more than 50 messages", lambda c: c.socket.sendall(c.frame(1, '{"op":"getParameters","parameterNames":["/x"]}') * 130)),
            ("too many messages", lambda c: c.socket.sendall(c.frame(1, "{}") * 30)),
            ("", lambda c: c.socket.sendall(c.frame(5, "{}"))),
            ("", lambda c: c.socket.sendall(b"\x81\xff\xff\xff\xff\xff\xff\xff\xff\xff" + b"x" * 100)),
            ("", lambda c: c.socket.sendall(os.urandom(3000))),
        ]
        for words, act in put_out:
            client = panel.client()
            try:
                act(client)
            except ConnectionError:
                pass
            gone = client.until(lambda: client.closed is not None, 8)
            gone = gone and (not words or watcher.until(lambda: logged(panel, "disconnect", why=words), 5))
            check(gone, f"put out: {words or 'a frame that is none'} {client.closed}")
            client.close()
        slow, half, silent = panel.client(), panel.client(), panel.client()
        slow.socket.sendall(slow.frame(1, "{}" * 100)[:20])
        half.socket.sendall(half.frame(1, "{\"op\":", final=False))
        silent.order("TakeControl")
        begun, count = time.monotonic(), watcher.counts["/tf"]
        check(watcher.until(lambda: sum(line.get("how") == "lost: UserStop" for line in panel.audit()) == 2, 8),
              f"an operator who answers no ping loses control after {time.monotonic() - begun:.1f} s")
        check(watcher.until(lambda: logged(panel, "disconnect", why="too slow"), 8) and logged(panel, "refused", why="too slow"),
              f"a message that does not end is put out after {time.monotonic() - begun:.1f} s")
        expected = 20 * (time.monotonic() - begun)
        check(watcher.counts["/tf"] - count > 0.7 * expected, "all the while another is served")
        panel.process.send_signal(signal.SIGKILL)
        panel.process.communicate()
        lines = panel.audit()
        check([line["line"] for line in lines] == list(range(1, len(lines) + 1)), "the audit log is whole after SIGKILL")
        check(os.path.exists(os.path.join(panel.out, "recording.mcap.part")), "and what was recorded is kept")


def test_full_disk(folder):
    """Files of at most 4 KiB: what cannot be written into the audit log is not done, but for what stops the machine."""
    with Panel(folder, before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))) as panel:
        client = panel.client()
        client.subscribe("/session")
        client.until(lambda: client.phase() == "ready")
        client.order("TakeControl")
        for _ in range(30):
            ok, why = client.order("Resume")  # refused by the behaviour, as long as it is passed on
            if "audit" in why:
                break
        check(not ok and "audit log cannot be written" in why, f"an order that cannot be written: {why}")
        ok, why = client.order("StartSim")
        check(not ok and "audit" in why, f"StartSim: {why}")
        check(client.order("UserStop")[0] and client.until(lambda: client.phase() == "nothing is prepared", 3), "UserStop is obeyed")
        client.watch(0.2)
        with open(os.path.join(panel.out, "audit.jsonl")) as file:
            lines = file.read().split("\n")
        check(all(json.loads(line) for line in lines[:-1]), "the log's lines are whole but for the last")
        code, _, errors = panel.end()
        check(code == 1 and "recording.mcap" in errors, f"the recording is not whole: {code} {errors.strip()}")


def in_its_folder(test):
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        test(folder)
    print(f"{test.__name__}: {time.monotonic() - begun:.1f} s", flush=True)


def main():
    """All at once, for they mostly wait."""
    with concurrent.futures.ThreadPoolExecutor() as pool:
        for done in [pool.submit(in_its_folder, test) for test in (test_session, test_replay, test_ground, test_door, test_refusals,
                                                               test_full_disk)]:
            done.result()
    finish()


if __name__ == "__main__":
    main()
