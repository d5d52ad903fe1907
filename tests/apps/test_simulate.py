"""teledimos simulate: the worked example as typed, its log against its result; a given flow moves the boom by the lever arm of
its cylinder (geometry from the data file, by hand); free motion keeps its energy; the same bytes again; a loop closed around
the motion follows better; sweeps find the loop unstable where it must be; stops, limits, gate, interrupt and bad input."""

import csv
import json
import math
import os
import signal
import subprocess
import tempfile
import time

from common import PROGRAM, SANITIZED, SOURCE, check, finish, refused, run

EXAMPLE = os.path.join(SOURCE, "datasets/zx200-motion")
ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
START = "start: {joints: {boom: -0.4, arm: 1.4, bucket: 0.4}}\n"
HEAD = f"teledimos: scenario 1\nname: test\nrobot: {ROBOT}\n"


def write(folder, text, table=None, name="scenario.yaml"):
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, name), "w") as file:
        file.write(text)
    if table is not None:
        with open(os.path.join(folder, "commands.csv"), "w") as file:
            file.write(table)
    return folder


def log_of(out):
    with open(os.path.join(out, "log.csv"), newline="") as file:
        return [{key: value if key == "method" else float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def simulate(scenario, out, *options, status=0):
    code, text, errors = run("simulate", scenario, "-o", out, "--json", *options)
    if code != status:
        check(False, f"simulate {scenario}: status {code} {errors.strip()}")
        finish()
    return json.loads(text), log_of(out)


def test_example(folder):
    out = os.path.join(folder, "x")
    result, log = simulate(EXAMPLE, out)
    check(result["verdict"] == "accepted" and abs(result["base"]["sag_mm"] - 15.464) < 0.01,
          f"the example is accepted, sags {result['base']['sag_mm']:.2f} mm")
    factor, floor = result["real_time_factor"], 5 if SANITIZED else 100
    check(factor > floor, f"{factor:.0f} times real time (goal 500 on a processor of its own)")
    check(len(log) == 301 and log[-1]["time_s"] == 6 and log[-1]["boom_rad"] == round(result["joints"]["boom"]["end_rad"], 9) or
          abs(log[-1]["boom_rad"] - result["joints"]["boom"]["end_rad"]) < 1e-8, "the log ends where the result does")
    for name, rate in (("swing", 0.2), ("boom", -0.1), ("arm", 0.15), ("bucket", 0.25)):
        joint = result["joints"][name]
        check(abs(joint["wanted_rad"] - joint["start_rad"] - 5 * rate) < 1e-9 and abs(joint["error_rad"]) < 0.01,
              f"{name} ends {1e3 * joint['error_rad']:+.1f} mrad from the trapezoid's integral")
    with open(os.path.join(out, "report.html")) as file:
        report = file.read()
    check(report.count("<svg") >= 10 and "BDF" in report, "the report has its plots")
    other = os.path.join(folder, "again")
    simulate(EXAMPLE, other)
    with open(os.path.join(out, "log.csv"), "rb") as one, open(os.path.join(other, "log.csv"), "rb") as two:
        check(one.read() == two.read(), "the same bytes again")
    _, finer = simulate(EXAMPLE, other, "--relative", "1e-9")
    apart = max(abs(a[k] - b[k]) for a, b in zip(log, finer) for k in ("swing_rad", "boom_rad", "arm_rad", "bucket_rad"))
    check(apart < 3e-5, f"at a tolerance of 1e-9 the motion is {apart:.1e} rad apart")
    for method in ("adams", "bdf"):
        _, by = simulate(EXAMPLE, other, "--method", method)
        check(abs(by[-1]["boom_rad"] - finer[-1]["boom_rad"]) < 3e-5 and by[-1]["method"] == method, f"{method} comes to the same")
    table = "time_s,boom_rad_s,bucket_rad_s\n0,0,0\n1,-0.1,0.25\n5,-0.1,0.25\n6,0,0\n"
    ends = []
    for control in ("", "control: {gain_1_s: 3, period_s: 0.05}\n"):
        scene = write(os.path.join(folder, "loop"), HEAD + START + "duration_s: 9\nmotion: {kind: table, file: commands.csv}\n" + control,
                      table)
        ends.append(simulate(scene, other)[0]["joints"])
    open_loop, closed = (max(abs(end[k]["error_rad"]) for k in ("boom", "bucket")) for end in ends)
    check(closed < 2e-4 and closed < open_loop / 5,
          f"a closed loop ends {1e3 * closed:.3f} mrad from what was wanted, an open one {1e3 * open_loop:.2f}")


def lever(angle):
    """d length / d angle of the boom's cylinder, from the pin's frame: root (0.462, -0.603), eye (2.2342, 0.9507)."""
    x = 2.2342 * math.cos(angle) + 0.9507 * math.sin(angle)
    z = 0.9507 * math.cos(angle) - 2.2342 * math.sin(angle)
    dx, dz = x - 0.462, z + 0.603
    return (dx * z - dz * x) / math.hypot(dx, dz)


def test_flow(folder):
    """10 ml/s up over a second, then a steady flow: rate = flow / area / lever."""
    scene = write(os.path.join(folder, "flow"), HEAD + START + "duration_s: 4\nmachine: {base: fixed, oil_n_m: 1e10}\n"
                  "motion: {kind: table, command: flow, file: commands.csv}\n",
                  "time_s,boom_m3_s,swing_rad_s\n0,0,0\n1,-0.0015,0.1\n3,-0.0015,0.1\n4,0,0\n")
    _, log = simulate(scene, os.path.join(folder, "flow-out"))
    area = 2 * math.pi / 4 * 0.12 ** 2
    worst = 0
    for row in log:
        if 1.5 < row["time_s"] < 3:
            worst = max(worst, abs(row["boom_rate_rad_s"] / (0.0015 / area / lever(row["boom_rad"])) - 1))
    check(worst < 2e-3, f"flow over area over lever arm is the boom's rate to {worst:.1e}")
    check(log[-1]["boom_rad"] < -0.6 and abs(log[-1]["arm_rad"] - 1.4) < 1e-3, "the boom rose, the arm held")
    check(abs(log[100]["boom_pressure_pa"] * area - log[100]["boom_force_n"]) < 1, "force is pressure times the bore's area")


def test_free(folder):
    scene = write(os.path.join(folder, "free"), HEAD + "start: {joints: {boom: -0.4, arm: 1.4, bucket: 0.4}, "
                  "rates: {swing: 0.3, arm: 0.1}}\nduration_s: 2\ngravity_m_s2: [0, 0, 0]\nintegrator: {relative: 1e-10}\n"
                  "machine: {hydraulics: false, base: floating, friction: 0}\n")
    result, log = simulate(scene, os.path.join(folder, "free-out"))
    kinetic = [row["kinetic_j"] for row in log]
    check(result["motion"] == "free" and kinetic[0] > 100 and max(kinetic) - min(kinetic) < 1e-7 * kinetic[0],
          f"afloat without friction the kinetic energy stays, {(max(kinetic) - min(kinetic)) / kinetic[0]:.1e}")
    hold = write(os.path.join(folder, "hold"), HEAD + START + "duration_s: 20\nmotion: {kind: hold}\n")
    _, log = simulate(hold, os.path.join(folder, "hold-out"))
    check(all(abs(row["boom_rad"] + 0.4) < 1e-6 and abs(row["base_z_m"] - log[0]["base_z_m"]) < 1e-6 for row in log), "it holds")
    sine = write(os.path.join(folder, "sine"), HEAD + START +
                 "duration_s: 4\nmotion: {kind: sine, frequency_hz: 0.5, joints: {bucket: 0.3}}\n")
    _, log = simulate(sine, os.path.join(folder, "sine-out"))
    top = max(row["bucket_rad"] for row in log)
    check(abs(top - 0.4 - 2 * 0.3 / math.pi) < 0.02, f"a sine of rates reaches {top - 0.4:.3f} rad")


def test_stops_and_gate(folder):
    scene = write(os.path.join(folder, "stop"), HEAD + START +
                  "duration_s: 3\nmotion: {kind: step, command: rate, at_s: 0.2, joints: {boom: -0.44}}\n")
    out = os.path.join(folder, "stop-out")
    result, log = simulate(scene, out)
    check(result["verdict"] == "warned" and any("stop" in reason for reason in result["reasons"]) and
          result["events"][0]["joint"] == "boom" and result["events"][0]["what"] == "met", "a stop that is met is a remark, and an event")
    check(min(row["boom_rad"] for row in log) > -1.137 - 0.003 and
          max(abs(row["boom_force_n"]) for row in log) <= result["joints"]["boom"]["force_limit_n"] * (1 + 1e-9), "stop and limit hold")
    check(run("simulate", scene, "-o", out, "--gate", "stops=0")[0] == 3, "--gate stops=0 refuses it")
    check(run("simulate", scene, "-o", out, "--gate", "stops=0", "--accept")[0] == 0, "--accept overrides")


def test_compiled(folder):
    '''Another robot: its equations evaluated, or generated and compiled, give the same motion; no compiler is named.'''
    with open(ROBOT) as file:
        urdf = file.read().replace('value="660"', 'value="900"')
    with open(ROBOT.replace(".urdf", ".yaml")) as file:
        cylinders = file.read()
    scene = write(os.path.join(folder, "heavy"), urdf, name="heavy.urdf")
    write(scene, cylinders, name="heavy.yaml")
    write(scene, "teledimos: scenario 1\nname: heavy\nrobot: heavy.urdf\n" + START +
          "duration_s: 2\nmotion: {kind: trapezoid, joints: {boom: -0.1, bucket: 0.2}}\n")
    code = os.path.join(folder, "code")
    slow, evaluated = simulate(scene, os.path.join(folder, "heavy-out"))
    fast, compiled = simulate(scene, os.path.join(folder, "heavy-out"), "--compile", code)
    apart = max(abs(a[k] - b[k]) for a, b in zip(evaluated, compiled) for k in ("boom_rad", "bucket_rad", "base_z_m"))
    check(len(evaluated) == len(compiled) == 101 and apart < 1e-8 and os.listdir(code),
          f"compiled and evaluated are {apart:.0e} apart, {slow['real_time_factor']:.0f} and {fast['real_time_factor']:.0f} times real time")
    refused("no compiler", 1, ["/nowhere/cc"], scene, "--compile", os.path.join(folder, "none"), command="simulate",
            env={"CC": "/nowhere/cc"})


def test_sweep(folder):
    result, _ = simulate(EXAMPLE, os.path.join(folder, "sweep"), "--sweep")
    sweep = result["sweep"]
    stable = {row["period_s"]: row["stable"] for row in sweep["period"]}
    check(stable[0.05] and not stable[1.2] and 0.2 <= sweep["stable_period_s"] < 1.2,
          f"the paper's 50 ms are stable, the limit is at {sweep['stable_period_s']} s")
    gains = {row["gain_1_s"]: row for row in sweep["gain"]}
    check(gains[3]["stable"] and not gains[30]["stable"] and gains[30]["rates"] > 1.5 * gains[3]["rates"],
          f"a gain of 30 is not stable and costs {gains[30]['rates'] / gains[3]['rates']:.1f} times the calls of 3")
    rates = [row["rates"] for row in sweep["oil"]]
    check(max(rates) < 4 * min(rates), f"calls over oil from 1e6 to 1e10 N/m: {rates}")
    check(0 < sweep["coriolis_apart_rad"] < 0.01, f"Coriolis terms: {1e3 * sweep['coriolis_apart_rad']:.3f} mrad")


def test_interrupted(folder):
    scene = write(os.path.join(folder, "long"), HEAD + START + "duration_s: 20000\nlog_s: 1\n"
                  "motion: {kind: sine, frequency_hz: 0.5, joints: {bucket: 0.3}}\n")
    out = os.path.join(folder, "long-out")
    job = subprocess.Popen([PROGRAM, "simulate", scene, "-o", out], stderr=subprocess.PIPE, text=True, start_new_session=True)
    time.sleep(1)
    os.killpg(job.pid, signal.SIGINT)
    errors = job.communicate(timeout=60)[1]
    check(job.returncode == 1 and "interrupted" in errors and not os.path.exists(out), f"SIGINT leaves nothing: {errors.strip()}")


def test_bad(folder):
    def bad(what, words, text, table=None, status=1, *options):
        refused(what, status, words, write(os.path.join(folder, "bad"), HEAD + text, table), *options, command="simulate")

    refused("no scenario", 1, ["none"], os.path.join(folder, "none"), command="simulate")
    refused("another duration of a trapezoid", 2, ["trapezoid", "duration_s"], EXAMPLE, "--duration", "9", command="simulate")
    refused("no argument", 2, ["SCENARIO is missing"], command="simulate")
    rest = "duration_s: 2\nmotion: {kind: hold}\n"
    moved = START + "duration_s: 2\nmotion: {kind: %s}\n"
    bad("an unknown key", ["motoin"], START + "duration_s: 2\nmotoin: {kind: hold}\n")
    bad("an unknown joint", ["bom", "boom"], "start: {joints: {bom: 1}}\n" + rest)
    bad("a start beyond its stops", ["'boom' at -2", "beyond its stops"], "start: {joints: {boom: -2}}\n" + rest)
    bad("no motion", ["motion"], START + "duration_s: 2\n")
    bad("a command beyond limits", ["'boom'", "0.45"], moved % "step, joints: {boom: 1}")
    bad("a controller of flows", ["rates"], moved % "step, command: flow, joints: {boom: 0.001}" + "control: {gain_1_s: 3}\n")
    table = moved % "table, command: flow, file: commands.csv"
    bad("a wrong unit", ["boom_rad_s", "m3_s"], table, "time_s,boom_rad_s\n0,0\n")
    bad("no number in a table", ["commands.csv:3", "boom_m3_s"], table, "time_s,boom_m3_s\n0,0\n1,nan\n")
    bad("times that go back", ["commands.csv:4"], table, "time_s,boom_m3_s\n0,0\n2,0\n1,0\n")
    bad("a table that is not there", ["nothing.csv"], moved % "table, file: nothing.csv")
    bad("too many rows", ["rows of the log"], START + "duration_s: 100000\nlog_s: 0.001\nmotion: {kind: hold}\n")
    bad("a base that cannot float on what it has", ["suspended, fixed or floating"], START + "machine: {base: loose}\n" + rest)
    with open(ROBOT) as file:
        urdf = file.read()
    bucket = urdf[urdf.index('<link name="bucket">'):]
    bucket = bucket[bucket.index("<inertial>"):bucket.index("</inertial>") + len("</inertial>")]
    for what, old, new, word in (("a negative mass", 'value="1010"', 'value="-1"', "mass"),
                                 ("a missing inertia", '<inertia ixx="100" iyy="1900" izz="1850" ixy="0" ixz="0" iyz="0"/>', "", "arm"),
                                 ("a link without a mass", bucket, "", "'bucket'")):
        folder_of = write(os.path.join(folder, "robot"), urdf.replace(old, new), name="r.urdf")
        check(old in urdf, f"{what} is put in")
        write(folder_of, f"teledimos: scenario 1\nname: t\nrobot: r.urdf\nmachine: {{base: fixed}}\n{rest}")
        refused(what, 1, [word], folder_of, command="simulate")


with tempfile.TemporaryDirectory() as place:
    test_example(place)
    test_flow(place)
    test_free(place)
    test_stops_and_gate(place)
    test_compiled(place)
    test_sweep(place)
    test_interrupted(place)
    test_bad(place)
    finish()
