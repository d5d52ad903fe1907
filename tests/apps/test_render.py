"""teledimos render: a small scene becomes a dataset that other readers open, its truth fits its images (a point seen by the
left camera is where the truth says in the right one, to a correlation above 0.9), an interrupted run goes on where it stopped
with the same bytes, and bad scenes end with one sentence."""

import csv
import json
import os
import signal
import subprocess
import tempfile
import time

import cv2
import numpy as np
import yaml

from common import PROGRAM, SOURCE, check, finish, refused, run

RIG = """teledimos: rig 1
cameras:
  - name: left
    model: brown5
    width: 320
    height: 240
    intrinsics: {fx: 300, fy: 300, cx: 160, cy: 121}
    distortion: {k1: -0.1, k2: 0.02, p1: 0, p2: 0, k3: 0}
    camera_from_rig: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}
  - name: right
    model: brown5
    width: 320
    height: 240
    intrinsics: {fx: 302, fy: 302, cx: 158, cy: 119}
    distortion: {k1: -0.1, k2: 0.02, p1: 0, p2: 0, k3: 0}
    camera_from_rig: {q: [1, 0, 0, 0], t_m: [-0.3, 0, 0]}
"""
SCENE = """teledimos: scene 1
name: small
rig: rig.yaml
frames: frames.csv
target: {kind: chessboard, columns: 7, rows: 5, spacing_m: 0.12}
grounds:
  - {name: first, generate: {columns: 200, rows: 200, cell_m: 0.05, origin_m: [0, -5], roughness_m: 0.05, seed: 2}}
  - {name: second, generate: {columns: 200, rows: 200, cell_m: 0.05, origin_m: [0, -5], roughness_m: 0.05, seed: 3}}
solids: [{name: crate, box_m: [0.5, 0.5, 0.5], at_m: [2.6, 1.1]}]
pictures:
  - {name: board, file: board.png, width_m: 1.2, pose: {q: [0.5, -0.5, 0.5, -0.5], t_m: [3.2, 0.5, 1.75]}}
mount: {pose: {q: [0.353553390593, -0.612372435696, 0.612372435696, -0.353553390593], t_m: [0, 0, 2.2]}}
image: {gain: 1.4}
"""
FRAMES = "frame,time_s,ground,x_m,y_m,z_m,qw,qx,qy,qz\n" + "".join(
    f"{i:02d},{0.5 * i},{'first' if i < 3 else 'second'},0,{0.02 * i},0,1,0,0,0\n" for i in range(6))


def write(folder, name, text):
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, name), "w") as file:
        file.write(text)


def board(path):
    """7 x 5 inner corners 0.12 m apart on a sheet of 1.2 x 0.96 m: 1000 px/m."""
    sheet = np.full((960, 1200), 255, np.uint8)
    for row in range(6):
        for column in range(8):
            if (row + column) % 2 == 0:
                sheet[120 + 120 * row:240 + 120 * row, 120 + 120 * column:240 + 120 * column] = 20
    cv2.imwrite(path, sheet)


def make(folder):
    write(folder, "rig.yaml", RIG)
    write(folder, "scene.yaml", SCENE)
    write(folder, "frames.csv", FRAMES)
    board(os.path.join(folder, "board.png"))
    return folder


def everything(folder):
    """Path: bytes, but for what holds times."""
    found = {}
    for at, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(at, name)
            if name != "result.yaml":
                with open(path, "rb") as file:
                    found[os.path.relpath(path, folder)] = file.read()
    return found


def test_truth(out):
    """Left pixels carried to the right image by truth depth."""
    left, right = (cv2.imread(f"{out}/{side}/02.png", cv2.IMREAD_GRAYSCALE) for side in ("left", "right"))
    depth = cv2.imread(f"{out}/truth/left/02.pfm", cv2.IMREAD_UNCHANGED)
    other = cv2.imread(f"{out}/truth/right/02.pfm", cv2.IMREAD_UNCHANGED)
    k = [np.array([[f, 0, x], [0, f, y], [0, 0, 1.0]]) for f, x, y in ((300, 160, 121), (302, 158, 119))]
    d = np.array([-0.1, 0.02, 0, 0, 0])
    y, x = np.mgrid[5:235, 5:315]
    rays = cv2.undistortPoints(np.stack([x.ravel(), y.ravel()], 1).astype(float)[:, None], k[0], d)[:, 0]
    z = depth[y.ravel(), x.ravel()].astype(float)
    points = np.c_[rays * z[:, None], z] + [-0.3, 0, 0]
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k[1], d)
    u, v = seen[:, 0, 0], seen[:, 0, 1]
    inside = (u > 3) & (u < 316) & (v > 3) & (v < 236) & np.isfinite(z)
    u, v, points, grey = u[inside], v[inside], points[inside], left[y, x].ravel()[inside].astype(float)
    there = other[np.rint(v).astype(int), np.rint(u).astype(int)]
    same = np.abs(there - points[:, 2]) < 0.03 * points[:, 2]
    i, j, a, b = u.astype(int), v.astype(int), u % 1, v % 1
    pixel = right.astype(float)
    carried = ((1 - b) * ((1 - a) * pixel[j, i] + a * pixel[j, i + 1]) +
               b * ((1 - a) * pixel[j + 1, i] + a * pixel[j + 1, i + 1]))
    correlation = np.corrcoef(grey[same], carried[same])[0, 1]
    check(same.mean() > 0.8 and correlation > 0.9, f"truth carries left to right: {same.sum()} pixels, correlation {correlation:.3f}")
    corners = cv2.findChessboardCorners(left, (7, 5))
    check(corners[0], "the board is found in the image")


def test_dataset(scene, folder):
    out = os.path.join(folder, "out")
    status, text, errors = run("render", scene, "-o", out, "--json")
    check(status == 0, f"render ends with 0 {errors.strip()}")
    if status:
        return
    result = json.loads(text)
    check(result["frames"] == 6 and result["frames_rendered"] == 6 and result["seen"]["picture"] > 0.01 and
          result["seen"]["ground"] > 0.3, "the result counts frames and what is seen")
    with open(f"{out}/frames.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    check(len(rows) == 6 and all(os.path.isfile(os.path.join(out, row["left"])) for row in rows), "frames.csv names the images")
    check(os.path.isfile(f"{out}/truth/ground-second.tif") and os.path.isfile(f"{out}/rig.yaml"), "maps and rig are there")
    with open(f"{out}/rig.yaml") as file:
        place = yaml.safe_load(file)["vehicle_from_rig"]
    check(place["t_m"] == [0, 0, 2.2] and np.allclose(place["q"], [0.353553390593, -0.612372435696, 0.612372435696, -0.353553390593]),
          "rig.yaml says where the scene mounts the rig")
    test_truth(out)
    status, text, errors = run("check", f"{out}/rig.yaml", out, "-o", os.path.join(folder, "checked"), "--json")
    rms = json.loads(text).get("rms_px") if status in (0, 3) and text else None
    check(status == 0, f"check takes the dataset: status {status}, rms {rms} {errors.strip()}")

    again = json.loads(run("render", scene, "-o", out, "--json")[1])
    check(again["frames_rendered"] == 0 and again["frames_kept"] == 6, "a second run keeps what is there")
    whole = everything(out)
    os.remove(f"{out}/right/03.png")
    again = json.loads(run("render", scene, "-o", out, "--json", "--threads", "1")[1])
    check(again["frames_rendered"] == 1 and everything(out) == whole, "a missing image is drawn again, bit for bit, on one thread")
    part = os.path.join(folder, "part")
    again = json.loads(run("render", scene, "-o", part, "--json", "--frames", "2..3")[1])
    same = everything(part)
    check(again["frames"] == 2 and all(whole[name] == same[name] for name in same if name.endswith(("png", "pfm"))),
          "--frames renders a part, the same bytes")
    write(scene, "scene.yaml", SCENE.replace("gain: 1.4", "gain: 1.2"))
    again = json.loads(run("render", scene, "-o", out, "--json")[1])
    check(again["frames_rendered"] == 6 and everything(out)["left/00.png"] != whole["left/00.png"], "another scene is drawn anew")
    make(scene)
    return whole


def test_interrupted(scene, folder, whole):
    out = os.path.join(folder, "killed")
    for kind in (signal.SIGINT, signal.SIGKILL):
        job = subprocess.Popen([PROGRAM, "render", scene, "-o", out, "-q"], stderr=subprocess.PIPE, text=True,
                               start_new_session=True)
        deadline = time.time() + 60
        while time.time() < deadline and job.poll() is None and not os.path.isfile(f"{out}/left/00.png"):
            time.sleep(0.002)
        os.killpg(job.pid, kind)
        errors = job.communicate(timeout=60)[1]
        if kind == signal.SIGINT:
            check(job.returncode in (0, 1) and (job.returncode == 0 or "run again" in errors), f"SIGINT: {errors.strip()}")
    status, _, errors = run("render", scene, "-o", out)
    left = {name: data for name, data in everything(out).items() if not os.path.basename(name).startswith(".")}
    check(status == 0 and left == whole, f"after both, the run ends with the same bytes {errors.strip()}")


def test_bad(folder):
    refused("no scene", 1, ["scene.yaml"], os.path.join(folder, "none"), command="render")
    scene = make(os.path.join(folder, "bad"))
    refused("frames out of range", 2, ["--frames", "6"], scene, "--frames", "5..9", command="render")
    write(scene, "scene.yaml", SCENE.replace("box_m", "ball_m"))
    refused("an unknown solid", 1, ["solids[0]", "ball_m"], scene, command="render")
    make(scene)
    os.remove(os.path.join(scene, "board.png"))
    refused("a picture that is not there", 1, ["board.png"], scene, command="render")
    for site in ("site-polyhedra", "site-trench"):
        check(os.path.isfile(os.path.join(SOURCE, "datasets", site, "scene.yaml")), f"{site} is there")


with tempfile.TemporaryDirectory() as place:
    small = make(os.path.join(place, "scene"))
    bytes_of = test_dataset(small, place)
    if bytes_of:
        test_interrupted(small, place, bytes_of)
    test_bad(place)
    finish()
