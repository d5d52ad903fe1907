"""teledimos simulate with a task. The paper's experiment as typed: the goal and the law are read back from the log (against the
quintic written out), the tool's places from its joints (against kinematics written here from the URDF's figures, to the
log's ten digits), the error that stays is the suspension's: locked it is less than 1 % of itself, and with a gain too small
it is not. The same bytes again, from --replay of either log, and of a live session led by keys through a terminal. A stall
(SIGSTOP) triggers each policy. Orders, press, singular and unreachable goals; bad tasks and logs are named.

Blind to: how like a real machine it moves; jitter on a machine of its own (the bounds here allow for a busy one)."""

import csv
import json
import math
import os
import pty
import re
import select
import signal
import subprocess
import tempfile
import time

import numpy

from common import FULL, PROGRAM, SANITIZED, SOURCE, check, finish, refused, run

EXAMPLE = os.path.join(SOURCE, "datasets/zx200/paper.yaml")
ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
HEAD = (f"teledimos: scenario 1\nname: test\nrobot: {ROBOT}\n"
        "start: {joints: {swing: 0, boom: -0.5, arm: 1.6, bucket: 0.6}}\n")
GOAL = "task: {name: t, steps: [{position: {to: {x_m: 7.5, y_m: 1.0, z_m: 1.5}, law: quintic, duration_s: %g}}]}\n"
PRODUCTS = ("trajectory.csv", "events.csv", "recording.mcap")


def write(path, text):
    with open(path, "w") as file:
        file.write(text)
    return path


def simulate(scenario, out, *options, status=0):
    code, text, errors = run("simulate", scenario, "-o", out, "--json", *options)
    if code != status:
        check(False, f"simulate {scenario} {' '.join(options)}: status {code} {errors.strip()}")
        finish()
    return json.loads(text)


def log_of(out):
    with open(os.path.join(out, "trajectory.csv"), newline="") as file:
        return [{k: v if k == "phase" else float(v) if v else math.nan for k, v in row.items()} for row in csv.DictReader(file)]


def same(one, two):
    for name in PRODUCTS:
        with open(os.path.join(one, name), "rb") as a, open(os.path.join(two, name), "rb") as b:
            if a.read() != b.read():
                return False
    return True


def named(result, kind):
    return [(e["name"], e["text"]) for e in result["events"] if e["kind"] == kind]


def turn(axis, angle):
    c, s = math.cos(angle), math.sin(angle)
    return numpy.array({"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
                        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}[axis])


def base_of(row):
    return (turn("z", row["base_yaw_rad"]) @ turn("y", row["base_pitch_rad"]) @ turn("x", row["base_roll_rad"]),
            numpy.array([row["base_x_m"], row["base_y_m"], row["base_z_m"]]))


def tip_of(row):
    """The bucket's tip in the vehicle: swing axis, boom pin and lengths as zx200.urdf has them."""
    at = numpy.array([1.562, 0, 0])
    for name, origin in (("bucket", [2.889, 0, 0]), ("arm", [5.648, 0, 0]), ("boom", [0.228, -0.040, 0.837])):
        at = numpy.array(origin) + turn("y", row[f"{name}_rad"]) @ at
    return numpy.array([0.108, -0.034, 1.121]) + turn("z", row["swing_rad"]) @ at


def test_paper(folder):
    out = os.path.join(folder, "paper")
    result, log = simulate(EXAMPLE, out), None
    log = log_of(out)
    check(result["verdict"] == "accepted" and result["simulation_s"] == 6 and result["control"] == {"period_s": 0.05, "gain_1_s": 3}
          and result["trajectory_s"] == 4, "the paper's experiment: T_sim 6 s, K 3, 50 ms, accepted")
    rotation, origin = base_of(log[0])
    begin, goal = rotation @ tip_of(log[0]) + origin, rotation @ numpy.array([7.5, 2.0, 1.5]) + origin
    law = kinematics = 0
    for row in log:
        u = min(row["time_s"] / 4, 1)
        wanted = begin + (10 * u**3 - 15 * u**4 + 6 * u**5) * (goal - begin)
        law = max(law, numpy.abs(wanted - [row[f"desired_{k}_m"] for k in "xyz"]).max())
        rotation, origin = base_of(row)
        kinematics = max(kinematics, numpy.abs(rotation @ tip_of(row) + origin - [row[f"actual_{k}_m"] for k in "xyz"]).max())
    check(law < 1e-3, f"desired X, Y, Z follow the quintic to the goal within {1e3 * law:.3f} mm")
    check(kinematics < 1e-7, f"actual X, Y, Z are where the joints and the base put them, to {kinematics:.0e} m")
    steady, locked = result["steady_error_m"], result["steady_error_locked_m"]
    check(len(log) == 121 and abs(log[-1]["deviation_m"] - steady) < 1e-9 and 5e-4 < steady < 0.05,
          f"an error of {1e3 * steady:.2f} mm stays")
    check(locked <= 0.01 * steady and result["joint_error_rad"] < 1e-4,
          f"it is the suspension's: {1e3 * locked:.4f} mm when that is locked")
    for joint in ("swing", "arm"):
        off = max(abs(row[f"{joint}_rad"] - row[f"{joint}_desired_rad"]) for row in log)
        check(1e-5 < off < 0.02, f"joint {joint} follows within {1e3 * off:.1f} mrad")
    check(result["real_time_factor"] > (2 if SANITIZED else 20) and result["deadline_misses"] == 0 and result["f_calls"] > 100,
          f"{result['real_time_factor']:.0f} times real time, {result['f_calls']} calls, {result['method_switches']} switches")
    with open(os.path.join(out, "report.html")) as file:
        report = file.read()
    check(all(word in report for word in (">X<", ">Y<", "joint 1: swing", "joint 3: arm", "suspension locked")), "its report has the figures")
    with open(os.path.join(out, "recording.mcap"), "rb") as file:
        recording = file.read()
    check(all(word in recording for word in (b"foxglove.FrameTransforms", b"foxglove.SceneUpdate", b"/tool/desired", b"/inputs")),
          "its recording has Foxglove's schemas")
    slack = simulate(EXAMPLE, os.path.join(folder, "slack"), "--gain", "0.5")
    check(slack["steady_error_locked_m"] > 0.01 * slack["steady_error_m"], "a gain too small leaves an error of its own")
    for name, options in (("again", ()), ("csv", ("--replay", out + "/events.csv")), ("mcap", ("--replay", out + "/recording.mcap"))):
        simulate(EXAMPLE, os.path.join(folder, name), *options)
        check(same(out, os.path.join(folder, name)), f"the same bytes: {name}")
    refused("a log of another scenario", 1, ["another scenario", "events.csv"], EXAMPLE, "--gain", "2", "--replay", out + "/events.csv",
            command="simulate")
    return out


def test_session(folder):
    '''Orders written in the scenario; abort, jog, reinit; the second run is the first again.'''
    orders = ["1, order: Pause", "5, order: Resume", "6, order: Abort", "6.5, order: Manual",
              "7, order: Jog, joint: boom, stick: -0.5, for_s: 1", "9, order: Automatic", "9.1, order: Reinit", "10, order: StartSim"]
    scene = write(os.path.join(folder, "session.yaml"), HEAD + "duration_s: 3\nlog_s: 0.05\n" + GOAL % 2.5 +
                  "operator:\n" + "".join(f"  - {{at_s: {order}}}\n" for order in orders))
    out = os.path.join(folder, "session")
    result, log = simulate(scene, out), None
    log = log_of(out)
    phases = [text for name, text in named(result, "phase")]
    for word in ("the simulation is paused", "manual: moved by the operator's hand", "simulated to the end"):
        check(word in phases, f"it was {word}")
    held = [row for row in log if 4.5 <= row["time_s"] < 5]
    check(max(abs(row["swing_rad"] - held[0]["swing_rad"]) for row in held) < 1e-4 and
          0.1 < held[0]["swing_rad"] / log[-1]["swing_rad"] < 0.9, "a pause holds, on the way")
    by_hand = [row["boom_rad"] for row in log if 7 <= row["time_s"] <= 9]
    check(-0.13 < by_hand[-1] - by_hand[0] < -0.03, f"the boom was moved by hand, {by_hand[-1] - by_hand[0]:.3f} rad")
    check(result["time_s"] == 13 and result["steps_done"] == 1 and result["verdict"] == "accepted",
          f"prepared anew it simulates to the end, {result['verdict']} {result['reasons']}")
    plain = simulate(write(os.path.join(folder, "plain.yaml"), HEAD + "duration_s: 3\nlog_s: 0.05\n" + GOAL % 2.5),
                     os.path.join(folder, "plain"))
    check(abs(result["steady_error_m"] - plain["steady_error_m"]) < 1e-5, "and comes to what a first run comes to")
    simulate(scene, os.path.join(folder, "session2"), "--replay", out + "/recording.mcap")
    check(same(out, os.path.join(folder, "session2")), "a session replays, the same bytes")


def test_press(folder):
    scene = write(os.path.join(folder, "press.yaml"), HEAD + "duration_s: 14\ncontact: {link: bucket_tip, plane_m: [0, 0, 0.3]}\ntask:\n"
                  "  name: p\n  tool: {link: bucket_tip}\n  tolerance: {force_n: 500}\n  steps:\n"
                  "    - position: {to: {x_m: 6.6, y_m: 0, z_m: 0.4, pitch_deg: 70}, via: [{x_m: 6.5, y_m: 0, z_m: 0.6, pitch_deg: 75}]}\n"
                  "    - press: {axis: [0, 0, -1], force_n: 20000, for_s: 1, approach_speed_m_s: 0.05}\n    - wait: {for_s: 0.5}\n"
                  "    - position: {joints: {boom_deg: -35}, law: quintic, duration_s: 3}\n")
    out = os.path.join(folder, "press")
    result, log = simulate(scene, out), None
    log = log_of(out)
    force = [row["contact_n"] for row in log if row["step"] == 3]
    check(result["steps_done"] == 4 and min(force) > 0.95 * 20e3 and max(force) < 1.05 * 20e3,
          f"it presses with {min(force) / 1e3:.2f} to {max(force) / 1e3:.2f} kN of 20, and leaves")
    check(log[-1]["contact_n"] == 0 and abs(math.degrees(log[-1]["boom_rad"]) + 35) < 0.1, "the last step lifts it off")
    with open(scene) as file:
        far = file.read().replace("z_m: 0.4", "z_m: 0.6").replace("0.05}\n", "0.05, most_travel_m: 0.1}\n", 1)
    result = simulate(write(os.path.join(folder, "far.yaml"), far), out, status=3)
    check(result["phase"].startswith("failed") and "most_travel_m" in result["reasons"][0], f"no ground: {result['reasons'][0]}")


def test_site(folder):
    '''A goal in the site, the machine turned and shifted in it: the plan ends there, attitude and all.'''
    text = HEAD.replace("bucket: 0.6}}", "bucket: 0.6}, base: {q: [0.7071067811865476, 0, 0, 0.7071067811865476], t_m: [3, 2, 1]}}")
    scene = write(os.path.join(folder, "site.yaml"), text + "duration_s: 14\ntask: {name: t, frame: site, limits: {speed_m_s: 0.4}, steps: "
                  "[{position: {to: {x_m: 2, y_m: 9.5, z_m: 2.5, pitch_deg: 70}}}]}\n")
    out = os.path.join(folder, "site")
    simulate(scene, out)
    log = log_of(out)
    ends = [log[-1][f"desired_{k}"] for k in ("x_m", "y_m", "z_m", "pitch_rad")]
    check(numpy.allclose(ends, [2, 9.5, 2.5, math.radians(70)], atol=1e-6), "a goal in the site is where it is asked")
    speed = max(math.dist(*([row[f"desired_{k}_m"] for k in "xyz"] for row in pair)) / 0.05 for pair in zip(log, log[1:]))
    check(0.3 < speed < 0.4 * 1.01, f"and the tool keeps its limit, {speed:.3f} of 0.4 m/s")


def test_singular(folder):
    '''To a point 54 mm beside the swing's axis, where the tool can hardly move across.'''
    text = HEAD.replace("boom: -0.5, arm: 1.6, bucket: 0.6", "boom: 0.7, arm: 2.3, bucket: 0.2") + "duration_s: 12\non_singularity: %s\n" \
        "task: {name: t, steps: [{position: {to: {x_m: 0.108, y_m: 0.02, z_m: -1.7}}}]}\n"
    for policy, status, phase in (("cross", 0, "simulated to the end"), ("fail", 3, "failed: waiting for Reinit")):
        result = simulate(write(os.path.join(folder, "s.yaml"), text % policy), os.path.join(folder, "singular-" + policy), status=status)
        check(result["phase"] == phase and "singularity" in dict(named(result, "report")), f"on_singularity {policy}: {result['phase']}")


def test_unreachable(folder):
    scene = write(os.path.join(folder, "far.yaml"), HEAD + "duration_s: 3\n" + GOAL.replace("7.5", "9.9").replace("y_m: 1.0", "y_m: 2.5") % 2)
    result = simulate(scene, os.path.join(folder, "far"), status=3)
    check(result["steps_done"] == 0 and "nearest place" in result["reasons"][0] and result["steady_error_m"] is None,
          f"out of reach: {result['reasons'][0]}")
    scene = write(os.path.join(folder, "quick.yaml"), HEAD + "duration_s: 3\n" + GOAL % 0.5)
    result = simulate(scene, os.path.join(folder, "quick"), status=3)
    check(re.search(r"takes [12]\.\d+ s", result["reasons"][0]), f"too quick: {result['reasons'][0]}")
    scene = write(os.path.join(folder, "short.yaml"), HEAD + "duration_s: 2\n" + GOAL % 4)
    check("1 of 1 steps" in simulate(scene, os.path.join(folder, "short"), status=3)["reasons"][0], "a simulation shorter than its task")


# ---- real time ----

def start(scene, out, *options):
    return subprocess.Popen([PROGRAM, "simulate", scene, "-o", out, "--json", "--live", *options], stdin=subprocess.DEVNULL,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_stall(folder):
    '''Stopped for 0.6 s: the tolerance of 0.2 s forgives a busy machine, not that.'''
    scene = write(os.path.join(folder, "live.yaml"), HEAD + "duration_s: 3\nlive: {tolerance_s: 0.2}\n" + GOAL % 2.5)
    outs = {name: os.path.join(folder, "live-" + name) for name in ("stop", "catch-up", "slip")}
    begun = time.monotonic()
    jobs = {name: start(scene, out, "-v", "--on-miss", name) for name, out in outs.items()}
    for job in jobs.values():
        while "real time begins" not in (job.stderr.readline() or "real time begins"):
            pass
    time.sleep(1)
    for job in jobs.values():
        os.kill(job.pid, signal.SIGSTOP)
    time.sleep(0.6)
    for job in jobs.values():
        os.kill(job.pid, signal.SIGCONT)
    results, took = {}, {}
    for name, job in jobs.items():
        results[name] = json.loads(job.communicate(timeout=120)[0])
        took[name] = time.monotonic() - begun
    stop, catch, slip = (results[name] for name in outs)
    check(jobs["stop"].returncode == 3 and stop["phase"].startswith("failed") and "deadline" in stop["fault"] and
          stop["deadline_misses"] >= 1, f"stop: {stop['reasons'][:1]}")
    last = log_of(outs["stop"])[-1]
    # The valves are shut; the boom still swings on its oil and the suspension, by 8 mrad/s where it moved with 50.
    check(all(abs(last[f"{k}_rate_rad_s"]) < 0.02 for k in ("swing", "boom", "arm", "bucket")) and
          not any(value for key, value in last.items() if "_command_" in key), "and the machine was braked")
    check(jobs["catch-up"].returncode == 0 and catch["live"]["slipped_s"] == 0 and catch["deadline_misses"] >= 2 and
          catch["live"]["ticks"] == 60, f"catch-up: {catch['deadline_misses']} late ticks follow at once")
    check(jobs["slip"].returncode == 0 and 0.3 < slip["live"]["slipped_s"] and took["slip"] > 3.3,
          f"slip: behind by {slip['live']['slipped_s']:.2f} s")
    check(all(0.2 < r["live"]["late_max_s"] < 2 for r in results.values()), "the lateness is told")
    for name, out in outs.items():
        simulate(scene, out + "2", "--on-miss", name, "--replay", out + "/events.csv", status=3 if name == "stop" else 0)
        check(same(out, out + "2"), f"{name}: replayed, missed deadlines and all, the same bytes")


def test_fast(folder):
    length = 60 if FULL else 4
    scene = write(os.path.join(folder, "fast.yaml"), HEAD + f"duration_s: {length}\ncontrol: {{period_s: 0.001}}\n" + GOAL % 2.5)
    begun = time.monotonic()
    job = start(scene, os.path.join(folder, "fast"), "--on-miss", "catch-up")
    result = json.loads(job.communicate(timeout=200)[0])
    took, live = time.monotonic() - begun, result["live"]
    check(live["ticks"] == 1000 * length and length <= took < length + (60 if SANITIZED else 15), f"1 kHz for {length} s: {live['ticks']} ticks")
    check(0 <= live["late_p50_s"] <= live["late_p99_s"] and live["late_mean_s"] <= live["late_max_s"],
          f"{result['deadline_misses']} missed by 5 ms; late by {1e6 * live['late_p50_s']:.0f} us in the median, "
          f"{1e3 * live['late_p99_s']:.2f} ms (99 %), {1e3 * live['late_max_s']:.2f} ms at most; {100 * live['cpu_share']:.0f} % of a processor")
    check(SANITIZED or live["cpu_share"] < 0.6, "with time to spare")


def test_keys(folder):
    '''A terminal of its own; each key when the session is where it belongs.'''
    scene = write(os.path.join(folder, "keys.yaml"), HEAD + "duration_s: 2\nlive: {on_miss: slip}\n" + GOAL % 1.9)
    out = os.path.join(folder, "keys")
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(PROGRAM, [PROGRAM, "simulate", scene, "-o", out, "--live"])
    text, keys, end = "", [("simulating", " "), ("paused", " "), ("simulating", "a"), ("ready", "m"), ("manual", "\x1b[A"), ("manual", "m"),
                           ("ready", "s"), ("simulated to the end", "q")], time.monotonic() + 60
    while time.monotonic() < end:
        if select.select([terminal], [], [], 0.05)[0]:
            try:
                text += os.read(terminal, 4096).decode(errors="replace")
            except OSError:
                break
        if keys and keys[0][0] in text:
            time.sleep(0.5)
            os.write(terminal, keys.pop(0)[1].encode())
            text = ""
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    check(code == 0 and not keys and "verdict" in text, f"keys lead a session (status {code}, {len(keys)} left)")
    with open(os.path.join(out, "events.csv"), newline="") as file:
        orders = [row["name"] for row in csv.DictReader(file) if row["kind"] == "order"]
    short = [name for i, name in enumerate(orders) if i == 0 or name != orders[i - 1]]
    check(short == ["Pause", "Resume", "Abort", "Manual", "Jog", "Automatic", "StartSim", "UserStop"], f"orders: {' '.join(short)}")
    simulate(scene, out + "2", "--replay", out + "/events.csv")
    check(same(out, out + "2"), "and the session replays, the same bytes")


# ---- what is refused ----

def test_bad(folder, log):
    rest = "duration_s: 3\n"

    def bad(what, words, text, *options, status=1):
        refused(what, status, words, write(os.path.join(folder, "bad.yaml"), HEAD + rest + text), *options, command="simulate")

    def step(text):
        return "task: {name: t, steps: [" + text + "]}\n"

    bad("a task that is not there", ["none.yaml"], "task: none.yaml\n")
    write(os.path.join(folder, "t.yaml"), "teledimos: task 1\nname: t\nsteps:\n  - position: {to: {x_m: 7, y_m: 0, zz_m: 1}}\n")
    bad("an unknown key", ["t.yaml:4", "zz_m", "z_m"], "task: t.yaml\n")
    bad("no steps", ["task: steps"], "task: {name: t}\n")
    bad("a number that is none", ["steps[0].wait.for_s"], step("{wait: {for_s: .nan}}"))
    bad("an unknown joint", ["steps[0]", "bom"], step("{position: {joints: {bom_deg: 3}}}"))
    bad("a goal beyond reach", ["steps[0]", "stretched out"], step("{position: {to: {x_m: 70, y_m: 0, z_m: 1}}}"))
    bad("attitudes that differ", ["via[0]", "attitude"],
        step("{position: {to: {x_m: 7, y_m: 0, z_m: 1}, via: [{x_m: 6, y_m: 0, z_m: 1, pitch_deg: 60}]}}"))
    bad("a drive", ["steps[0]", "drive"], step("{drive: {distance_m: 1}}"))
    bad("a motion besides", ["motion"], "motion: {kind: hold}\n" + step("{wait: {for_s: 1}}"))
    wait = step("{wait: {for_s: 1}}")
    bad("a contact of no link", ["contact.link", "spoon"], "contact: {link: spoon, plane_m: [0, 0, 0]}\n" + wait)
    bad("an unknown order", ["operator[0].order", "Halt", "Abort"], "operator: [{at_s: 1, order: Halt}]\n" + wait)
    bad("orders that go back", ["operator[1].at_s"], "operator: [{at_s: 1, order: Pause}, {at_s: 0, order: Resume}]\n" + wait)
    bad("an unknown policy", ["live.on_miss", "slip"], "live: {on_miss: panic}\n" + wait)
    bad("a gain that swings up", ["bad.yaml", "gain of 60"], "control: {gain_1_s: 60}\n" + wait)
    bad("a sweep", ["--sweep"], wait, "--sweep", status=2)
    bad("live and replay", ["--live", "--replay"], wait, "--live", "--replay", "x.csv", status=2)
    bad("a log that is not there", ["none.csv"], wait, "--replay", os.path.join(folder, "none.csv"))
    refused("live of a motion", 2, ["--live", "task"], os.path.join(SOURCE, "datasets/zx200-motion"), "--live", command="simulate")
    with open(log + "/events.csv") as file:
        text = file.read()
    rows = text.splitlines(keepends=True)
    for what, words, changed in (("a log without its end", ["cut off"], "".join(rows[:-1])),
                                 ("a log of another kind", ["'kind'"], text.replace("kind", "kond", 1)),
                                 ("a log without its scenario", ["begin with its scenario"], rows[0] + "".join(rows[2:])),
                                 ("a log of another scenario", ["another scenario"], text.replace("scenario,", "scenario,0", 1)),
                                 ("an order that is none", ["cut.csv:3", "Halt"], "".join(rows[:2]) + '0,0.0,order,Halt,,,""\n' + "".join(rows[2:])),
                                 ("a jog of no joint", ["cut.csv:3", "Jog"], "".join(rows[:2]) + '0,0.0,order,Jog,nose,1,""\n' + "".join(rows[2:]))):
        refused(what, 1, ["cut.csv", *words], EXAMPLE, "--replay", write(os.path.join(folder, "cut.csv"), changed), command="simulate")
    with open(log + "/recording.mcap", "rb") as file:
        whole = file.read()
    with open(os.path.join(folder, "cut.mcap"), "wb") as file:
        file.write(whole[:len(whole) // 2])
    refused("half a recording", 1, ["cut.mcap"], EXAMPLE, "--replay", os.path.join(folder, "cut.mcap"), command="simulate")


with tempfile.TemporaryDirectory() as place:
    made = test_paper(place)
    test_session(place)
    test_press(place)
    test_site(place)
    test_singular(place)
    test_unreachable(place)
    test_stall(place)
    test_fast(place)
    test_keys(place)
    test_bad(place, made)
    finish()
