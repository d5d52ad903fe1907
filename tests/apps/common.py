"""Running commands, reading their results: what the command tests share."""

import base64
import csv
import json
import os
import subprocess
import sys
import tempfile

PROGRAM = os.environ["TELEDIMOS"]
SOURCE = os.environ["TELEDIMOS_SOURCE"]
COMMANDS = ("calibrate", "capture", "check", "compare", "convert", "hand-eye", "match", "measure", "reconstruct", "rectify",
            "rehearse", "render", "servo", "simulate", "target", "vehicle")
ENVIRONMENT = {"PATH": os.path.dirname(PROGRAM) + ":" + os.environ["PATH"]}  # where examples find the program
FULL = os.environ.get("TELEDIMOS_FULL", "0") not in ("", "0")
SANITIZED = "debug" in PROGRAM
VERBOSE = os.environ.get("TELEDIMOS_VERBOSE", "0") not in ("", "0")
if SANITIZED:  # the sanitizer's dlopen does not look where the program says
    os.environ["LD_LIBRARY_PATH"] = os.path.join(os.path.dirname(PROGRAM), "../lib")
quick = False  # calibrations without the choice of models, for tests that are slow when sanitized
failures = []
passed = 0
skipped = 0


def check(condition, text):
    """A line for each thing that fails; the run goes on so that all failures are seen. TELEDIMOS_VERBOSE=1 adds what holds,
    which a log that is cut short would show instead."""
    global passed
    if VERBOSE or not condition:
        print(("ok      " if condition else "FAILED  ") + text, flush=True)
    if condition:
        passed += 1
    else:
        failures.append(text)


def skip(text):
    global skipped
    skipped += 1
    print("skipped " + text, flush=True)


def finish():
    print(f"{passed} passed, {len(failures)} failed, {skipped} skipped")
    sys.exit(1 if failures else 0)


def schema_fault(value, schema, path="message"):
    """What of a value is not as its JSON schema says; "" when all is. Fields the schema does not know are faults."""
    if "oneOf" in schema:
        return "" if value in [c["const"] for c in schema["oneOf"]] else f"{path}: {value} is no choice"
    kind = schema["type"]
    right = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "number": (int, float), "null": type(None)}
    if isinstance(kind, list):
        found = [schema_fault(value, {**schema, "type": one}, path) for one in kind]
        return "" if "" in found else found[0]
    if not isinstance(value, right[kind]) or (kind in ("integer", "number") and isinstance(value, bool)):
        return f"{path}: is no {kind}"
    if kind == "integer" and not schema.get("minimum", value) <= value <= schema.get("maximum", value):
        return f"{path}: {value} is out of range"
    if schema.get("contentEncoding") == "base64":
        base64.b64decode(value, validate=True)
    if kind == "array":
        return next(filter(None, (schema_fault(v, schema["items"], f"{path}[]") for v in value)), "")
    if kind == "object":
        known = set(schema["properties"])
        if not set(schema.get("required", known)) <= set(value) <= known:
            return f"{path}: has fields {sorted(value)}"
        return next(filter(None, (schema_fault(v, schema["properties"][k], f"{path}.{k}") for k, v in value.items())), "")
    return ""


def run(*arguments, env=None, timeout=300, cwd=None, before=None):
    """Exit status (None: it hung), standard output, standard error; before() is called in the child."""
    if quick and arguments and arguments[0] == "calibrate":
        arguments = (*arguments, "--no-models")
    environment = dict(os.environ, **(env or {}))
    try:
        done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, encoding="utf-8", errors="replace",
                              timeout=timeout, env=environment, cwd=cwd, preexec_fn=before)
    except subprocess.TimeoutExpired:
        return None, "", f"no answer within {timeout} s"
    return done.returncode, done.stdout, done.stderr


def fault_of_sentence(errors, command):
    """What keeps standard error from being one clear sentence; "" when nothing does."""
    if not errors.endswith("\n") or errors.count("\n") != 1:
        return "not one line"
    if not errors.startswith(f"teledimos {command}: "):
        return f"does not begin with 'teledimos {command}: '"
    if len(errors) > 700 or "\ufffd" in errors or any(ord(c) < 32 for c in errors[:-1]):
        return "too long, or not plain text"
    return ""


def refused(what, status, words, *arguments, command="calibrate", out=None, **how):
    """Shows that a bad job ends with `status`, one sentence that holds all `words`, and no product. Returns the sentence."""
    with tempfile.TemporaryDirectory() as folder:
        target = os.path.join(folder, "out") if out is None else out
        code, text, errors = run(command, *arguments, "-o", target, **dict({"timeout": 60}, **how))
        faults = [fault_of_sentence(errors, command)]
        if code != status:
            faults.append(f"status {code} instead of {status}")
        faults += [f"'{word}' is not named" for word in words if word not in errors]
        if text:
            faults.append("something on standard output")
        if out is None and os.path.isdir(target) and os.listdir(target):
            faults.append(f"left {os.listdir(target)}")
    faults = [fault for fault in faults if fault]
    check(not faults, f"{what}: {shortened(errors)}" + "".join(f" [{fault}]" for fault in faults))
    return errors


def shortened(errors):
    """A message for one line of a log: without the temporary folder, and not endless."""
    text = errors.strip().replace(tempfile.gettempdir() + "/", "").replace("\n", "\\n")
    return text if len(text) < 300 else text[:300] + "…"


def calibrate(dataset, *arguments, out=None, expect=0):
    """The result of a calibration as a dictionary; None (and a failure) when it ended otherwise than expected."""
    with tempfile.TemporaryDirectory() as folder:
        out = out or os.path.join(folder, "out")
        status, text, errors = run("calibrate", dataset, "-o", out, "--json", *arguments)
        if status != expect:
            check(False, f"calibrate {dataset} {' '.join(map(str, arguments))} ended with {status}: {errors.strip()}")
            return None
        return json.loads(text)


def read_points(path):
    """points.csv as {(frame, camera): {point: (x, y)}}."""
    views = {}
    with open(path, newline="") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        for row in rows:
            view = views.setdefault((row["frame"], row["camera"]), {})
            view[int(row["point"])] = (float(row["x_px"]), float(row["y_px"]))
    return views


def write_dataset(folder, yaml, frames):
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, "dataset.yaml"), "w") as file:
        file.write(yaml)
    with open(os.path.join(folder, "frames.csv"), "w") as file:
        file.write(frames)
    return folder


# ---- datasets made of OpenCV's 13 stereo pairs ----

OPENCV_SET = os.path.join(SOURCE, "datasets/opencv-stereo")
IMAGES = "/usr/share/doc/opencv-doc/examples/data"
FRAMES = ["01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14"]
COLUMNS, ROWS, SPACING = 9, 6, 0.025
TARGET = "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n"
CAMERAS = "cameras:\n  - {name: left, model: brown5}\n  - {name: right, model: brown5}\n"
TABLE = "frame,left,right\n"


def image_set(folder, change=None, root=IMAGES, frames=FRAMES, times=1):
    """The pairs of `frames`, each so many times; change: {frame: {camera: path}}."""
    rows = {frame: {"left": f"left{frame}.jpg", "right": f"right{frame}.jpg"} for frame in frames}
    for frame, images in (change or {}).items():
        rows.setdefault(frame, {}).update(images)
    table = TABLE + "".join(f"{k if k else ''}{frame},{row['left']},{row['right']}\n" for k in range(times)
                            for frame, row in rows.items())
    return write_dataset(folder, f"name: pairs\nroot: {root}\n{TARGET}{CAMERAS}", table)


def points_text(points, cameras=None):
    """{(frame, camera): {point: (x, y)}} as CSV; cameras: {name: the name it has in `points`}."""
    cameras = cameras or {name: name for name in sorted({camera for _, camera in points})}
    lines = ["frame,camera,width_px,height_px,point,x_px,y_px,sigma_px"]
    for frame in sorted({frame for frame, _ in points}):
        for camera, source in cameras.items():
            view = points.get((frame, source), {})
            lines += [f"{frame},{camera},640,480,{i},{x!r},{y!r},0.05" for i, (x, y) in sorted(view.items())]
    return "\n".join(lines) + "\n"


def points_set(folder, points, text=None, extra="", target=TARGET, cameras=None):
    """A dataset whose points are given instead of images: those of `points`, or the text itself."""
    cameras = cameras or {name: name for name in sorted({camera for _, camera in points})}
    yaml = f"name: points\ncorners: points.csv\n{target}{extra}cameras:\n"
    yaml += "".join(f"  - {{name: {camera}, model: brown5}}\n" for camera in cameras)
    frames = sorted({frame for frame, _ in points})
    write_dataset(folder, yaml, ",".join(["frame", *cameras]) + "\n" +
                  "".join(frame + "," * len(cameras) + "\n" for frame in frames))
    with open(os.path.join(folder, "points.csv"), "w") as file:
        file.write(points_text(points, cameras) if text is None else text)
    return folder


def clean_runs():
    """What runs without anything wrong give: `images`, the result from images; `points`, the points they found; `result` and
    `rig`, the result and rig.yaml from those. Ends the tests when they fail."""
    if not os.path.isdir(IMAGES):
        skip("opencv-doc is not installed")
        finish()
    with tempfile.TemporaryDirectory() as folder:
        images = calibrate(OPENCV_SET, out=os.path.join(folder, "images"))
        points = images and read_points(os.path.join(folder, "images/points.csv"))
        result = images and calibrate(points_set(folder, points), out=os.path.join(folder, "out"))
        if not result:
            finish()
        with open(os.path.join(folder, "out/rig.yaml")) as file:
            return {"images": images, "points": points, "result": result, "rig": file.read()}


def views_of(points, frames):
    return {key: view for key, view in points.items() if key[0] in frames}


def rig_file(folder, text):
    path = os.path.join(folder, "rig-in.yaml")
    with open(path, "w") as file:
        file.write(text)
    return path


def leftovers(folder):
    """Hidden files: those that are being written."""
    return [name for name in os.listdir(folder) if name.startswith(".")] if os.path.isdir(folder) else []
