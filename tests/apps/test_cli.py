"""Proves: the commands speak as their help says. Help, man pages, completion, wrong usage; the result's keys, in
JSON and YAML and in the schema, with units; silence where it is asked for; a progress bar on a terminal only.

Reference: the help itself (test_examples.py runs its examples), the schema, groff, bash, and a terminal of one line. Blind to:
whether the texts are well written; terminals other than those that know carriage return and "erase to the end".
"""

import json
import os
import pty
import re
import shutil
import subprocess
import tempfile
import threading

import cv2

from common import (COMMANDS, ENVIRONMENT, IMAGES, OPENCV_SET, PROGRAM, SANITIZED, SOURCE, check, fault_of_sentence, finish, image_set,
                    points_set, read_points, run, shortened, skip)

try:
    import yaml as yaml_reader
except ImportError:
    yaml_reader = None

JOBS = ("calibrate", "rectify")  # whose results are looked at here; the others' in tests of their own


# ---- help ----


def test_help():
    status, text, errors = run("--help")
    check(status == 0 and not errors and all(f"  {name} " in text for name in COMMANDS), "--help names the commands")
    check(run("help")[1] == text and run("-h")[1] == text, "help and -h are --help")
    status, text, errors = run("--version")
    version = re.search(r"project\(teledimos VERSION ([0-9.]+)", open(os.path.join(SOURCE, "CMakeLists.txt")).read())[1]
    check(status == 0 and text == f"teledimos {version}\n" and not errors, f"--version: {text.strip()}")
    for name in COMMANDS:
        status, text, errors = run(name, "--help")
        check(status == 0 and not errors and text.startswith(f"teledimos {name} "), f"{name} --help")
        check(run(name, "-h")[1] == text, f"{name} -h is the same")
        wide = [line for line in text.splitlines() if len(line) > 100 and not line.startswith("  teledimos")]
        check(not wide, f"{name} --help: at most 100 columns {wide[:1]}")
        check(not re.search(r"[ \t]\n", text), f"{name} --help: no blanks at the ends of lines")
        options = re.findall(r"^  (?:-\w, |    )--([a-z-]+)", text, re.M)
        listed = run(name, "--complete")[1].split()
        check(set(listed) == {"--" + o for o in options if o != "help"} and {"json", "output"} <= set(options),
              f"{name}: --help and completion list the same {len(listed)} options")


def test_man_and_completion():
    script = run("--completion")[1]
    done = subprocess.run(["bash", "-n"], input=script, capture_output=True, encoding="utf-8")
    check(done.returncode == 0 and not done.stderr and script, f"--completion is good bash {done.stderr}")

    def completed(*words):
        line = f'{script}\nCOMP_WORDS=({" ".join(words)!s}); COMP_CWORD={len(words) - 1}; _teledimos; echo "${{COMPREPLY[@]}}"'
        return subprocess.run(["bash", "-c", line], capture_output=True, encoding="utf-8", cwd=SOURCE,
                              env={**os.environ, **ENVIRONMENT}).stdout.split()

    check(completed("teledimos", "cal") == ["calibrate"], "'cal' is completed to calibrate")
    check(completed("teledimos", "calibrate", "--no") == ["--no-leave-one-out", "--no-models"], "'calibrate --no' to --no-leave-one-out and --no-models")
    check("datasets" in completed("teledimos", "calibrate", "data"), "'calibrate data' to a folder")
    for name in COMMANDS:
        status, page, errors = run(name, "--man")
        check(status == 0 and not errors and page.startswith(f".TH TELEDIMOS-{name} 1"), f"{name} --man")
        if not shutil.which("groff"):
            skip("groff is not installed")
            continue
        with tempfile.NamedTemporaryFile("w", suffix=".1", encoding="utf-8") as file:
            file.write(page)
            file.flush()
            done = subprocess.run(["groff", "-man", "-Tutf8", "-K", "utf8", "-ww", "-P", "-cbou", file.name],
                                  capture_output=True, encoding="utf-8")
        check(done.returncode == 0 and not done.stderr, f"{name} --man: groff has nothing to say {shortened(done.stderr)}")
        help_text = run(name, "--help")[1]
        lost = [o for o in re.findall(r"--[a-z][a-z-]+", help_text) if o not in done.stdout.replace("‐", "-")]
        check(set(lost) <= {"--help"}, f"{name} --man: every option of --help is there {lost}")
        examples = re.findall(r"^  (teledimos .*)$", help_text, re.M)
        flat = done.stdout.replace("‐", "-")
        check(all(e.split(" -o ")[0] in flat for e in examples), f"{name} --man: and every example")


# ---- wrong usage ----


def test_usage():
    status, text, errors = run()
    check(status == 2 and "Usage" in text + errors, "no command: 2, and the usage")
    bad = [("frobnicate",), ("--frobnicate",), ("Calibrate",)]
    for arguments in bad:
        status, text, errors = run(*arguments)
        check(status == 2 and errors.count("\n") == 1 and arguments[0] in errors and not text,
              f"{' '.join(arguments)}: {errors.strip()}")
    data = OPENCV_SET
    cases = [((), "DATASET"), ((data,), "-o"), ((data, "-o"), "--output"), (("-o", "x"), "DATASET"),
             ((data, "-o", ""), "-o"), ((data, "x", "-o", "y"), "'x'"), ((data, "--frobnicate"), "--frobnicate"),
             ((data, "--Json"), "--Json"), ((data, "-z"), "-z"), ((data, "-qv"), "-qv"), ((data, "--json=1"), "--json"),
             ((data, "--threads"), "--threads"), ((data, "--seed", ""), "--seed"),
             *(((data, "--threads", n), f"'{n}'") for n in ("two", "-1", "1.5", "257", "1e9", "nan", "inf", "1e400", "2x")),
             *(((data, "--seed", n), f"'{n}'") for n in ("-1", "1e10", "0.5"))]
    calibrate_cases = [((data, "--method", "guess"), "homography"), ((data, "--model", "brown6"), "brown5"),
                       ((data, "--warp", "maybe"), "auto"), ((data, "-o", "x", "--gate", "rms_px"), "key=value"),
                       ((data, "-o", "x", "--gate", "rms=1"), "rms_px"), ((data, "-o", "x", "--gate", "=1"), "rms_px"),
                       *(((data, "-o", "x", "--gate", f"rms_px={n}"), f"'{n}'") for n in ("", "low", "-1", "nan", "1px")),
                       ((data, "-o", "x", "--fix", "left"), "--rig"), ((data, *["--gate", "weak=1"] * 65), "--gate")]
    rectify_cases = [((data, "-o", "x"), "--rig"), ((data, "--zoom", "2"), "--zoom"), ((data, "--zoom", "wide"), "'wide'"),
                     ((data, "--rig"), "--rig")]
    for name, more in (("calibrate", calibrate_cases), ("rectify", rectify_cases)):
        for arguments, word in cases + more:
            with tempfile.TemporaryDirectory() as folder:
                status, text, errors = run(name, *arguments, cwd=folder)
                fault = fault_of_sentence(errors, name)
                check(status == 2 and not fault and word in errors and not text and not os.listdir(folder),
                      f"{name} {' '.join(arguments[1:])[:40]}: {shortened(errors)} {fault}")


def test_fix_usage(rig):
    with tempfile.TemporaryDirectory() as folder:
        for what in ("middle", "left.lens", "left.", ".pose", ""):
            status, _, errors = run("calibrate", OPENCV_SET, "-o", "x", "--rig", rig, "--fix", what, cwd=folder)
            check(status == 2 and not fault_of_sentence(errors, "calibrate") and what in errors and not os.listdir(folder),
                  f"--fix '{what}': {shortened(errors)}")
        status, _, errors = run("rectify", OPENCV_SET, "-o", "x", "--rig", rig, "--pair", "left", cwd=folder)
        check(status == 2 and "--pair" in errors and not os.listdir(folder), f"--pair left: {shortened(errors)}")


# ---- results ----


def results():
    """Results of all kinds: {what: (command, result)}, and YAML files beside: a rig of two with an image that has no board,
    one of three cameras, one camera, one that is refused, a rectification."""
    made = {}
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "fruits.png")
        cv2.imwrite(path, cv2.resize(cv2.imread(os.path.join(IMAGES, "fruits.jpg")), (640, 480)))
        dataset = image_set(os.path.join(folder, "pairs"), {"14": {"left": path}})

        def made_by(what, status, command, *arguments):
            out = os.path.join(folder, what.replace(" ", "-"))
            code, text, errors = run(command, *arguments, "-o", out, "--json")
            check(code == status and text.endswith("}\n") and text.startswith("{"),
                  f"{what}: --json gives JSON and ends with {status} {shortened(errors)}")
            if code == status:
                with open(os.path.join(out, "result.yaml")) as file:
                    made[what] = (command, json.loads(text, parse_constant=lambda c: check(False, f"{what}: {c} in JSON")),
                                  file.read())
            return out

        out = made_by("two cameras", 0, "calibrate", dataset)
        points = {key: view for key, view in read_points(os.path.join(out, "points.csv")).items() if key[0] != "14"}
        test_fix_usage(os.path.join(out, "rig.yaml"))
        made_by("rectified pairs", 0, "rectify", dataset, "--rig", os.path.join(out, "rig.yaml"))
        # For the sake of every key: a point that is off, and a view numbered from the other end in one camera.
        points[("02", "left")][7] = (points[("02", "left")][7][0] + 5, points[("02", "left")][7][1])
        points[("05", "right")] = {53 - i: xy for i, xy in points[("05", "right")].items()}
        three = points_set(os.path.join(folder, "three"), points,
                           cameras={"left": "left", "right": "right", "third": "right"})
        made_by("three cameras", 0, "calibrate", three)
        one = points_set(os.path.join(folder, "one"), points, cameras={"left": "left"})
        made_by("one camera", 0, "calibrate", one, "--plain", "--no-leave-one-out")
        made_by("a refused one", 3, "calibrate", one, "--gate", "rms_px=0.001")
        made_by("a held one", 0, "calibrate", three, "--rig", os.path.join(out, "rig.yaml"), "--fix", "left")
    return made


def schema_of(command):
    """[(path, type, nullable, optional)] of --schema; a path is a tuple of keys, "*" and "[]"."""
    status, text, errors = run(command, "--schema")
    rows = []
    for line in text.splitlines():
        path, kind, explanation = re.split(r"  +", line.strip(), maxsplit=2)
        kind, _, optional = kind.partition(", ")
        rows.append((tuple(path.replace("[]", ".[]").split(".")), kind.replace(" or null", ""), kind.endswith(" or null"),
                     optional == "optional"))
    check(status == 0 and not errors and len(rows) >= 10, f"{command} --schema: {len(rows)} keys, each with type and meaning")
    return rows


def mappings(value, path=()):
    """Every mapping of a result with its path; elements of lists are at "[]"."""
    if isinstance(value, dict):
        yield path, value
        for key, child in value.items():
            yield from mappings(child, (*path, key))
    elif isinstance(value, list):
        for element in value:
            yield from mappings(element, (*path, "[]"))


def values(result):
    """Every key's path with its value."""
    for path, mapping in mappings(result):
        for key, value in mapping.items():
            yield (*path, key), value


def fits(pattern, path):
    return len(pattern) == len(path) and all(a in ("*", b) for a, b in zip(pattern, path))


KINDS = {"mapping": lambda v: isinstance(v, dict), "text": lambda v: isinstance(v, str),
         "list of mappings": lambda v: isinstance(v, list) and all(isinstance(e, dict) for e in v),
         "list of texts": lambda v: isinstance(v, list) and all(isinstance(e, str) for e in v),
         "number": lambda v: isinstance(v, (int, float)) and not isinstance(v, bool),
         "list of numbers": lambda v: isinstance(v, list) and all(isinstance(e, (int, float, type(None))) for e in v),
         "matrix": lambda v: isinstance(v, list) and len({len(row) for row in v}) == 1,
         "whole number": lambda v: isinstance(v, int) and not isinstance(v, bool),
         "true or false": lambda v: isinstance(v, bool)}


def test_schema(made):
    for command in JOBS:
        rows = schema_of(command)
        used, unknown, wrong = set(), set(), set()
        for what, (by, result, _) in made.items():
            for path, value in values(result) if by == command else ():
                matching = [row for row in rows if fits(row[0], path)]
                if not matching:
                    unknown.add(".".join(path))
                    continue
                row = min(matching, key=lambda r: r[0].count("*"))
                used.add(row[0])
                if not (KINDS[row[1]](value) or (value is None and row[2])):
                    wrong.add(f"{what}: {'.'.join(path)} is no {row[1]}")
        check(not unknown, f"{command}: every key of the results is in --schema {sorted(unknown)[:5]}")
        check(not wrong, f"{command}: every value has its type {sorted(wrong)[:5]}")
        unused = [".".join(row[0]) for row in rows if row[0] not in used]
        check(not unused, f"{command}: every key of --schema is in some result {unused}")
        lost = {".".join(pattern) for by, result, _ in made.values() if by == command for pattern, _, _, optional in rows
                for path, mapping in mappings(result)
                if not optional and pattern[-1] not in ("*", *mapping) and fits(pattern[:-1], path)}
        check(not lost, f"{command}: nothing that is not optional is ever missing {sorted(lost)}")


# Numbers without a unit: counts, ratios and shares, and vectors whose elements are named by `order`, or are a rotation.
UNITLESS = {"right", "left", "lower", "upper", "image_share", "views", "points", "outliers", "outlier_points", "point", "pairs", "chi2_per_dof", "scale_error", "scale_error_rms",
            "intrinsics", "distortion", "sigma_intrinsics", "sigma_distortion", "q", "perspective_matrix", "essential_matrix",
            "fundamental_matrix"}


def test_units(made):
    seen = set()
    for command in JOBS:
        bad = set()
        for by, result, _ in made.values():
            for path, value in values(result) if by == command else ():
                while isinstance(value, list) and value:
                    value = value[0]
                number = isinstance(value, (int, float)) and not isinstance(value, bool)
                unit = r"_(px|m|mm|deg|s)$"
                if number and not re.search(unit, path[-1]) and not (len(path) > 1 and re.search(unit, path[-2])):
                    seen.add(path[-1])
                    if path[-1] not in UNITLESS:
                        bad.add(path[-1])
        check(not bad, f"{command}: every number with a unit has it in its name {sorted(bad)}")
    check(seen == UNITLESS, f"and the list of those without is not longer than it need be {sorted(UNITLESS - seen)}")
    for what, (command, result, _) in made.items():
        for name, camera in result.get("cameras", {}).items():
            count = len(camera["intrinsics"]) + len(camera["distortion"])
            check(len(camera["order"]) == count, f"{what}: {name}.order names its {count} parameters")


def test_yaml(made):
    for what, (command, result, text) in made.items():
        if yaml_reader:
            check(yaml_reader.safe_load(text) == result, f"{what}: result.yaml says what --json says")
        else:
            lost = [v for _, v in values(result) if isinstance(v, float) and repr(v) not in text and f"{v:.15g}" not in text]
            check(not lost, f"{what}: result.yaml has every number of --json {lost[:3]}")
        keys = re.findall(r"^([a-z_0-9]+):", text, re.M)
        check(keys == list(result), f"{what}: in the same order")
        verdicts = ("accepted", "warned", "refused")
        if command == "calibrate":
            check(result["verdict"] in verdicts and (result["verdict"] != "refused" or result["reasons"]),
                  f"{what}: {result['verdict']}, {len(result['reasons'])} reasons")


# ---- silence and progress ----


def test_silence():
    with tempfile.TemporaryDirectory() as folder:
        status, text, errors = run("calibrate", OPENCV_SET, "-o", os.path.join(folder, "out"), "-q")
        check(status == 0 and not errors and "verdict" in text, f"calibrate -q: nothing on standard error {errors}")
        status, text, errors = run("rectify", OPENCV_SET, "-o", os.path.join(folder, "r"), "-q", "--rig",
                                   os.path.join(folder, "out/rig.yaml"))
        check(status == 0 and not errors and "13 pairs" in text, f"rectify -q: nothing on standard error {errors}")
        status, text, errors = run("calibrate", OPENCV_SET, "-o", os.path.join(folder, "out"), "-v")
        check(status == 0 and "calibrate: reading 13 frames\n" in errors, "calibrate -v says more")
        check("\r" not in text + errors and "\033" not in text + errors, "no bar and no colour where there is no terminal")
        with open(os.path.join(folder, "out/log.jsonl")) as file:
            lines = [json.loads(line) for line in file]
        check(lines and all({"time_s", "level", "topic", "text"} <= set(line) for line in lines), "log.jsonl holds the same")


def on_terminal(*arguments):
    """Exit status and all that was written to a terminal as standard error."""
    ours, theirs = pty.openpty()
    written = []

    def read():
        while True:
            try:
                data = os.read(ours, 65536)
            except OSError:
                return
            if not data:
                return
            written.append(data)

    job = subprocess.Popen([PROGRAM, *arguments], stdout=subprocess.DEVNULL, stderr=theirs)
    os.close(theirs)
    reader = threading.Thread(target=read)
    reader.start()
    status = job.wait(120)
    reader.join(10)
    os.close(ours)
    return status, b"".join(written).decode()


def screen(text):
    """What a terminal shows in the end, and every state of its line on the way."""
    line, column, states, lines = "", 0, set(), []
    for part in re.findall(r"\r|\n|\033\[K|[^\r\n\033]+|\033", text):
        if part == "\r":
            states.add(line)
            column = 0
        elif part == "\n":
            lines.append(line)
            line, column = "", 0
        elif part == "\033[K":
            line = line[:column]
        else:
            line = line[:column] + part + line[column + len(part):]
            column += len(part)
    return [shown for shown in [*lines, line] if shown.strip()], states


def test_progress():
    with tempfile.TemporaryDirectory() as folder:
        dataset = image_set(folder, times=4)
        out = os.path.join(folder, "out")
        for threads in ("1", "2"):
            status, text = on_terminal("calibrate", dataset, "-o", out, "--threads", threads)
            left, states = screen(text)
            bars = [s for s in states if re.search(r"^finding the target +\[=* *\] \d+/104", s)]
            check(status == 0 and bars, f"--threads {threads}: a bar on a terminal: {sorted(bars)[-1:]}")
            # Work that is done within half a second shows no time.
            check(threads != "1" or any(re.search(r"\d+ s left", s) for s in states), "  with the time left")
            check(all(len(s) < 80 for s in states), "  within 80 columns")
            check(not left, f"  and it is gone in the end {left}")
        status, text = on_terminal("calibrate", dataset, "-o", out, "-q")
        check(status == 0 and not text, f"-q: no bar {text[:80]}")
        status, text = on_terminal("calibrate", os.path.join(folder, "nowhere"), "-o", out)
        check(status == 1 and "\033" not in text, "no bar before a complaint")
        status, text = on_terminal("rectify", dataset, "--rig", os.path.join(out, "rig.yaml"), "-o",
                                   os.path.join(folder, "rectified"))
        left, states = screen(text)
        check(status == 0 and any(s.startswith("rectifying") for s in states) and not left,
              f"rectify: a bar, and it is gone in the end {left}")


test_help()
test_man_and_completion()
test_usage()
if not os.path.isdir(IMAGES):
    skip("opencv-doc is not installed")
    finish()
kinds = results()
test_schema(kinds)
test_units(kinds)
test_yaml(kinds)
test_silence()
if not SANITIZED:
    test_progress()
finish()
