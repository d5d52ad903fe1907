"""Proves: bad input is named in one clear sentence, with the right exit status, and leaves no product behind; what can go
on goes on, unharmed, and names what it left out; a job that is stopped or killed leaves nothing that is half written.

Reference: the same job on good input. Views that are put right or left out may move the result by no more than its own
noise: 3 sigma, since less data is other data; not at all where the data are the same in the end. Statuses: 1 failed, 2
wrong usage, 3 refused by the gate. Blind to: whether a sentence is good English; losses of power, which the order of
fsync and rename is for.
"""

import json
import math
import os
import random
import resource
import shutil
import signal
import struct
import subprocess
import tempfile
import time
import zlib

import cv2
import numpy

from common import (PROGRAM, SANITIZED, SOURCE, calibrate, check, fault_of_sentence, finish, read_points, refused, run,
                    shortened, skip, write_dataset)

try:
    import yaml as yaml_reader
except ImportError:
    yaml_reader = None

OPENCV_SET = os.path.join(SOURCE, "datasets/opencv-stereo")
IMAGES = "/usr/share/doc/opencv-doc/examples/data"
FRAMES = ["01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14"]
COLUMNS, ROWS, SPACING = 9, 6, 0.025
TABLE = "frame,left,right\n"
CAMERAS = "cameras:\n  - {name: left, model: brown5}\n  - {name: right, model: brown5}\n"
TARGET = "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n"
# What a run without anything wrong gave: the result from images and, below, from the points of it.
clean = {}


# ---- making datasets ----


def image_set(folder, change=None, root=IMAGES, frames=FRAMES):
    """The pairs of `frames`; change: {frame: {camera: path}}."""
    rows = {frame: {"left": f"left{frame}.jpg", "right": f"right{frame}.jpg"} for frame in frames}
    for frame, images in (change or {}).items():
        rows[frame].update(images)
    table = TABLE + "".join(f"{frame},{row['left']},{row['right']}\n" for frame, row in rows.items())
    return write_dataset(folder, f"name: changed\nroot: {root}\n{TARGET}{CAMERAS}", table)


def points_text(points, size=(640, 480)):
    lines = ["frame,camera,width_px,height_px,point,x_px,y_px,sigma_px"]
    for (frame, camera), view in points.items():
        lines += [f"{frame},{camera},{size[0]},{size[1]},{i},{x!r},{y!r},0.05" for i, (x, y) in sorted(view.items())]
    return "\n".join(lines) + "\n"


def points_set(folder, points, text=None, extra="", target=TARGET):
    """A dataset whose points are given instead of images."""
    cameras = sorted({camera for _, camera in points})
    frames = sorted({frame for frame, _ in points})
    description = f"name: points\ncorners: points.csv\n{target}{extra}cameras:\n"
    description += "".join(f"  - {{name: {camera}, model: brown5}}\n" for camera in cameras)
    write_dataset(folder, description, ",".join(["frame", *cameras]) + "\n" +
                  "".join(frame + "," * len(cameras) + "\n" for frame in frames))
    with open(os.path.join(folder, "points.csv"), "w") as file:
        file.write(points_text(points) if text is None else text)
    return folder


def copy_of(points):
    return {key: dict(view) for key, view in points.items()}


def same_rig(result, factor):
    """Largest difference of focal lengths, centres and baseline from the clean run's, in `factor` of its sigmas."""
    ours, good = [], []
    for name, camera in clean["result"]["cameras"].items():
        good += list(zip(camera["intrinsics"], camera["sigma_intrinsics"]))
        ours += result["cameras"][name]["intrinsics"]
    good.append((clean["result"]["stereo"]["baseline_m"], clean["result"]["stereo"]["sigma_baseline_m"]))
    ours.append(result["stereo"]["baseline_m"])
    worst = max(abs(a - b) / sigma for a, (b, sigma) in zip(ours, good))
    return worst <= factor, f"the rig is within {worst:.2g} sigma (bound {factor:g}) of the clean one"


def prepare():
    """The clean results, and the points they rest on."""
    with tempfile.TemporaryDirectory() as folder:
        clean["images"] = calibrate(OPENCV_SET, out=os.path.join(folder, "images"))
        if not clean["images"]:
            finish()
        clean["points"] = read_points(os.path.join(folder, "images/points.csv"))
        clean["result"] = calibrate(points_set(folder, clean["points"]), out=os.path.join(folder, "out"))
        if not clean["result"]:
            finish()
        with open(os.path.join(folder, "out/rig.yaml")) as file:
            clean["rig"] = file.read()
    check(clean["result"]["verdict"] != "refused", "the clean dataset is calibrated")


# ---- views and points that do not belong ----


def test_numbering():
    with tempfile.TemporaryDirectory() as folder:
        points = copy_of(clean["points"])
        last = COLUMNS * ROWS - 1
        points[("05", "right")] = {last - i: p for i, p in clean["points"][("05", "right")].items()}
        result = calibrate(points_set(folder, points))
        named = result and result["corrected_views"] == ["05"] and any("view 05" in r for r in result["reasons"])
        check(named, f"a view numbered from the other end in one camera: {result and result['views']['05'].get('remark')}")
        if result:
            # The points are the same in the end; sigma as the yardstick, a thousandth of it for the solver's rounding.
            check(*same_rig(result, 1e-3))
        points[("05", "right")] = {i // COLUMNS * COLUMNS + COLUMNS - 1 - i % COLUMNS: p
                                   for i, p in clean["points"][("05", "right")].items()}
        result = calibrate(points_set(folder, points))
        named = result and result["outlier_views"] == ["05"] and any("view 05" in r for r in result["reasons"])
        check(named, f"a view numbered as in a mirror: {result and result['views']['05'].get('remark')}")
        if result:
            check(*same_rig(result, 3))


def test_swaps():
    with tempfile.TemporaryDirectory() as folder:
        swapped = image_set(folder, {"07": {"left": "right07.jpg", "right": "left07.jpg"}})
        result = calibrate(swapped)
        remark = result and result["views"]["07"].get("remark", "")
        check(result and result["outlier_views"] == ["07"] and "swapped" in remark, f"a pair swapped: {remark}")
        if result:
            check(*same_rig(result, 3))
        everything = {f: {"left": f"right{f}.jpg", "right": f"left{f}.jpg"} for f in FRAMES}
        result = calibrate(image_set(folder, everything))
        baseline = result and result["stereo"]["baseline_m"]
        check(result and not result["outlier_views"] and abs(baseline - clean["images"]["stereo"]["baseline_m"]) < 1e-5,
              f"all pairs swapped is another rig: baseline {baseline} m")
        del everything["03"]
        result = calibrate(image_set(folder, everything))
        check(result and result["outlier_views"] == ["03"], f"the one pair that is not swapped is the one named: "
              f"{result and result['outlier_views']}")


def test_outlying_corners():
    points = copy_of(clean["points"])
    moved = {("02", "left", 10), ("02", "left", 30), ("06", "right", 0), ("11", "left", 53), ("14", "right", 25)}
    draw = random.Random(7)
    for frame, camera, point in moved:
        x, y = points[(frame, camera)][point]
        angle = draw.uniform(0, 2 * math.pi)
        points[(frame, camera)][point] = (x + 5 * math.cos(angle), y + 5 * math.sin(angle))
    with tempfile.TemporaryDirectory() as folder:
        result = calibrate(points_set(folder, points))
    if not result:
        return
    found = {(o["view"], o["camera"], o["point"]): o["residual_px"] for o in result["outlier_points"]}
    lengths = [found.get(key, 0) for key in moved]
    # 5 px, give or take what the point was off before (below 1 px).
    check(moved <= set(found) and all(4 < r < 6 for r in lengths),
          f"5 corners moved by 5 px are listed, with residuals of {', '.join(f'{r:.2f}' for r in lengths)} px")
    check(len(found) <= len(clean["result"]["outlier_points"]) + 7, f"few others are: {len(found)} in all")
    check(*same_rig(result, 3))


def test_board_size():
    with tempfile.TemporaryDirectory() as folder:
        tape = "expect: {baseline_m: 0.083, tolerance_m: 0.002}\n"
        wrong = points_set(folder, clean["points"], target=TARGET.replace("0.025", "0.030"), extra=tape)
        out = os.path.join(folder, "out")
        result = calibrate(wrong, out=out, expect=3)
        reasons = [r for r in (result or {}).get("reasons", []) if "spacing_m should be " in r]
        fits = float(reasons[0].split("spacing_m should be ")[1].split()[0]) if reasons else 0
        check(abs(fits - SPACING) < 0.02 * SPACING, f"squares of 30 mm said, 25 mm used: {reasons}")
        check(not os.path.exists(os.path.join(out, "rig.yaml")), "and rig.yaml is not written")
        right = points_set(folder, clean["points"], extra=tape)
        result = calibrate(right)
        check(result and not any("baseline" in r for r in result["reasons"]), "the right size passes the tape measure")
        refused("squares of 25 m", 1, ["dataset.yaml", "target", "spacing_m", "25", "0.025"],
                points_set(folder, clean["points"], target=TARGET.replace("0.025", "25")))


def test_blur():
    with tempfile.TemporaryDirectory() as folder:
        for sigma in (3, 5):
            image = cv2.imread(os.path.join(IMAGES, "left05.jpg"))
            path = os.path.join(folder, "blurred.png")
            cv2.imwrite(path, cv2.GaussianBlur(image, (0, 0), sigma))
            result = calibrate(image_set(os.path.join(folder, "set"), {"05": {"left": path}}))
            if not result:
                continue
            words = [r for r in result["reasons"] if "05" in r]
            state = result["views"]["05"]["state"]
            check(words and (any("blur" in w for w in words) or state != "used"),
                  f"an image blurred by {sigma} px is named (view {state}): {words}")
            others = [v for v in result["outlier_views"] if v not in ("05", *clean["images"]["outlier_views"])]
            check(not others and result["verdict"] != "refused", f"the other views stay in use: {others}")
            check(*same_rig(result, 3))


def drawn_board(path, columns, rows):
    """A chessboard with so many inner corners, seen at a slant."""
    side = 40
    flat = numpy.full(((rows + 3) * side, (columns + 3) * side), 255, numpy.uint8)
    for r in range(rows + 1):
        for c in range(columns + 1):
            if (r + c) % 2 == 0:
                flat[(r + 1) * side:(r + 2) * side, (c + 1) * side:(c + 2) * side] = 0
    h, w = flat.shape
    place = cv2.getPerspectiveTransform(numpy.float32([[0, 0], [w, 0], [w, h], [0, h]]),
                                        numpy.float32([[90, 60], [560, 90], [530, 430], [110, 400]]))
    image = cv2.warpPerspective(flat, place, (640, 480), borderValue=180)
    cv2.imwrite(path, cv2.GaussianBlur(image, (0, 0), 1))


def test_other_board():
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "board.png")
        for columns, rows in ((7, 5), (10, 7), (6, 9)):
            drawn_board(path, columns, rows)
            result = calibrate(image_set(os.path.join(folder, "set"), {"05": {"left": path, "right": path}}))
            view = result and result["views"]["05"]
            reason = view and view["cameras"]["left"].get("reason", "")
            if (columns, rows) == (6, 9):  # the same board on its side: it may be used, but then it is no pair
                named = view and (view["state"] == "outlier" or reason)
            else:
                named = view and view["state"] == "unseen" and reason
            check(named and any("view 05" in r for r in result["reasons"]),
                  f"a board of {columns}x{rows} corners: {reason or (view and view.get('remark'))}")
            if result:
                check(*same_rig(result, 3))


# ---- images ----


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_that_claims(width, height):
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + png_chunk(b"IDAT", zlib.compress(b"\0" * 1000)) +
            png_chunk(b"IEND", b""))


def little_memory():
    resource.setrlimit(resource.RLIMIT_AS, (3 << 29, 3 << 29))


def test_images():
    with tempfile.TemporaryDirectory() as folder:
        good = cv2.imread(os.path.join(IMAGES, "left05.jpg"))
        small, png = os.path.join(folder, "small.png"), os.path.join(folder, "good.png")
        cv2.imwrite(small, cv2.resize(good, (320, 240)))
        cv2.imwrite(png, good)

        def file(name, content):
            with open(os.path.join(folder, name), "wb") as out:
                out.write(content)
            return os.path.join(folder, name)

        jpeg_bytes, png_bytes = open(os.path.join(IMAGES, "left05.jpg"), "rb").read(), open(png, "rb").read()
        os.mkfifo(os.path.join(folder, "pipe.png"))
        os.mkdir(os.path.join(folder, "folder.png"))
        damaged = bytearray(png_bytes)
        damaged[len(damaged) // 2] ^= 0xff
        bad = [("another size", small, ["640x480", "320x240"]), ("empty", file("empty.png", b""), ["empty"]),
               ("truncated JPEG", file("cut.jpg", jpeg_bytes[:len(jpeg_bytes) // 2]), []),
               ("JPEG without its end", file("cut2.jpg", jpeg_bytes[:-200]), []),
               ("truncated PNG", file("cut.png", png_bytes[:len(png_bytes) // 2]), []),
               ("damaged PNG", file("damaged.png", bytes(damaged)), []),
               ("text", file("text.png", b"this is no image\n"), []),
               ("a folder", os.path.join(folder, "folder.png"), ["folder"]),
               ("a pipe", os.path.join(folder, "pipe.png"), ["pipe"]), ("a device", "/dev/zero", ["device"]),
               ("missing", os.path.join(folder, "missing.png"), ["No such file"]),
               ("a PNG that claims 60000x60000", file("huge.png", png_that_claims(60000, 60000)), ["60000"]),
               ("a PNG that claims 16000x16000", file("large.png", png_that_claims(16000, 16000)), [])]
        few = FRAMES[2:6]  # the bad one among them, neither first nor last
        for what, path, words in bad:
            begun = time.monotonic()
            dataset = image_set(os.path.join(folder, "set"), {"05": {"left": path}}, frames=few)
            refused(f"image: {what}", 1, [os.path.basename(path), *words], dataset,
                    before=None if SANITIZED else little_memory)
            if "claims" in what:
                check(time.monotonic() - begun < 20, "  and it takes no long")
        rectified, rig = os.path.join(folder, "rectified"), rig_file(folder, clean["rig"])
        for what, path, words in bad[::5]:
            dataset = image_set(os.path.join(folder, "set"), {"05": {"left": path}}, frames=few)
            refused(f"rectify, image: {what}", 1, [os.path.basename(path)], dataset, "--rig", rig, command="rectify",
                    out=rectified)
        left = os.listdir(rectified)
        whole = all(cv2.imread(os.path.join(rectified, name)) is not None for name in left)
        check(whole and len(left) == 7 and not leftovers(rectified),
              f"rectify: the {len(left)} good images are whole, and no result says that all is done")


# ---- too few views, and views that do not suffice ----


def views_of(points, frames):
    return {key: view for key, view in points.items() if key[0] in frames}


def parallel_views(tilt_deg):
    """A board before a camera of 530 px, parallel to the image (or tilted), near and far, turned about its normal."""
    draw = numpy.random.default_rng(3)
    board = numpy.array([[c * SPACING, r * SPACING, 0] for r in range(ROWS) for c in range(COLUMNS)])
    board -= board.mean(axis=0)
    points = {}
    for v in range(12):
        turn, tilt = draw.uniform(-0.6, 0.6), math.radians(tilt_deg)
        rotation = cv2.Rodrigues(numpy.array([0, 0, turn]))[0]
        axis = 2 * math.pi * v / 12
        rotation = cv2.Rodrigues(tilt * numpy.array([math.cos(axis), math.sin(axis), 0]))[0] @ rotation
        xyz = board @ rotation.T + [draw.uniform(-0.06, 0.06), draw.uniform(-0.04, 0.04), draw.uniform(0.35, 0.6)]
        xy = 530 * xyz[:, :2] / xyz[:, 2:] + [320, 240] + draw.normal(0, 0.1, (len(board), 2))
        points[(f"{v:02d}", "camera")] = {i: (float(x), float(y)) for i, (x, y) in enumerate(xy)}
    return points


def test_few_views():
    with tempfile.TemporaryDirectory() as folder:
        for count, words in ((1, ["1 of 1", "at least 3"]), (2, ["2 of 2", "at least 3"])):
            refused(f"{count} view(s)", 1, words, points_set(folder, views_of(clean["points"], FRAMES[:count])))
        path, few = os.path.join(folder, "grey.png"), FRAMES[:5]
        cv2.imwrite(path, numpy.full((480, 640), 128, numpy.uint8))
        refused("no view with the board", 1, ["left", "0 of 5"],
                image_set(folder, {f: {"left": path, "right": path} for f in few}, frames=few))
        refused("only one camera sees the board", 1, ["right", "0 of 5"],
                image_set(folder, {f: {"right": path} for f in few}, frames=few))
        apart = {key: view for key, view in clean["points"].items() if (key[0] < "07") == (key[1] == "left")}
        refused("no view that two cameras share", 1, ["right", "shares no view"], points_set(folder, apart))


def test_weak_views():
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "out")
        result = calibrate(points_set(folder, parallel_views(30)), out=out)
        check(result and os.path.exists(os.path.join(out, "rig.yaml")), "views tilted by 30 degrees give a rig")
        # Parallel to the image as far as a hand can, then as only a simulation can.
        for tilt in (1, 0):
            flat = points_set(folder, parallel_views(tilt))
            result = calibrate(flat, out=out, expect=3)
            words = (result or {}).get("weak_directions", [])
            check(any("focal length and distance cannot be told apart" in w and "tilt the board" in w for w in words),
                  f"views tilted by at most {tilt} degrees: {words}")
            check(result and result["verdict"] == "refused" and set(words) <= set(result["reasons"]),
                  "  and they are the reasons")
            check(not os.path.exists(os.path.join(out, "rig.yaml")), "  rig.yaml of an earlier run is gone")
            check(result and "rig" not in result["products"], "  and the result does not list it")
            status, _, errors = run("calibrate", flat, "-o", out)
            check(status == 3 and "teledimos" not in errors, f"  without --json it ends with 3 as well {shortened(errors)}")
            result = calibrate(flat, "--accept", out=out)
            check(result and result["verdict"] == "refused" and os.path.exists(os.path.join(out, "rig.yaml")),
                  "  --accept writes it, and the verdict stays")


# ---- the description ----


def bad_descriptions():
    """(what, text, words): what must be named."""
    base = f"name: x\nroot: {IMAGES}\n{TARGET}{CAMERAS}"

    def spacing(text):
        return base.replace("0.025", text)

    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9))
    for text in (".nan", ".inf", "-.inf", "'0.025'", "abc", "[0.025]", "true"):
        yield f"spacing_m {text}", spacing(text), ["target.spacing_m"]
    yield "spacing_m 1e400", spacing("1e400"), ["1e400"]
    for text in ("-0.025", "0", "1e9", "1e-9"):
        yield f"spacing_m {text}", spacing(text), ["target", "spacing_m", "between"]
    for text in ("-9", "0", "1000000", "9.5", "'9'", "99999999999999999999"):
        yield f"columns {text}", base.replace("columns: 9", f"columns: {text}"), ["target", "columns"] if len(text) < 9 else [text]
    yield "no columns", base.replace("columns: 9, ", ""), ["target.columns", "missing"]
    yield "no target", base.replace(TARGET, ""), ["target", "missing"]
    yield "no cameras", base.replace(CAMERAS, ""), ["cameras", "missing"]
    yield "cameras: []", base.replace(CAMERAS, "cameras: []\n"), ["cameras"]
    yield "no name", base.replace("name: x\n", ""), ["name", "missing"]
    yield "spacing for spacing_m", base.replace("spacing_m", "spacing"), ["spacing_m"]
    yield "colums for columns", base.replace("columns", "colums"), ["'colums'", "'columns'"]
    yield "camera for cameras", base.replace("cameras:", "camera:"), ["'camera'", "'cameras'"]
    yield "a key of another world", base + "wheels: 4\n", ["wheels"]
    yield "a key twice", base + "name: y\n", ["name", "twice"]
    yield "an unknown lens model", base.replace("brown5", "brown6"), ["brown6", "brown5"]
    yield "an unknown target", base.replace("chessboard", "checkerboard"), ["checkerboard", "chessboard"]
    yield "two cameras of one name", base.replace("right", "left"), ["left", "twice"]
    yield "a camera named ../x", base.replace("left", "../x"), ["../x", "letters"]
    yield "a variable that is not set", base.replace(IMAGES, "${TELEDIMOS_NOT_SET}/x"), ["TELEDIMOS_NOT_SET", "not set"]
    yield "a tolerance of 0", base + "expect: {baseline_m: 0.1, tolerance_m: 0}\n", ["expect.tolerance_m"]
    yield "a baseline in millimetres", base + "expect: {baseline_m: 83000, tolerance_m: 1}\n", ["expect.baseline_m"]
    yield "an alias bomb", bomb + base, ["aliases"]
    yield "10 MB of [", "[" * 10_000_000, []
    yield "10 MB of {", "a: " + "{" * 10_000_000, []
    yield "500 times [ ", "[" * 500 + "]" * 500, []
    yield "binary garbage", random.Random(1).randbytes(5000), []
    yield "NUL bytes", base.encode() + b"\0\0\0", []
    yield "Latin-1", "name: Müller\n".encode("latin-1") + base.encode(), []
    yield "an empty file", "", ["empty"]
    yield "a comment only", "# nothing\n", ["empty"]
    yield "a list at the root", "- name: x\n", ["mapping"]
    yield "a word at the root", "hello\n", ["mapping"]
    yield "two documents", base + "---\n" + base, ["second document"]
    yield "a tag", base.replace("name: x", "name: !!python/object x"), ["tags"]
    yield "an open bracket", base.replace("0.025}", "0.025"), ["YAML"]
    yield "a name of a million letters", base.replace("name: x", "name: " + "x" * 1_000_000), ["name"]


def test_descriptions():
    with tempfile.TemporaryDirectory() as folder:
        dataset = write_dataset(folder, "", open(os.path.join(OPENCV_SET, "frames.csv")).read())
        path = os.path.join(folder, "dataset.yaml")
        for what, text, words in bad_descriptions():
            with open(path, "wb") as file:
                file.write(text if isinstance(text, bytes) else text.encode())
            refused(f"dataset.yaml: {what}", 1, ["dataset.yaml", *words], dataset)
        with open(path, "wb") as file:
            file.truncate(3 << 30)
        refused("dataset.yaml: 3 GB of zeros", 1, ["dataset.yaml", "larger"], dataset,
                before=None if SANITIZED else little_memory)
        os.remove(path)
        os.mkfifo(path)
        refused("dataset.yaml: a pipe", 1, ["dataset.yaml", "pipe"], dataset)
        os.remove(path)
        os.mkdir(path)
        refused("dataset.yaml: a folder", 1, ["dataset.yaml", "folder"], dataset)
        os.rmdir(path)
        # What a dataset is stands below the sentence, for those who begin.
        for what, place in (("no dataset.yaml", folder), ("no dataset", os.path.join(folder, "none"))):
            status, text, errors = run("calibrate", place, "-o", os.path.join(folder, "out"))
            check(status == 1 and place in errors and "dataset.yaml" in errors and not text and
                  not os.path.exists(os.path.join(folder, "out")), f"{what}: {shortened(errors)}")
        image_set(folder, root=os.path.join(folder, "nowhere"))
        refused("a root that does not exist", 1, ["nowhere/left01.jpg"], folder)


def test_tables():
    lines = open(os.path.join(OPENCV_SET, "frames.csv")).read()
    description = f"name: x\nroot: {IMAGES}\n{TARGET}{CAMERAS}"
    bad = [("empty", "", ["empty"]), ("header only", TABLE, ["no frames"]),
           ("another camera's column", lines.replace("right\n", "rear\n", 1), ["right", "rear"]),
           ("a column twice", lines.replace("left,right", "left,left", 1), ["left", "twice"]),
           ("a frame twice", lines + "05,left05.jpg,right05.jpg\n", ["'05'", "line 6"]),
           ("a frame without a name", lines + ",left05.jpg,right05.jpg\n", ["frame", "name"]),
           ("a frame's name of a million letters", lines + "x" * 1_000_000 + ",left05.jpg,right05.jpg\n", ["frame"]),
           ("an image's name of a million letters", lines + "99," + "x" * 1_000_000 + ",right05.jpg\n", ["left", "xxx"]),
           ("NUL bytes", lines + "99,left\0.jpg,right05.jpg\n", ["frames.csv:15"]),
           ("only NUL bytes", "\0" * 100, []), ("a short row", lines + "99,left05.jpg\n", ["frames.csv:15", "cells"]),
           ("an open quote", lines + '99,"left05.jpg,right05.jpg\n', ["frames.csv:15", "quote"]),
           ("Latin-1", lines.encode() + b"99,M\xfcller.jpg,\n", ["UTF-8"]),
           ("2000 columns", ",".join(map(str, range(2000))) + "\n", ["columns"]),
           ("a camera without images", TABLE + "".join(f"{f},left{f}.jpg,\n" for f in FRAMES), ["right"]),
           ("a time that is no number", "frame,time_s,left,right\n1,noon,left01.jpg,right01.jpg\n", ["time_s", "noon"]),
           ("a height that is NaN", "frame,height_m,left,right\n1,nan,left01.jpg,right01.jpg\n", ["height_m", "nan"])]
    with tempfile.TemporaryDirectory() as folder:
        for what, text, words in bad:
            write_dataset(folder, description, "")
            with open(os.path.join(folder, "frames.csv"), "wb") as file:
                file.write(text if isinstance(text, bytes) else text.encode())
            refused(f"frames.csv: {what}", 1, ["frames.csv", *words], folder)
        os.remove(os.path.join(folder, "frames.csv"))
        refused("frames.csv: missing", 1, ["frames.csv", "No such file"], folder)


def test_points():
    good = points_text(clean["points"])
    row = good.splitlines()[1].split(",")

    def changed(column, text):
        cells = list(row)
        cells[column] = text
        return good.replace(",".join(row), ",".join(cells), 1)

    bad = [("empty", "", []), ("no column", good.replace("x_px", "x", 1), ["x_px"]),
           ("another frame", changed(0, "77"), ["77"]), ("another camera", changed(1, "rear"), ["rear"]),
           ("another size", changed(2, "641"), ["641"]), ("a point too many", changed(4, "54"), ["point", "54"]),
           ("a point below 0", changed(4, "-1"), ["point", "-1"]), ("a point twice", changed(4, "1"), ["point", "twice"]),
           ("NaN", changed(5, "nan"), ["x_px", "nan"]), ("infinity", changed(6, "inf"), ["y_px", "inf"]),
           ("1e400", changed(5, "1e400"), ["x_px", "1e400"]), ("far away", changed(5, "1e8"), ["x_px", "1e8"]),
           ("a negative sigma", changed(7, "-1"), ["sigma_px", "-1"]), ("a word", changed(5, "left"), ["x_px", "left"])]
    with tempfile.TemporaryDirectory() as folder:
        for what, text, words in bad:
            refused(f"points.csv: {what}", 1, ["points.csv", *words], points_set(folder, clean["points"], text))
        os.remove(os.path.join(folder, "points.csv"))
        refused("points.csv: missing", 1, ["points.csv", "No such file"], folder)


# ---- rigs ----


def rig_file(folder, text):
    path = os.path.join(folder, "rig-in.yaml")
    with open(path, "w") as file:
        file.write(text)
    return path


def test_rigs():
    good = clean["rig"]
    rows = [i for i, line in enumerate(good.splitlines()) if line.lstrip().startswith("- [")]
    lines = good.splitlines(keepends=True)

    def without_row():
        return "".join(line for i, line in enumerate(lines) if i != rows[-1])

    def with_row(index, change):
        return "".join(change(line) if i == rows[index] else line for i, line in enumerate(lines))

    def cells(line, change):
        head, body = line.split("[")
        return head + "[" + ", ".join(change(body.rstrip("]\n").split(", "))) + "]\n"

    fx = good.split("fx: ")[1].split(",")[0]
    bad = [("NaN", good.replace(fx, ".nan", 1), ["fx"]), ("a word for a number", good.replace(fx, "wide", 1), ["fx"]),
           ("a negative focal length", good.replace(fx, "-" + fx, 1), ["fx"]),
           ("NaN in the covariance", with_row(0, lambda s: cells(s, lambda c: [".nan", *c[1:]])), ["covariance"]),
           ("a row too few in the covariance", without_row(), ["covariance"]),
           ("a number too few in the covariance", with_row(3, lambda s: cells(s, lambda c: c[:-1])), ["covariance"]),
           ("a covariance that is not symmetric", with_row(0, lambda s: cells(s, lambda c: [c[0], "1.0", *c[2:]])),
            ["symmetric"]),
           ("a negative variance", with_row(0, lambda s: cells(s, lambda c: ["-1.0", *c[1:]])), ["covariance"]),
           ("no quaternion", good.replace("q: [1.0, 0.0", "q: [2.0, 0.0", 1), ["unit quaternion"]),
           ("no rig", "name: x\n", ["not a rig"]), ("a later version", good.replace("rig 1", "rig 99", 1), ["99"]),
           ("cut off", good[:len(good) // 2], []), ("empty", "", ["empty"])]
    with tempfile.TemporaryDirectory() as folder:
        dataset = points_set(folder, clean["points"])
        for what, text, words in bad:
            for command, more in (("calibrate", ["--fix", "left.intrinsics"]), ("rectify", [])):
                refused(f"rig.yaml for {command}: {what}", 1, ["rig-in.yaml", *words], dataset, "--rig",
                        rig_file(folder, text), *more, command=command)
        others = rig_file(folder, good.replace("left", "front").replace("right", "rear"))
        refused("--fix left, rig of other cameras", 2, ["left"], dataset, "--rig", others, "--fix", "left")
        refused("rectify, rig of other cameras", 1, ["front"], dataset, "--rig", others, command="rectify")
        refused("rectify, no such pair", 1, ["rear"], dataset, "--rig", rig_file(folder, good), "--pair", "left,rear",
                command="rectify")
        refused("rectify, points instead of images", 1, ["points"], dataset, "--rig", rig_file(folder, good),
                command="rectify")
        refused("--rig missing", 1, ["nowhere.yaml", "No such file"], dataset, "--rig", "nowhere.yaml", "--fix", "left")
        refused("--clicks missing", 1, ["nowhere.csv", "No such file"], dataset, "--clicks", "nowhere.csv")


# ---- places that cannot be written ----


def nobody():
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)


def short_files():
    """What is longer than 60 kB cannot be written; the signal that goes with it is the shell's default."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)


def leftovers(folder):
    return [name for name in os.listdir(folder) if name.startswith(".")] if os.path.isdir(folder) else []


def test_places():
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        dataset = points_set(os.path.join(folder, "set"), clean["points"])
        file = rig_file(folder, clean["rig"])
        refused("-o is a file", 1, ["rig-in.yaml", "a file"], dataset, out=file)
        refused("-o lies below a file", 1, ["rig-in.yaml"], dataset, out=os.path.join(file, "out"))
        refused("-o is a device", 1, ["/dev/null"], dataset, out="/dev/null")
        refused("-o in /proc", 1, ["/proc/out"], dataset, out="/proc/out")
        refused("-o of 300 letters", 1, ["xxx"], dataset, out=os.path.join(folder, "x" * 300))
        refused("-o is empty", 2, ["-o"], dataset, out="")
        check(open(file).read() == clean["rig"], "and the file stays as it was")

        out = os.path.join(folder, "out")
        os.mkdir(out)
        os.symlink("/dev/full", os.path.join(out, "report.html"))
        refused("a product that is a full device", 1, ["report.html", "device"], dataset, out=out)
        check(not leftovers(out) and "result.yaml" not in os.listdir(out), "no temporary file, and no result")
        shutil.rmtree(out)
        refused("a limit on the size of files", 1, ["cannot be written", "File too large"], dataset, out=out,
                before=short_files)
        check(not leftovers(out) and "result.yaml" not in os.listdir(out), "no temporary file, and no result")
        with open("/dev/full", "w") as full:
            done = subprocess.run([PROGRAM, "calibrate", dataset, "-o", out, "--json"], stdout=full, encoding="utf-8",
                                  stderr=subprocess.PIPE)
        check(done.returncode == 1 and not fault_of_sentence(done.stderr, "calibrate"),
              f"standard output on a full disk: {shortened(done.stderr)}")
        full_disk(folder, dataset)

        os.chmod(out, 0o555)
        if os.geteuid() != 0:
            nobody_else = None
        else:
            nobody_else = nobody
            try:
                subprocess.run([PROGRAM, "--version"], check=True, preexec_fn=nobody, capture_output=True)
            except (OSError, subprocess.SubprocessError):
                skip("a folder that may not be written to: another user cannot run the program")
                return
        for name in os.listdir(out):
            os.remove(os.path.join(out, name))
        refused("-o may not be written to", 1, [out, "Permission denied"], dataset, out=out, before=nobody_else)
        refused("-o may not be made", 1, ["Permission denied"], dataset, out=os.path.join(out, "below"),
                before=nobody_else)
        check(not os.listdir(out), "nothing was written there")
        os.chmod(out, 0o755)


def full_disk(folder, dataset):
    disk = os.path.join(folder, "disk")
    os.mkdir(disk)
    mounted = shutil.which("mount") and subprocess.run(["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", disk],
                                                       capture_output=True).returncode == 0
    if not mounted:
        skip("a full disk: none can be mounted here")
        return
    try:
        out = os.path.join(disk, "out")
        refused("a full disk", 1, ["No space left", "free some space"], dataset, out=out)
        check(not leftovers(out) and "result.yaml" not in os.listdir(out), "no temporary file, and no result")
    finally:
        subprocess.run(["umount", disk], check=True)


# ---- being stopped ----


def long_set(folder, times):
    lines = [f"{k}-{f},left{f}.jpg,right{f}.jpg\n" for k in range(times) for f in FRAMES]
    return write_dataset(folder, f"name: long\nroot: {IMAGES}\n{TARGET}{CAMERAS}", TABLE + "".join(lines))


def stop(folder, dataset, number, trigger, count, delay):
    """Sends a signal `delay` seconds after `trigger` came up for the `count`-th time on standard error. Checks that the job
    ends and leaves nothing."""
    out, log = os.path.join(folder, "out"), os.path.join(folder, "log")
    with open(log, "w") as errors:
        job = subprocess.Popen([PROGRAM, "calibrate", dataset, "-o", out, "-v"], stdout=subprocess.DEVNULL, stderr=errors)
    while job.poll() is None and open(log).read().count(trigger) < count:
        time.sleep(0.005)
    time.sleep(delay)
    job.send_signal(number)
    sent = time.monotonic()
    try:
        job.wait(60)
    except subprocess.TimeoutExpired:
        job.kill()
    line = (open(log).read().splitlines(keepends=True) or [""])[-1]
    check(job.wait() == 1 and not fault_of_sentence(line, "calibrate") and ("interrupted" in line or "cancelled" in line),
          f"{signal.Signals(number).name} {delay} s after '{trigger}' no. {count}: {line.strip()} "
          f"({time.monotonic() - sent:.2f} s later)")
    check(not os.path.exists(out) or not os.listdir(out), "  and nothing is written")


def test_interrupts():
    with tempfile.TemporaryDirectory() as folder:
        dataset = long_set(folder, 4)
        moments = [("reading", 1, 0), ("reading", 1, 0.3), ("least_squares", 1, 0), ("least_squares", 2, 0.1)]
        for i, moment in enumerate(moments):
            stop(folder, dataset, (signal.SIGINT, signal.SIGTERM)[i % 2], *moment)
        for number in (signal.SIGINT, signal.SIGTERM):
            out = os.path.join(folder, "rectified")
            job = subprocess.Popen([PROGRAM, "rectify", dataset, "--rig", rig_file(folder, clean["rig"]), "-o", out],
                                   stderr=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8")
            while not (os.path.isdir(out) and os.listdir(out)) and job.poll() is None:
                time.sleep(0.01)
            job.send_signal(number)
            errors = job.communicate(timeout=60)[1]
            names = os.listdir(out)
            good = all(cv2.imread(os.path.join(out, n)) is not None for n in names)
            check(job.returncode == 1 and "interrupted" in errors and not fault_of_sentence(errors, "rectify"),
                  f"rectify, {signal.Signals(number).name}: {errors.strip()}")
            check(good and "result.yaml" not in names, f"  the {len(names)} images written are whole")
            shutil.rmtree(out)


def broken_products(folder):
    """Names of products that are not whole; temporary files do not count, their names say what they are."""
    broken = []
    for name in os.listdir(folder) if os.path.isdir(folder) else []:
        if name.startswith(".teledimos-") and name.endswith(".tmp"):
            continue
        with open(os.path.join(folder, name)) as file:
            text = file.read()
        whole = text.endswith("\n")
        if name == "report.html":
            whole = text.rstrip().endswith("</html>")
        elif name == "points.csv":
            whole = whole and text.count("\n") == clean["rows"]
        elif name == "log.jsonl":
            whole = whole and all(json.loads(line) for line in text.splitlines())
        elif yaml_reader and name.endswith(".yaml"):
            try:
                keys = yaml_reader.safe_load(text)
                whole = whole and ("provenance" in keys or "products" in keys)
            except yaml_reader.YAMLError:
                whole = False
        if not whole:
            broken.append(name)
    return broken


def contents(folder):
    return {name: open(os.path.join(folder, name), "rb").read()
            for name in ("rig.yaml", "result.yaml", "report.html", "points.csv")}


def kill_when(dataset, out, trigger, delay):
    """Kills the job as soon as `trigger` is a name in its folder (None: at once), and `delay` seconds."""
    job = subprocess.Popen([PROGRAM, "calibrate", dataset, "-o", out, "-q"], stdout=subprocess.DEVNULL)
    while trigger and job.poll() is None:
        if os.path.isdir(out) and any(trigger in name for name in os.listdir(out)):
            break
    time.sleep(delay)
    job.kill()
    return job.wait()


def test_kills():
    with tempfile.TemporaryDirectory() as folder:
        dataset, whole = points_set(folder, clean["points"]), os.path.join(folder, "whole")
        begun = time.monotonic()
        run("calibrate", dataset, "-o", whole)
        took = time.monotonic() - begun
        with open(os.path.join(whole, "points.csv")) as file:
            clean["rows"] = file.read().count("\n")
        check(not broken_products(whole), "an undisturbed run's products are whole")
        moments = [(".tmp", 0), ("points.csv", 0), ("points.csv", 0.002), ("report.html", 0), ("rig.yaml", 0),
                   ("log.jsonl", 0), (None, took / 2), (None, took)]
        if SANITIZED:
            moments = moments[:7:2]
        killed, broken = 0, []
        for trigger, delay in moments:
            out = os.path.join(folder, "out")
            killed += kill_when(dataset, out, trigger, delay) == -signal.SIGKILL
            broken += broken_products(out)
            status, _, errors = run("calibrate", dataset, "-o", out, "-q")
            if status != 0 or contents(out) != contents(whole):
                broken.append(f"after {trigger} + {delay:.3f} s: status {status}, {errors}")
            shutil.rmtree(out)
        check(killed >= len(moments) // 2 and not broken,
              f"killed {killed} times at {len(moments)} moments: every product is whole, a new run gives the same bytes {broken}")


if not os.path.isdir(IMAGES):
    skip("opencv-doc is not installed")
    finish()
prepare()
test_numbering()
test_swaps()
test_outlying_corners()
test_board_size()
test_blur()
test_other_board()
test_images()
test_few_views()
test_weak_views()
test_descriptions()
test_tables()
test_points()
test_rigs()
test_places()
if not SANITIZED:
    test_interrupts()
test_kills()
finish()
