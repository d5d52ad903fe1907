"""The page's views Acquire, Calibrate and Match, used in Chromium as an operator does (tests/page/pictures.mjs).

Pictures of a folder are frozen and stored: the stored file is the source's picture. A point of aloe, clicked on by keys alone,
lies at the depth of the set's measured disparity within one step of it; others, by the mouse, make a triangle; one is undone;
they are exported. Nine clicks on each of ViSP's grids calibrate to the figures of the command. What must not be is told: a tenth
click, a click at the edge. No violation that axe-core knows, light and dark; on a phone nothing sticks out; the browser
complains of nothing. The screenshots are left in the build tree (tests/page/pictures), to be looked at.

Skipped where Chromium and playwright-core are not installed. Blind to: hands (touch, pinch), other browsers, beauty."""

import json
import os
import shutil
import subprocess
import tempfile

import cv2
import numpy

from common import FULL, IMAGES, PROGRAM, SOURCE, check, finish, read_points, run, skip
from test_panel import Panel

WORK = os.path.join(os.path.dirname(os.path.dirname(PROGRAM)), "tests/page")  # with test_page.py
SHOTS = os.path.join(WORK, "pictures")
CHROMIUM = "/usr/bin/chromium"


def have_browser():
    """"", or why the page cannot be used. With TELEDIMOS_FULL=1 what drives the browser is installed, in the build tree."""
    if not shutil.which("node") or not os.path.exists(CHROMIUM):
        return "node or chromium is not installed (sh tests/run.sh --full installs them)"
    os.makedirs(SHOTS, exist_ok=True)
    for name in ("package.json", "package-lock.json", ".npmrc", "pictures.mjs"):
        shutil.copy(os.path.join(SOURCE, "tests/page", name), WORK)
    if not os.path.isdir(os.path.join(WORK, "node_modules/playwright-core")) and FULL and shutil.which("npm"):
        subprocess.run(["npm", "ci", "--ignore-scripts"], cwd=WORK, capture_output=True)
    if not os.path.isdir(os.path.join(WORK, "node_modules/playwright-core")):
        return "playwright-core is not installed (sh tests/run.sh --full installs it)"
    return ""


def main():
    why = have_browser()
    if not why and not (os.path.isdir(IMAGES) and os.path.isdir("/usr/share/visp-images-data")):
        why = "opencv-doc or visp-images-data is not installed"
    if why:
        skip(why)
        finish()
    with tempfile.TemporaryDirectory() as folder:
        code, text, errors = run("calibrate", os.path.join(SOURCE, "datasets/visp-marks"), "-o", os.path.join(folder, "command"), "--json")
        check(code == 0, f"calibrate: {errors.strip()}")
        camera = json.loads(text)["cameras"]["camera"]
        points = read_points(os.path.join(folder, "command/points.csv"))
        # Where a mark was left unseen its place is guessed from its row: a click may be a little off.
        marks = {frame: [points[frame, "camera"].get(k) or beside(points[frame, "camera"], k) for k in range(36)]
                 for frame in ("01", "02", "03", "04")}
        disparity = float(cv2.imread(os.path.join(IMAGES, "aloeGT.png"), cv2.IMREAD_GRAYSCALE)[500, 600])
        plan = {"marks": marks, "fx": f"{camera['intrinsics'][0]:.2f} ± {camera['sigma_intrinsics'][0]:.2f}",
                "depth": 1246.67 * 0.16 / (disparity + 90), "step": 1246.67 * 0.16 / (disparity + 89) - 1246.67 * 0.16 / (disparity + 90),
                "more": [[221, 110], [1075, 93], [908, 127], [177, 296], [1251, 102], [233, 1022], [664, 911], [360, 85]]}
        path = os.path.join(folder, "plan.json")
        with open(path, "w") as file:
            json.dump(plan, file)
        options = [part for name in ("visp-marks", "aloe", "opencv-stereo") for part in ("--bench", os.path.join(SOURCE, "datasets", name))]
        for side in ("left", "right"):
            options += [f"--{side}", os.path.join(IMAGES, side + "??.jpg")]
        with Panel(folder, *options, "--target", "chessboard 9x6 25mm") as panel:
            done = subprocess.run(["node", os.path.join(WORK, "pictures.mjs"), f"http://127.0.0.1:{panel.port}/", SHOTS, path],
                                  capture_output=True, text=True, timeout=200)
            lines = done.stdout.splitlines()
            for line in lines:
                check(line.startswith("ok "), line.split(" ", 1)[-1])
            check(done.returncode == 0 and len(lines) > 15, f"the browser's part: {done.returncode} {done.stderr.strip()[-600:]}")
            stored = os.path.join(panel.out, "acquired/left")
            names = sorted(os.listdir(stored)) if os.path.isdir(stored) else []
            sources = [cv2.imread(os.path.join(IMAGES, f"left{k:02}.jpg"), cv2.IMREAD_GRAYSCALE) for k in range(1, 15) if k != 10]
            ours = cv2.imread(os.path.join(stored, names[0]), cv2.IMREAD_UNCHANGED) if names else None
            check(ours is not None and any(abs(ours.astype(int) - s).max() <= 1 for s in sources), "what was stored is a picture of the source")
            check(os.path.isfile(os.path.join(panel.out, "points/aloe/points.ply")) and
                  os.path.isfile(os.path.join(panel.out, "calibrated/visp-marks/rig.yaml")), "what was exported and calibrated is there")
            code, _, errors = panel.end()
            check(code == 0, f"the panel ends: {code} {errors.strip()}")
    print(f"screenshots: {SHOTS}")
    finish()


def beside(view, k):
    """From the neighbours of a mark that was not seen."""
    near = [numpy.array(view[j]) for j in (k - 1, k + 1) if j in view and j // 6 == k // 6]
    if len(near) == 2:
        return list(numpy.mean(near, axis=0))
    a, b = (view[k + 1], view[k + 2]) if k % 6 < 3 else (view[k - 1], view[k - 2])
    return [2 * a[0] - b[0], 2 * a[1] - b[1]]


main()
