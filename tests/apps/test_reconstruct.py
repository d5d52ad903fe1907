"""Proves: a rendered site's frames become a map whose heights lie on the truth (ground-*.tif, sampled by numpy through GDAL's
own tools' ASCII output, none of it the library's reader), with the keys of the schema; the machine's arm stays out of it; the same
bytes with one thread and two, and after SIGKILL in the middle and a second run; frames that fail are named while the rest goes
on (exit 3): a missing right image, a truncated one, one of another size, a NaN pose, a pose that is no rotation; wrong input is one
sentence without products. Tolerances: half of the heights within 12 mm at 3 to 20 m (5 to 15 mm is what 0.1 px is worth there),
their median within 4 mm of nothing. Blind to: coverage of sigma (tests/recon/test_fusion), speed."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time

import cv2
import numpy as np
import yaml

from common import FULL, PROGRAM, SANITIZED, SOURCE, check, fault_of_sentence, finish, run, skip

work = tempfile.mkdtemp()
site = os.path.join(work, "site")
frames = "1..2" if SANITIZED else "1..3"
small = ["--near", "3", "--far", "20", "--cell", "0.1"]


def heights(path, points):
    """Band 1 of a GeoTIFF at x, y by gdallocationinfo; NaN where there is nothing."""
    text = "\n".join(f"{x} {y}" for x, y in points)
    done = subprocess.run(["gdallocationinfo", "-valonly", "-geoloc", "-b", "1", path], input=text, capture_output=True, text=True)
    return np.array([float(line) if line.strip() else np.nan for line in done.stdout.split("\n")[:len(points)]])


def products(folder):
    return {name: open(os.path.join(folder, name), "rb").read() for name in ("map.tif", "map.ply", "map.las", "map.glb", "orthophoto.tif")}


def test_site():
    code, out, err = run("reconstruct", site, "-o", f"{work}/map", "--json", *small)
    check(code == 0, f"reconstruct ends with 0: {err[-200:]}")
    result = json.loads(out)
    count = 2 if SANITIZED else 3
    check(result["frames"]["used"] == count and not result["frames"]["failed"], "all frames are in the map")
    check(result["frame"] == "site" and result["map"]["share_measured"] == 1 and result["map"]["cells"] > 5000,
          f"{result['map']['cells']} cells of the site, all measured")
    check(result["epipolar_px"] < 0.1, f"matches lie {result['epipolar_px']:.3f} px from their epipolar curves")
    with open(f"{work}/map/result.yaml") as file:
        kept = yaml.safe_load(file)
    check(kept["map"] == result["map"], "result.yaml says what --json says")
    m = result["map"]
    rng = np.random.default_rng(5)
    points = np.stack([rng.uniform(3, 16, 4000), rng.uniform(-6, 8, 4000)], 1)
    ours, truth = heights(f"{work}/map/map.tif", points), heights(f"{site}/truth/ground-before.tif", points)
    both = np.isfinite(ours) & np.isfinite(truth)
    error = ours[both] - truth[both]
    check(both.sum() > 1000, f"{both.sum()} places are known in both")
    check(abs(np.median(error)) < 0.004, f"median of the errors {1e3 * np.median(error):.1f} mm")
    check(np.median(abs(error)) < 0.012, f"half of the errors are below {1e3 * np.median(abs(error)):.1f} mm")
    check(np.mean(error > 0.3) < 0.002, f"{100 * np.mean(error > 0.3):.2f} % stand 0.3 m above the ground: the arm is not in the map")
    check(m["height_m"][0] > -1 and m["height_m"][1] < 1.5, f"heights from {m['height_m'][0]:.2f} to {m['height_m'][1]:.2f} m")
    report = open(f"{work}/map/report.html").read()
    check("hillshade" in report and "site-trench" in report, "the report shows the map")


def test_same_bytes():
    for name, threads in (("one", "1"), ("two", "2")):
        code, _, err = run("reconstruct", site, "-o", f"{work}/{name}", "--threads", threads, "-q", *small)
        check(code == 0, f"{threads} threads: {err[-100:]}")
    check(products(f"{work}/one") == products(f"{work}/two"), "the same bytes with one thread and two")
    folder = f"{work}/killed"
    for attempt in range(3 if FULL else 2):
        child = subprocess.Popen([PROGRAM, "reconstruct", site, "-o", folder, "-q", *small], stdout=subprocess.DEVNULL)
        time.sleep((0.3 + 0.5 * attempt) * (6 if SANITIZED else 1))
        child.send_signal(signal.SIGKILL)
        child.wait()
    code, out, err = run("reconstruct", site, "-o", folder, "--json", *small)
    check(code == 0 and products(folder) == products(f"{work}/one"), "killed and run again: the same bytes")
    code, out, err = run("reconstruct", site, "-o", folder, "--json", *small)
    result = json.loads(out)
    check(result["frames"]["resumed"] == result["frames"]["total"], "what is done is not done again")
    code, out, err = run("reconstruct", site, "-o", folder, "--json", *small[:-1], "0.2")
    check(code == 0 and json.loads(out)["frames"]["resumed"] == 0 and "beginning anew" in err, "other options begin anew, and say so")


def test_real_pair():
    """The shipped dataset of a real pair, where Debian's images are: depths by the rig's own formula from OpenCV's truth."""
    images = "/usr/share/doc/opencv-doc/examples/data"
    if not os.path.exists(f"{images}/aloeGT.png"):
        skip("aloe: opencv-doc has no images here")
        return
    code, out, err = run("reconstruct", f"{SOURCE}/datasets/aloe", "-o", f"{work}/aloe", "--near", "0.55", "--far", "2.2", "--cell", "0.004",
                         "--json")
    result = json.loads(out)
    check(code == 0 and result["map"]["cells"] > 30000, f"aloe: {result['map']['cells']} cells")
    truth = cv2.imread(f"{images}/aloeGT.png", cv2.IMREAD_GRAYSCALE).astype(float)
    rows, columns = np.mgrid[100:1000:23, 350:1200:23]
    d = truth[rows, columns]
    z = 1246.67 * 0.16 / (d[d > 0] + 90)
    x, y = (columns[d > 0] - 640.5) / 1246.67 * z, (rows[d > 0] - 554.5) / 1246.67 * z
    ours = heights(f"{work}/aloe/map.tif", np.stack([x, -y], 1))
    error = ours - (1.5 - z)
    known = np.isfinite(error)
    check(known.sum() > 800 and np.median(abs(error[known])) < 0.006,
          f"aloe: {known.sum()} heights, half of them within {1e3 * np.median(abs(error[known])):.1f} mm of the truth (1 px is 4 to 14 mm)")


def spoilt(name):
    folder = os.path.join(work, name)
    shutil.copytree(site, folder, ignore=shutil.ignore_patterns("truth"))
    return folder


def cut(folder):
    path = f"{folder}/right/02.png"
    data = open(path, "rb").read()
    open(path, "wb").write(data[: len(data) // 2])


def edit_row(folder, row, column, value):
    lines = open(f"{folder}/frames.csv").read().split("\n")
    at = lines[0].split(",").index(column)
    cells = lines[row].split(",")
    cells[at] = value
    lines[row] = ",".join(cells)
    open(f"{folder}/frames.csv", "w").write("\n".join(lines))


def test_failing_frames():
    cases = {
        "missing": (lambda f: os.remove(f"{f}/right/02.png"), "02.png"),
        "truncated": (cut, "02.png"),
        "small": (lambda f: cv2.imwrite(f"{f}/right/02.png", np.zeros((480, 640), np.uint8)), "640 x 480"),
        "nan": (lambda f: edit_row(f, 2, "x_m", "nan"), "x_m"),
        "unturned": (lambda f: edit_row(f, 2, "qw", "0.3"), "quaternion"),
    }
    for name, (spoil, words) in cases.items():
        folder = spoilt(name)
        spoil(folder)
        code, out, err = run("reconstruct", folder, "-o", f"{work}/out-{name}", "--json", *small)
        failed = json.loads(out)["frames"]["failed"] if code == 3 else []
        check(code == 3 and [f["name"] for f in failed] == ["02"] and words in failed[0]["reason"],
              f"{name}: frame 02 is named, the rest goes on: {failed[0]['reason'] if failed else err[-200:]}")
    code, _, _ = run("reconstruct", f"{work}/missing", "-o", f"{work}/out-missing", "--accept", *small)
    check(code == 0, "--accept takes a map with a frame left out")


def test_wrong_input():
    poses = spoilt("no-poses")
    lines = [",".join(line.split(",")[:4]) for line in open(f"{poses}/frames.csv").read().strip().split("\n")]
    open(f"{poses}/frames.csv", "w").write("\n".join(lines) + "\n")
    cases = [
        ([poses, "-o", f"{work}/x2", *small], 1, "poses of the base"),
        ([site, "-o", f"{work}/x3", "--near", "9", "--far", "3"], 2, "--near"),
        ([site, "-o", f"{work}/x4", "--region", "1,2,3"], 2, "--region"),
        ([site, "-o", f"{work}/x5", "--rig", f"{site}/frames.csv"], 1, "frames.csv"),
        ([site, "-o", f"{work}/x6", "--prior", f"{site}/rig.yaml", *small], 1, "rig.yaml"),
        ([site], 2, "-o DIR"),
        ([], 2, "-o DIR"),
    ]
    code, _, err = run("reconstruct", f"{work}/nothing", "-o", f"{work}/x1")
    check(code == 1 and f"{work}/nothing" in err and not os.path.exists(f"{work}/x1"), "a dataset that is not there is named")
    for arguments, status, words in cases:
        code, out, err = run("reconstruct", *arguments)
        fault = fault_of_sentence(err, "reconstruct")
        written = os.path.isdir(arguments[2]) and "map.tif" in os.listdir(arguments[2]) if len(arguments) > 2 else False
        check(code == status and words in err and not fault and not written,
              f"{' '.join(arguments[-2:])[-60:]}: {code}, {err.strip()[-120:]} {fault}")


code, _, err = run("render", f"{SOURCE}/datasets/site-trench", "-o", site, "--frames", frames, "-q")
with open(f"{site}/frames.csv") as file:
    rows = file.read().strip().split("\n")
open(f"{site}/frames.csv", "w").write("\n".join(rows[: 3 if SANITIZED else 4]) + "\n")
check(code == 0, "the site is rendered" + err[-200:])
test_site()
test_same_bytes()
test_failing_frames()
test_real_pair()
test_wrong_input()
shutil.rmtree(work)
finish()
