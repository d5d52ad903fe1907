"""Proves: teledimos target draws at true scale (SVG, PDF and PNG read back with other programs), on the page asked for, with
the largest board that fits; corrects a printer's scale; gives the same bytes twice; refuses what it cannot draw, names the
option and says what would fit; its boards are those that OpenCV draws and finds; its line of dataset.yaml is one that
calibrate takes; and it starts in milliseconds.

Reference: SVG's own numbers, pdftoppm and rsvg-convert for the files, OpenCV 4.6 for charucos and corners. Tolerances: a pixel
of the rendering. Blind to: paper and printers."""

import json
import os
import re
import subprocess
import tempfile
import time
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import yaml

from common import SANITIZED, check, fault_of_sentence, finish, run, skip

SVG = "{http://www.w3.org/2000/svg}"
folder = tempfile.TemporaryDirectory()


def path(name):
    return os.path.join(folder.name, name)


def draw(kind, name, *options):
    status, text, errors = run("target", kind, "-o", path(name), "--json", *options)
    if status != 0:
        check(False, f"target {kind} {' '.join(map(str, options))}: {errors.strip()}")
        return None
    return json.loads(text)


def tool(*arguments):
    """Runs another program; False when it is not installed."""
    try:
        return subprocess.run(arguments, capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


# ---- SVG: sizes in mm ----

result = draw("chessboard", "board.svg", "--columns", 5, "--rows", 4, "--spacing-mm", 29.5)
root = ElementTree.parse(path("board.svg")).getroot()
check(root.get("width") == "297mm" and root.get("height") == "210mm" and root.get("viewBox") == "0 0 297 210",
      "a sheet of A4, in mm, on its side")
squares = [r for r in root.iter(SVG + "rect") if r.get("width") == "29.5" and r.get("height") == "29.5"]
check(len(squares) == 15, "15 dark squares of 29.5 mm")
x = sorted({float(s.get("x")) for s in squares})
check(np.allclose(np.diff(x), 29.5, atol=1e-6) and len(x) == 6, "29.5 mm from column to column")
first = min(squares, key=lambda s: float(s.get("x")) + float(s.get("y")))
check(float(first.get("x")) == x[0], "the upper left square is dark")
texts = [t.text for t in root.iter(SVG + "text")]
check(result["dataset_line"] in texts and any("100 %" in t for t in texts), "its parameters stand beside it")
ticks = [p for p in root.iter(SVG + "path")]
across = [float(m) for m in re.findall(r"M([\d.]+) ", ticks[0].get("d"))]
check(abs(max(across) - min(across) - 150) < 0.2, "a ruler of 150 mm")
lowest = max(float(s.get("y")) for s in squares) + 29.5
heights = [float(m) for m in re.findall(r"M[\d.]+ ([\d.]+)H", ticks[0].get("d"))]
check(min(heights) - lowest >= 14.75 - 1e-6, "half a square of white below")

# ---- The same lengths in pixels ----


def black_runs(image, dpi, what):
    """Squares of 29.5 mm along the first row of the board, in a picture of the whole sheet."""
    grey = cv2.imread(image, cv2.IMREAD_GRAYSCALE)
    if grey is None or abs(grey.shape[1] - 297 / 25.4 * dpi) > 1.5:
        check(False, f"{what}: not a picture of the sheet")
        return
    y = round((float(first.get("y")) + 15) / 25.4 * dpi)
    edges = np.flatnonzero(np.diff((grey[y] < 128).astype(int)))
    edges = edges[edges > (x[0] - 5) / 25.4 * dpi] / dpi * 25.4
    good = len(edges) == 6 and np.allclose(np.diff(edges), 29.5, atol=1.5 * 25.4 / dpi)
    check(good, f"{what}: squares of 29.5 mm at {dpi} dpi")


draw("chessboard", "board.pdf", "--columns", 5, "--rows", 4, "--spacing-mm", 29.5)
draw("chessboard", "board.png", "--columns", 5, "--rows", 4, "--spacing-mm", 29.5, "--dpi", 254)
black_runs(path("board.png"), 254, "PNG")
if tool("pdftoppm", "-r", "200", "-png", "-singlefile", path("board.pdf"), path("from_pdf")):
    black_runs(path("from_pdf.png"), 200, "PDF by pdftoppm")
else:
    skip("PDF: pdftoppm is not installed")
if tool("rsvg-convert", "-d", "200", "-p", "200", "-o", path("from_svg.png"), path("board.svg")):
    black_runs(path("from_svg.png"), 200, "SVG by rsvg-convert")
else:
    skip("SVG: rsvg-convert is not installed")

# ---- Bytes ----

for kind in ("chessboard", "marks", "aprilgrid", "charuco", "tags"):
    for ending in ("svg", "pdf", "png"):
        draw(kind, "a." + ending, "--dpi", 100)
        time.sleep(1.1 if (kind, ending) == ("tags", "pdf") else 0)  # a date would have changed
        draw(kind, "b." + ending, "--dpi", 100)
        same = open(path("a." + ending), "rb").read() == open(path("b." + ending), "rb").read()
        check(same, f"{kind}.{ending}: the same bytes twice")
check(b"CreationDate" not in open(path("a.pdf"), "rb").read(), "no date in a PDF")
check(tool("env", "FONTCONFIG_FILE=/dev/null", "HOME=/nonexistent", os.environ["TELEDIMOS"], "target", "chessboard", "-o",
           path("plain.pdf"), "-q"), "drawn without any fonts installed")

# ---- A printer's scale ----

draw("chessboard", "scaled.svg", "--spacing-mm", 20, "--measured", "202/200,147/150")
widths = {(r.get("width"), r.get("height")) for r in ElementTree.parse(path("scaled.svg")).getroot().iter(SVG + "rect")}
wanted = (20 / 1.01, 20 / 0.98)
check(any(np.allclose((float(w), float(h)), wanted, atol=2e-6) for w, h in widths if w and "m" not in w),
      "--measured: squares divided by 1.01 across and 0.98 down")

# ---- Fitting ----

for kind, lead in (("chessboard", "spacing-mm"), ("charuco", "spacing-mm"), ("aprilgrid", "tag-size-mm"), ("marks", "spacing-mm"),
                   ("tags", "tag-size-mm")):
    status, _, errors = run("target", kind, "-o", path("large.svg"), f"--{lead}", 90 if kind != "tags" else 250)
    size = re.search(rf"largest --{lead} that fits is (\d+)", errors)
    check(status == 2 and size and not fault_of_sentence(errors, "target") and not os.path.exists(path("large.svg")),
          f"{kind}, too large: {errors.strip()}")
    if not size:
        continue
    check(run("target", kind, "-o", path("fits.svg"), f"--{lead}", size.group(1))[0] == 0, f"{kind}: what it says fits does")
    check(run("target", kind, "-o", path("fits.svg"), f"--{lead}", int(size.group(1)) + 1)[0] == 2, f"{kind}: one mm more does not")
    largest = draw(kind, "own.svg")["dataset_line"]
    same = draw(kind, "own.svg", f"--{lead}", size.group(1))["dataset_line"]
    check(largest == same, f"{kind}: without a size, the largest that fits")
fit = draw("chessboard", "fit.svg", "--page", "fit", "--spacing-mm", 50)
check(fit["page_size_m"][0] > 0.55, "--page fit is as large as needed")

# ---- Bad options ----

for words, options in ((["9x9", "chessboard"], ["9x9"]), (["--measured", "scale"], ["chessboard", "--measured", "300/200"]),
                       (["--measured"], ["chessboard", "--measured", "abc"]), (["--page", "a9"], ["chessboard", "--page", "a9"]),
                       (["--diameter-mm", "chessboard"], ["chessboard", "--diameter-mm", "5"]),
                       (["--dictionary", "aruco9x9"], ["charuco", "--dictionary", "aruco9x9"]),
                       (["aruco4x4_50", "50", "0 to 65"], ["charuco", "--dictionary", "aruco4x4_50", "--columns", "11", "--rows", "10"]),
                       (["--ids", "5-2"], ["tags", "--ids", "5-2"]), (["tag16h5", "99"], ["tags", "--dictionary", "tag16h5", "--ids", "99"]),
                       (["--columns", "0"], ["chessboard", "--columns", "0"]), (["diameter_m"], ["marks", "--diameter-mm", "60", "--spacing-mm", "30"]),
                       (["--margin-mm", "-1"], ["chessboard", "--margin-mm", "-1"]), (["tag_size_m"], ["charuco", "--tag-size-mm", "40", "--spacing-mm", "20"])):
    status, text, errors = run("target", *options, "-o", path("bad.svg"))
    missing = [w for w in words if w not in errors]
    check(status == 2 and not text and not missing and not fault_of_sentence(errors, "target"), f"{' '.join(options)}: {errors.strip()} {missing or ''}")
check(not os.path.exists(path("bad.svg")), "no drawing is left by bad options")
status, _, errors = run("target", "chessboard", "-o", path("board.gif"))
check(status == 2 and ".svg" in errors, f"another ending: {errors.strip()}")
status, _, errors = run("target", "chessboard", "-o", path("none/board.svg"))
check(status == 1 and "none" in errors, f"no such folder: {errors.strip()}")
status, _, errors = run("target", "chessboard")
check(status == 2 and "-o FILE is missing" in errors, errors.strip())

# ---- As OpenCV draws and finds ----

draw("charuco", "charuco.png", "--columns", 6, "--rows", 4, "--spacing-mm", 20, "--tag-size-mm", 14, "--dpi", 254, "--page", "fit", "--no-text",
     "--no-ruler", "--dictionary", "aruco5x5_100")
ours = cv2.imread(path("charuco.png"), cv2.IMREAD_GRAYSCALE)[100:-100, 100:-100]  # without its white: half a square
dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
board = cv2.aruco.CharucoBoard_create(7, 5, 0.02, 0.014, dictionary)
theirs = board.draw((1400, 1000))
apart = cv2.erode((np.abs(ours.astype(int) - theirs) > 128).astype(np.uint8), np.ones((3, 3))) if ours.shape == theirs.shape else None
check(apart is not None and not apart.any(), "a charuco as OpenCV's CharucoBoard draws it, but for its rounding to a pixel")

warp = np.array([[0.45, 0.05, 60], [-0.04, 0.47, 90], [6e-5, -4e-5, 1]])
picture = cv2.imread(path("charuco.png"), cv2.IMREAD_GRAYSCALE)
view = cv2.warpPerspective(cv2.GaussianBlur(picture, (0, 0), 1.5), warp, (800, 700), flags=cv2.INTER_AREA, borderValue=255)
corners, ids, _ = cv2.aruco.detectMarkers(view, dictionary)
number = 0 if ids is None else cv2.aruco.interpolateCornersCharuco(corners, ids, view, board)[0]
check(number == 24, f"OpenCV finds {number} of the charuco's 24 corners in perspective")

# ---- Drawn, seen and calibrated ----


def photograph(board_image, pose, pixel_per_m, origin):
    """A view by a pinhole camera (f 800 px, 800x600) of the sheet on the plane z = 0 of the board's frame."""
    rotation, translation = cv2.Rodrigues(np.array(pose[:3]))[0], np.array(pose[3:])
    camera = np.array([[800, 0, 399.5], [0, 800, 299.5], [0, 0, 1.0]])
    image_from_m = camera @ np.column_stack([rotation[:, 0], rotation[:, 1], translation])
    image_from_px = image_from_m @ np.array([[1 / pixel_per_m, 0, -origin[0] / pixel_per_m], [0, 1 / pixel_per_m, -origin[1] / pixel_per_m], [0, 0, 1]])
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    large = cv2.warpPerspective(board_image, fine @ image_from_px, (3200, 2400), flags=cv2.INTER_LINEAR, borderValue=255)
    return cv2.GaussianBlur(cv2.resize(large, (800, 600), interpolation=cv2.INTER_AREA), (0, 0), 0.6)


def calibrates(kind, *options):
    result = draw(kind, "seen.png", "--spacing-mm", 20, "--page", "fit", "--no-text", "--no-ruler", "--dpi", 254, *options)
    sheet = cv2.imread(path("seen.png"), cv2.IMREAD_GRAYSCALE)
    target = yaml.safe_load(result["dataset_line"])["target"]
    home = path("set_" + kind)
    os.makedirs(home, exist_ok=True)
    generator = np.random.default_rng(1)
    names = []
    middle = np.array([(target["columns"] - 1) * 0.01, (target["rows"] - 1) * 0.01, 0])
    centre = (np.array(sheet.shape[::-1]) - 1) / 2
    origin = centre - middle[:2] * 10000
    for k in range(14):
        lean = generator.uniform(-0.5, 0.5, 3) * [1, 1, 0.5]
        away = np.array([generator.uniform(-0.04, 0.04), generator.uniform(-0.03, 0.03), generator.uniform(0.28, 0.4)])
        offset = away - cv2.Rodrigues(lean)[0] @ middle
        image = photograph(sheet, [*lean, *offset], 10000, origin)
        cv2.imwrite(os.path.join(home, f"v{k:02}.png"), image)
        names.append(f"v{k:02}.png")
    with open(os.path.join(home, "dataset.yaml"), "w") as file:
        file.write(f"name: drawn\ncameras: [{{name: camera, model: pinhole}}]\n{result['dataset_line']}\n")
    with open(os.path.join(home, "frames.csv"), "w") as file:
        file.write("frame,camera\n" + "".join(f"{n[:-4]},{n}\n" for n in names))
    status, text, errors = run("calibrate", home, "-o", os.path.join(home, "out"), "--json", "--accept")
    if status not in (0, 3):
        check(False, f"{kind}: calibrate ended with {status}: {errors.strip()}")
        return
    camera = json.loads(text)["cameras"]["camera"]
    focal = camera["intrinsics"][0]
    check(camera["rms_px"] < 0.1 and abs(focal - 800) < 4, f"{kind}: drawn, seen and calibrated: RMS {camera['rms_px']:.3f} px, focal length {focal:.1f} px")


calibrates("chessboard", "--columns", 8, "--rows", 5)
calibrates("charuco", "--columns", 8, "--rows", 5)

# ---- Start ----

times = []
for _ in range(7):
    start = time.monotonic()
    run("target", "chessboard", "-o", path("t.svg"))
    times.append(time.monotonic() - start)
if SANITIZED:
    skip("time to start: a sanitized build")
else:
    check(sorted(times)[3] < 0.25, f"drawn within {1e3 * sorted(times)[3]:.0f} ms")

folder.cleanup()
finish()
