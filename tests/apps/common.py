"""Running commands, reading their results: what the command tests share."""

import csv
import json
import os
import subprocess
import sys
import tempfile

PROGRAM = os.environ["TELEDIMOS"]
SOURCE = os.environ["TELEDIMOS_SOURCE"]
FULL = os.environ.get("TELEDIMOS_FULL", "0") not in ("", "0")
SANITIZED = "debug" in PROGRAM
failures = []
passed = 0
skipped = 0


def check(condition, text):
    """One line for each thing shown; the run goes on so that all failures are seen."""
    global passed
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


def run(*arguments, env=None, timeout=300):
    """Exit status, standard output, standard error."""
    environment = dict(os.environ, **(env or {}))
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=timeout,
                          env=environment)
    return done.returncode, done.stdout, done.stderr


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
