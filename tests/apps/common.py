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


def run(*arguments, env=None, timeout=300, cwd=None, before=None):
    """Exit status (None: it hung), standard output, standard error; before() is called in the child."""
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
