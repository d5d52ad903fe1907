"""teledimos rehearse --machine: the loop by a machine in a process of its own, which stands for the truth of the rehearsal.

Its images come over the link, those of its way there and those after the digging; the trench is planned on what they show; the
plan that was simulated is sent, checked by the machine's own simulation, and dug by it in real time; what it has dug is known by
what is seen alone. The volume between the maps, where the ground is seen, is that between the machine's own true grounds within
5 %, its figures of the truth are null, and the plan that the machine did is the one that was made. Without
TELEDIMOS_FULL=1 only that the machine of a rehearsal begins.

Reference: truth-before.tif and truth-after.tif, which the machine leaves in its own folder and tells nobody.
Blind to: what test_rehearse.py and test_machine.py see."""

import json
import os
import shutil
import signal
import subprocess
import tempfile

import numpy
import yaml

from common import FULL, PROGRAM, SANITIZED, SOURCE, check, finish, run, skip

try:
    from osgeo import gdal
    gdal.UseExceptions()
except ImportError:
    skip("the readers of GDAL are not installed (python3-gdal)")
    finish()
if SANITIZED:
    skip("the loop renders, matches and simulates: minutes when sanitized")
    finish()

ZX200 = os.path.join(SOURCE, "datasets/zx200")
URGENT = ("chrt", "-f", "10")
if not shutil.which("chrt") or subprocess.run([*URGENT, "true"], capture_output=True).returncode != 0:
    URGENT = ()
PERIOD = "0.5"  # of the heartbeat: this computer also matches images meanwhile


def half_rig(path):
    """Pixels of twice the size: a centre c becomes (c - 1/2) / 2; the covariance's pixels go with it."""
    with open(os.path.join(ZX200, "rig.yaml")) as file:
        rig = yaml.safe_load(file)
    scale = numpy.array([0.5 if name.split(".")[1] in ("fx", "fy", "cx", "cy") else 1 for name in rig["covariance"]["order"]])
    for camera in rig["cameras"]:
        camera["width"] //= 2
        camera["height"] //= 2
        k = camera["intrinsics"]
        camera["intrinsics"] = {"fx": k["fx"] / 2, "fy": k["fy"] / 2, "cx": (k["cx"] - 0.5) / 2, "cy": (k["cy"] - 0.5) / 2}
    rig["covariance"]["matrix"] = (scale[:, None] * numpy.array(rig["covariance"]["matrix"]) * scale).tolist()
    with open(path, "w") as file:
        yaml.safe_dump(rig, file, sort_keys=False)


def prepare(folder):
    half_rig(os.path.join(folder, "rig.yaml"))
    with open(os.path.join(folder, "dig.yaml"), "w") as file:
        file.write(f"teledimos: scenario 1\nname: short\nrobot: {ZX200}/zx200.urdf\n"
                   "start: {joints: {swing: 0, boom: -0.7, arm: 1.3, bucket: 0.6}}\nduration_s: 200\nlog_s: 0.1\n"
                   f"ground: {{site: {SOURCE}/datasets/site-dig, cell_m: 0.08, region_m: [-3, -3, 9, 8], unseen_top_m: 0.4,\n"
                   f"         soil: {SOURCE}/datasets/soils/loam.yaml}}\n"
                   "task:\n  name: short\n  frame: site\n  tolerance: {position_m: 0.1}\n  steps:\n"
                   "    - dig: {from: {x_m: 6.8, y_m: 0.2, z_m: 0}, length_m: 1.2, depth_m: 0.3, width_m: 1.1, force_n: 80000}\n"
                   "    - dump: {at: {x_m: 1.5, y_m: 5.8, z_m: 0}}\n"
                   "control: {gain_1_s: 3, period_s: 0.05}\n")
    path = os.path.join(folder, "far.yaml")
    with open(path, "w") as file:
        file.write("teledimos: rehearsal 1\nname: far\nscenario: dig.yaml\nrig: rig.yaml\n"
                   "look: {before: 1..5, frames: 1, poses: [{swing: 0.3, boom: -1.1, arm: 0.7, bucket: 0.3}, "
                   "{swing: -0.3, boom: -1.1, arm: 0.7, bucket: 0.3}]}\ndraws: 2\nrounds: 1\n")
    return path


def read_map(path, band=1):
    file = gdal.Open(path)
    g = file.GetGeoTransform()
    return file.GetRasterBand(band).ReadAsArray()[::-1].astype(float), g[0] + g[1] / 2, g[3] + g[5] * (file.RasterYSize - 0.5), g[1]


def sample(grid, x, y):
    height, x0, y0, cell = grid
    c, r = (x - x0) / cell, (y - y0) / cell
    i, k = numpy.floor(c).astype(int), numpy.floor(r).astype(int)
    a, b = c - i, r - k
    return ((1 - a) * (1 - b) * height[k, i] + a * (1 - b) * height[k, i + 1] + (1 - a) * b * height[k + 1, i] +
            a * b * height[k + 1, i + 1])


def volumes(out, there):
    """Around the trench: by the maps and in truth, where the last map was seen; in truth, everywhere; the share that was seen."""
    before, after = read_map(os.path.join(out, "before.tif")), read_map(os.path.join(out, "after.tif"))
    provenance = read_map(os.path.join(out, "after.tif"), PROVENANCE)[0]
    rows, columns = numpy.mgrid[0:after[0].shape[0], 0:after[0].shape[1]]
    x, y = after[1] + columns * after[3], after[2] + rows * after[3]
    around = (x > 5.0) & (x < 7.4) & (y > -0.95) & (y < 1.35)
    seen = around & (provenance != SIMULATED) & numpy.isfinite(after[0]) & numpy.isfinite(before[0])
    cell_m2 = after[3]**2

    def cut(cells):
        begun, ended = (sample(read_map(os.path.join(there, name)), x[cells], y[cells]) for name in ("truth-before.tif", "truth-after.tif"))
        return (begun - ended).sum() * cell_m2

    return (before[0] - after[0])[seen].sum() * cell_m2, cut(seen), cut(around), seen.sum() / around.sum()


PROVENANCE, SIMULATED = 4, 5


def main(folder):
    path, there, out = prepare(folder), os.path.join(folder, "there"), os.path.join(folder, "out")
    token = os.path.join(folder, "token")
    with open(token, "w") as file:
        file.write(os.urandom(16).hex())
    os.chmod(token, 0o600)
    machine = subprocess.Popen([*URGENT, PROGRAM, "machine", path, "--listen", "127.0.0.1:0", "--token-file", token, "-o", there, "--seed",
                                "3", "--image-rate", "0", "--period", PERIOD], stdout=subprocess.PIPE, text=True)
    try:
        address = "127.0.0.1:" + machine.stdout.readline().split()[-1]
        link = ("--machine", address, "--machine-token-file", token, "--machine-period", PERIOD)
        code, _, errors = run("rehearse", path, "-o", out, *link, "--seeds", "2")
        check(code == 2 and "--machine" in errors, f"with --seeds: {code} {errors.strip()}")
        if not FULL:
            skip("the loop: minutes of a machine in real time (TELEDIMOS_FULL=1)")
            return
        code, text, errors = run("rehearse", path, "-o", out, *link, "--json", "--accept", timeout=600)
        check(code == 0, f"rehearse --machine: {code} {errors.strip()}")
        result = json.loads(text) if code == 0 else {}
        check(code == 0 and result["stopped"] is None, f"the loop comes to its end: {result.get('stopped')} {result.get('reasons')}")
        if code != 0 or result["stopped"]:
            return
        with open(os.path.join(there, "audit.jsonl")) as file:
            lines = [json.loads(line) for line in file]
        check(len([line for line in lines if line["what"] == "plan"]) == 1, "the plan that was simulated is sent")
        check(len([line for line in lines if line["what"] == "execute"]) == 3, "one trench, and the arm moved twice for a look")
        check(result["looks"] == 7 and result["rig_sigmas"] < 3, f"{result['looks']} looks, the rig {result['rig_sigmas']:.2f} sigma off")
        truths = [result[key] for key in ("dug_volume_m3", "dug_seen_m3", "map_rms_m", "tip_error_m", "mass_error_kg", "unmeant_contacts")]
        check(truths == [None] * len(truths) and not os.path.exists(os.path.join(out, "truth.tif")), f"of the truth nothing is said: {truths}")
        machine.send_signal(signal.SIGTERM)
        check(machine.wait(20) == 0, "SIGTERM ends the machine")
        measured, true, whole, seen = volumes(out, there)
        check(seen > 0.8, f"{100 * seen:.0f} % seen around the trench")
        check(abs(measured - true) < 0.05 * true, f"the volume between the maps {measured:.4f} m3, in truth {true:.4f} m3")
        check(abs(result["measured_volume_m3"] - whole) < max(2 * result["sigma_volume_m3"], 0.05 * whole),
              f"measured {result['measured_volume_m3']:.4f} +- {result['sigma_volume_m3']:.4f} m3, in truth {whole:.4f} m3")
        check(abs(result["measured_seen_m3"] - true) < max(2 * result["sigma_seen_m3"], 0.05 * true),
              f"where it is seen {result['measured_seen_m3']:.4f} +- {result['sigma_seen_m3']:.4f} m3, in truth {true:.4f} m3")
        check(0.5 * result["planned_volume_m3"] < whole < 1.6 * result["planned_volume_m3"], f"a trench of {result['planned_volume_m3']:.3f} m3")
        print(f"        {measured:.4f} m3 between the maps, {true:.4f} m3 in truth, {100 * seen:.0f} % seen; in all {whole:.4f} m3, "
              f"measured {result['measured_volume_m3']:.4f}; "
              f"planned {result['planned_volume_m3']:.3f} m3, round of {result['rounds'][0]['done_s']:.0f} s, monitor "
              f"{result['rounds'][0]['joint_sigmas']:.1f} {result['rounds'][0]['force_sigmas']:.1f} {result['rounds'][0]['tool_sigmas']:.1f}")
    finally:
        machine.kill()
        machine.communicate()


with tempfile.TemporaryDirectory() as working:
    main(working)
finish()
