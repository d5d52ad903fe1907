"""teledimos simulate --identify: the log of a simulated machine gives back that machine's parameters, and tells a heavier bucket
from the file's; what the motion does not tell is named; the proposed motion is simulated as it is written, and tells more; the
same bytes again; bad logs by one sentence.

Reference: the robot file that the log was simulated with; noise is drawn here. Blind to: real machines."""

import csv
import json
import os
import random
import tempfile

from common import SOURCE, check, finish, refused, run

EXAMPLE = os.path.join(SOURCE, "datasets/zx200-motion")
ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")


def result_of(scenario, out, *options):
    code, text, errors = run("simulate", scenario, "-o", out, "--json", *options)
    if code != 0:
        check(False, f"simulate {options}: status {code} {errors.strip()}")
        finish()
    return json.loads(text)


def read(path):
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    return rows[0], rows[1:]


def write(path, head, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([head, *rows])
    return path


def noisy(log, path, keep=lambda name: True):
    """Sensors' noise on what they measure; the other columns of a log are left out."""
    head, rows = read(log)
    sigma = {}
    for name in head:
        if name.endswith("_rate_rad_s"):
            sigma[name] = 2e-3
        elif name.endswith("_force_n"):
            sigma[name] = 2000
        elif name.endswith("_torque_nm"):
            sigma[name] = 500
        elif name.endswith("_rad") or (name.startswith("base_") and name.endswith("_m")):
            sigma[name] = 2e-4 if name.startswith("base_") else 5e-4
    draw = random.Random(5)
    columns = [(i, sigma.get(name, 0)) for i, name in enumerate(head) if (name == "time_s" or name in sigma) and keep(name)]
    return write(path, [head[i] for i, _ in columns],
                 [[repr(float(row[i]) + (draw.gauss(0, s) if s else 0)) for i, s in columns] for row in rows])


def test_identify(folder):
    out = os.path.join(folder, "motion")
    result_of(EXAMPLE, out)
    first = os.path.join(folder, "first")
    weak = result_of(EXAMPLE, first, "--identify", noisy(os.path.join(out, "log.csv"), os.path.join(folder, "a.csv")))
    untold = {row["name"]: row["by"] for row in weak["not_told"]}
    check(untold.get("upper_inertia_xx") == "this motion" and untold.get("undercarriage_mass") == "any motion" and
          all(p["told"] == (name not in untold) for name, p in weak["identified"].items()),
          f"the manoeuvre leaves {len(weak['identified']) - sum(p['told'] for p in weak['identified'].values())} parameters open, named")
    check(weak["proposed"]["sigma_ratio"] < 0.3, f"the proposed motion's sigmas are {weak['proposed']['sigma_ratio']:.2f} of these")
    for name in ("report.html", "result.yaml", "proposed.yaml", "proposed.csv", "log.jsonl"):
        check(os.path.exists(os.path.join(first, name)), f"{name} is written")
    with open(os.path.join(first, "report.html")) as file:
        check(file.read().count("<svg") >= 11, "the report has its plots")

    # The proposed motion, by a machine whose bucket is 30 % heavier than the file's.
    with open(ROBOT) as file:
        heavy = file.read().replace('value="660"', 'value="858"')
    with open(ROBOT.replace(".urdf", ".yaml")) as file:
        cylinders = file.read()
    for name, text in (("heavy.urdf", heavy), ("heavy.yaml", cylinders)):
        with open(os.path.join(folder, name), "w") as file:
            file.write(text)
    with open(os.path.join(first, "proposed.yaml")) as file:
        text = file.read()
    with open(os.path.join(first, "heavy.yaml"), "w") as file:
        file.write("\n".join("robot: " + os.path.join(folder, "heavy.urdf") if line.startswith("robot:") else line
                             for line in text.split("\n")))
    moved = os.path.join(folder, "moved")
    played = result_of(os.path.join(first, "heavy.yaml"), moved, "--relative", "1e-6")
    check(not played["events"] and all(joint["force_share"] < 0.97 for joint in played["joints"].values()),
          "the proposed motion meets no stop and no relief valve")
    log = noisy(os.path.join(moved, "log.csv"), os.path.join(folder, "b.csv"))
    second = os.path.join(folder, "second")
    strong = result_of(EXAMPLE, second, "--identify", log)
    told = {name: p for name, p in strong["identified"].items() if p["told"]}
    check(len(told) > 1.5 * sum(p["told"] for p in weak["identified"].values()), f"it tells {len(told)} parameters")
    truth = {"bucket_mass_x": 0.564 * 858, "bucket_mass_z": 0.364 * 858, "arm_mass_x": 0.95 * 1010 + 2.889 * 858,
             "boom_mass_x": 2.62 * 2310 + 5.648 * (1010 + 858), "boom_mass_z": 0.59 * 2310}
    for name, value in truth.items():
        p = told[name]
        check(abs(p["value"] - value) < 4 * p["sigma"], f"{name} {p['value']:.1f} +- {p['sigma']:.1f}, by hand {value:.1f} {p['unit']}")
    check(strong["verdict"] == "warned" and any("robot's file" in reason for reason in strong["reasons"]) and
          told["boom_mass_x"]["far_sigma"] > 5, "that the bucket is heavier than the file's is said, with its distance")
    check(0.9 < strong["misfit"] < 1.1 and abs(strong["joints"]["boom"]["sigma_n"] / 2000 - 1) < 0.15, "noise is found in the log")
    result_of(EXAMPLE, os.path.join(folder, "again"), "--identify", log)
    for name in ("proposed.csv", "report.html"):
        with open(os.path.join(second, name), "rb") as one, open(os.path.join(folder, "again", name), "rb") as two:
            check(one.read() == two.read(), f"the same bytes of {name} again")
    few = result_of(EXAMPLE, os.path.join(folder, "few"), "--identify",
                    noisy(os.path.join(moved, "log.csv"), os.path.join(folder, "c.csv"),
                          lambda name: "rate" not in name and not name.startswith("base_")))
    check(not few["log"]["rates"] and not few["log"]["base"] and any("pose of the base" in reason for reason in few["reasons"]),
          "without rates and base it works, and says so")
    code, _, _ = run("simulate", EXAMPLE, "-o", second, "--identify", log, "--gate", "untold_share=0.001")
    check(code == 3, "--gate untold_share refuses")
    return log


def test_bad(folder, log):
    head, rows = read(log)

    def bad(what, words, head, rows, status=1, *options):
        refused(what, status, words, EXAMPLE, "--identify", write(os.path.join(folder, "bad.csv"), head, rows), *options,
                command="simulate")

    bad("no number", ["bad.csv:12", "arm_rad"], head, rows[:10] + [["nan" if n == "arm_rad" else v for n, v in zip(head, rows[10])]] + rows[11:])
    bad("too short", ["30 samples", "at least"], head, rows[:30])
    bad("no forces", ["no column", "boom_force_n"], [n.replace("_force_n", "_f") for n in head], rows)
    bad("another robot's joints", ["no column", "swing_rad"], [n.replace("swing", "slew") for n in head], rows)
    bad("half a base", ["base", "base_yaw_rad"], [n.replace("base_yaw_rad", "yaw") for n in head], rows)
    bad("times that go back", ["times must rise"], head, rows[:50] + rows[20:])
    bad("a gap", ["gap"], head, rows[:200] + rows[300:])
    bad("no motion", ["a motion must be in it"], head, [[row[0], *rows[0][1:]] for row in rows])
    bad("a sweep", ["--sweep"], head, rows, 2, "--sweep")
    refused("no log", 1, ["nothing.csv"], EXAMPLE, "--identify", os.path.join(folder, "nothing.csv"), command="simulate")


def test_schema():
    code, text, _ = run("simulate", "--schema", "--identify", "x")
    check(code == 0 and "identified.*.sigma" in text and "not_told" in text, "--schema --identify lists its keys")


with tempfile.TemporaryDirectory() as place:
    test_bad(place, test_identify(place))
    test_schema()
    finish()
