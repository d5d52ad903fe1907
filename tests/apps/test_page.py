"""The operator's page (apps/panel) in Chromium, as a person uses it, against the program that serves it.

The paper's session: its parameters are typed and the audit log has them; StartSim, the curves grow, Pause, Resume, the end where it
was wanted; a pose out of reach fails with its reason, Reinit; UserStop by its key from another view; jog by a held button and key.
Who else watches is told who leads. The desired place dragged in 3D, also out of reach. On a map of known shape a length of 3 m
within 3 cm and a pit of 1.5 m3 within 5 % (its cells are 5 cm). A recording: the machine drawn at chosen times is what the file
holds then, read here without the index that the page uses; no seek above 200 ms. A link cut and one that hangs (a relay between)
told within 2 s, everything marked with its age, and connected again. A task simulated and validated here is checked and done by
`teledimos machine`, whose measured bucket ends within 5 cm of the predicted one. axe-core finds nothing in any view, light and dark, on a desk
and on a phone. What is served: the right types, packed, known again, nothing outside the folder, and a text where the page is not
installed. With TELEDIMOS_FULL=1 also: the page in apps/panel/dist is what its sources give; a recording of an hour.

Screenshots of all of it are left in the build tree (tests/page/pictures).

Blind to: other browsers; graphics processors (the frame rate is that of software); readers of screens as people use them."""

import filecmp
import gzip
import json
import os
import re
import shutil
import struct
import subprocess
import tempfile
import time
import urllib.error
import urllib.request

from common import FULL, PROGRAM, SANITIZED, SOURCE, check, finish, run, skip

ROBOT = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
BUILD = os.path.dirname(os.path.dirname(PROGRAM))
WORK = os.path.join(BUILD, "tests/page")
CHROMIUM = "/usr/bin/chromium"
TOKEN = "correct-horse-battery-staple"
SCENARIO = f"""teledimos: scenario 1
name: a-test
robot: {ROBOT}
start: {{joints: {{swing: 0, boom: -0.5, arm: 1.6, bucket: 0.6}}}}
duration_s: 6
log_s: 0.05
control: {{gain_1_s: 3, period_s: 0.05}}
live: {{on_miss: catch-up, tolerance_s: 0.1}}
task:
  name: point
  steps:
    - position: {{via: [{{x_m: 6.7, y_m: 0.4, z_m: 0.9}}], to: {{x_m: 7.5, y_m: 2.0, z_m: 1.5}}, law: quintic, duration_s: 4}}
"""


def scenario(folder, name, text):
    path = os.path.join(folder, name)
    with open(path, "w") as file:
        file.write(text)
    return path


# ---- what is served, without a browser ----

def start(command, path, out, *options):
    process = subprocess.Popen([*command, path, "-o", out, "--port", "0", *options], stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True)
    found = re.search(r":(\d+)/", process.stderr.readline())
    return process, f"http://127.0.0.1:{found[1]}" if found else None


def get(url, **headers):
    """Status, headers, bytes."""
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=20) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers, b""
    except (urllib.error.URLError, ConnectionError):
        return 0, {}, b""  # hung up on


def test_files(folder):
    dist = os.path.join(SOURCE, "apps/panel/dist")
    process, url = start([PROGRAM, "panel"], scenario(folder, "s.yaml", SCENARIO), os.path.join(folder, "out"))
    try:
        total = 0
        for name in sorted(os.listdir(dist)):
            path = "/" if name == "index.html" else "/" + name
            with open(os.path.join(dist, name), "rb") as file:
                truth = file.read()
            status, head, plain = get(url + path)
            check(status == 200 and plain == truth, f"{path} is {name}, byte for byte")
            kind = {"html": "text/html", "js": "text/javascript", "css": "text/css", "txt": "text/plain"}[name.rsplit(".", 1)[1]]
            check(head["Content-Type"].startswith(kind), f"{path} is {head['Content-Type']}")
            policy = head["Content-Security-Policy"]
            check("default-src 'none'" in policy and "unsafe" not in policy and "http" not in policy, f"{path}: {policy}")
            status, packed, body = get(url + path, **{"Accept-Encoding": "gzip, br"})
            total += len(body)
            check(packed["Content-Encoding"] == "gzip" and gzip.decompress(body) == truth, f"{path} packed: {len(body)} of {len(truth)}")
            status, _, body = get(url + path, **{"If-None-Match": head["ETag"]})
            check(status == 304 and body == b"", f"{path} that is known is not sent again: {status}")
        check(total < 300000, f"all of the page is {total} bytes packed")
        print(f"the page is {total} bytes packed", flush=True)
        for path in ("/../panel.c", "/%2e%2e/panel.c", "//etc/passwd", "/main.js/", "/dist", "/index.html.gz", "/main.js%00"):
            check(get(url + path)[0] in (0, 400, 403, 404), f"{path} is refused")
        try:
            with urllib.request.urlopen(urllib.request.Request(url + "/", data=b"x=1"), timeout=20) as answer:
                check(False, f"POST is answered with {answer.status}")
        except (urllib.error.URLError, ConnectionError):
            check(True, "POST is not answered")
        with open(os.path.join(dist, "main.js"), "rb") as file:
            check(not re.search(rb"https?://(?!www\.w3\.org|127\.0\.0\.1)", file.read()), "the page names no other place")
    finally:
        process.kill()
        process.communicate()
    # Without the page: in a tree of its own.
    alone = os.path.join(folder, "alone/libexec/teledimos")
    os.makedirs(alone)
    shutil.copy(os.path.join(BUILD, "libexec/teledimos/panel"), alone)
    process, url = start([os.path.join(alone, "panel")], os.path.join(folder, "s.yaml"), os.path.join(folder, "out2"))
    try:
        check("not installed" in get(url + "/")[2].decode(), "where the page is not installed a text says how to connect")
    finally:
        process.kill()
        process.communicate()


def test_dist(folder):
    """The sources give what is in dist; and no registry is named."""
    found = [name for name in ("apps/panel/package-lock.json", "tests/page/package-lock.json")
             if '"resolved"' in open(os.path.join(SOURCE, name)).read()]
    check(not found, f"no registry's address is kept: {found}")
    if not FULL or not shutil.which("npm"):
        skip("the page is not built anew (TELEDIMOS_FULL=1 with npm does)")
        return
    out = os.path.join(folder, "dist")
    done = subprocess.run(["sh", os.path.join(SOURCE, "apps/panel/build.sh"), os.path.join(BUILD, "panel"), out],
                          capture_output=True, text=True)
    check(done.returncode == 0, f"the page is built: {done.stdout[-300:]} {done.stderr[-300:]}")
    dist = os.path.join(SOURCE, "apps/panel/dist")
    names = sorted(os.listdir(dist))
    same, other, missing = filecmp.cmpfiles(dist, out, names, shallow=False)
    check(sorted(os.listdir(out)) == names and not other and not missing, f"dist is what the sources give: {other} {missing} differ")


# ---- recordings ----

def boom_at(path, times):
    """[(time, quaternion of the boom in its parent)] of the newest /tf at each time, by reading the file from its beginning."""
    rows, channels = [], {}

    def records(data, at, end):
        while at + 9 <= end:
            op, size = data[at], struct.unpack_from("<Q", data, at + 1)[0]
            yield op, at + 9, size
            at += 9 + size

    with open(path, "rb") as file:
        data = file.read()
    for op, at, size in records(data, 8, len(data) - 8):
        if op != 6:  # chunk
            continue
        name = struct.unpack_from("<I", data, at + 28)[0]
        begin = at + 32 + name + 8
        for inner, start_, length in records(data, begin, at + size):
            if inner == 4:
                number, _, topic = struct.unpack_from("<HHI", data, start_)
                channels[number] = data[start_ + 8:start_ + 8 + topic].decode()
            elif inner == 5:
                number, _, log = struct.unpack_from("<HIQ", data, start_)
                if channels.get(number) == "/tf":
                    rows.append((log * 1e-9, start_ + 22, length - 22))
    rows.sort(key=lambda row: row[0])
    found = []
    for t in times:
        at = max((row for row in rows if row[0] <= t), default=None, key=lambda row: row[0])
        if at:
            message = json.loads(data[at[1]:at[1] + at[2]])
            q = next(x["rotation"] for x in message["transforms"] if x["child_frame_id"] == "boom")
            found.append((t, [q["x"], q["y"], q["z"], q["w"]]))
    return found


def recordings(folder):
    """A short one; with TELEDIMOS_FULL one of an hour."""
    made = {}
    wait = "    - wait: {for_s: %d}\n"
    jobs = [("short", 24, 3)] + ([("hour", 3600, 3570)] if FULL else [])
    for name, seconds, rest in jobs:
        text = SCENARIO.replace("duration_s: 6\n", f"duration_s: {seconds}\n").replace("duration_s: 4", "duration_s: 8") + wait % rest
        path, out = scenario(folder, f"{name}.yaml", text), os.path.join(folder, name)
        code, _, errors = run("simulate", path, "-o", out, "--accept", timeout=900)
        check(code == 0, f"a recording of {seconds} s: {code} {errors.strip()}")
        made[name] = os.path.join(out, "recording.mcap")
    return made


# ---- a browser ----

def ground(folder):
    """500 x 500 cells of 5 cm: level but for a pit of 2 x 1.5 x 0.5 m, whose edges lie between cells, and a far hill."""
    try:
        import numpy
        from osgeo import gdal
    except ImportError:
        skip("the readers of GDAL are not installed (python3-gdal)")
        return None
    gdal.UseExceptions()
    side, cell = 500, 0.05
    path = os.path.join(folder, "site.tif")
    file = gdal.GetDriverByName("GTiff").Create(path, side, side, 5, gdal.GDT_Float64)
    file.SetGeoTransform([-7 - cell / 2, cell, 0, 12.5 + cell / 2, 0, -cell])
    x, y = -7 + cell * numpy.arange(side)[None, :], 12.5 - cell * numpy.arange(side)[:, None]
    height = 1.1 * numpy.exp(-((x - 9) ** 2 + (y - 7) ** 2) / 5) + 0.04 * numpy.sin(2.2 * x) * numpy.cos(1.7 * y) * (y > 3)
    height[(numpy.abs(x - 9.025) < 1) & (numpy.abs(y + 3.275) < 0.75)] -= 0.5
    height[(x - 15) ** 2 + (y - 2) ** 2 < 2] = numpy.nan
    far = numpy.hypot(x, y)
    known = numpy.isfinite(height)
    origin = numpy.where(far < 5, 1, numpy.where(numpy.abs(y) < 4, 3, 2)) + 0 * height
    bands = {"height": height, "sigma": 0.004 + 0.0012 * far + 0 * height, "count": numpy.where(known, 3, 0),
             "provenance": numpy.where(known, origin, 0), "time": 0 * height}
    for i, (name, values) in enumerate(bands.items()):
        band = file.GetRasterBand(i + 1)
        band.SetDescription(name)
        band.SetNoDataValue(float("nan"))
        band.WriteArray(values)
    del file
    return scenario(folder, "ground.yaml", SCENARIO.replace("name: a-test", f"name: a-site\nground: {{map: {path}}}")
                    .replace("boom: -0.5, arm: 1.6", "boom: -0.7, arm: 1.3").replace("via: [{x_m: 6.7, y_m: 0.4, z_m: 0.9}], ", ""))


def browser():
    """Node, Chromium and the packages, or None. With TELEDIMOS_FULL=1 the packages are installed, in the build tree."""
    if not shutil.which("node") or not os.path.exists(CHROMIUM):
        skip("the page in a browser: node or chromium is not installed (sh tests/run.sh --full installs them)")
        return None
    os.makedirs(WORK, exist_ok=True)
    for name in ("package.json", "package-lock.json", ".npmrc", "page.mjs"):
        shutil.copy(os.path.join(SOURCE, "tests/page", name), WORK)
    if not os.path.isdir(os.path.join(WORK, "node_modules/playwright-core")) and FULL and shutil.which("npm"):
        subprocess.run(["npm", "ci", "--ignore-scripts"], cwd=WORK, capture_output=True)
    if not os.path.isdir(os.path.join(WORK, "node_modules/playwright-core")):
        skip("the page in a browser: playwright-core is not installed (sh tests/run.sh --full installs it)")
        return None
    return CHROMIUM


def test_browser(folder):
    chrome = browser()
    if not chrome:
        return
    token = scenario(folder, "token", TOKEN + "\n")
    os.chmod(token, 0o600)
    made = recordings(folder)
    truth = {}
    for name, path in made.items():
        end = 3600 if name == "hour" else 11
        truth[name] = boom_at(path, [end * k / 12 + 0.013 for k in range(12)] + ([1.5, 4.0, 6.5] if name == "hour" else []))
    settings = {"program": PROGRAM, "scenario": scenario(folder, "a.yaml", SCENARIO), "ground": ground(folder), "recordings": made,
                "truth": truth, "token": TOKEN, "token_file": token, "slow": max(4 if SANITIZED else 1, os.getloadavg()[0] / os.cpu_count()),
                "pictures": os.path.join(WORK, "pictures"), "only": os.environ.get("TELEDIMOS_PAGE_ONLY", "")}
    scenario(folder, "settings.json", json.dumps(settings))
    process = subprocess.Popen(["node", os.path.join(WORK, "page.mjs"), folder, chrome], stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True)
    for line in process.stdout:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            print(line.rstrip(), flush=True)
            continue
        if "ok" in row:
            check(row["ok"], row["text"])
        else:
            print(row["text"], flush=True)
    check(process.wait() == 0, f"the browser's part ends: {process.returncode}")


def main():
    for test in (test_files, test_dist, test_browser):
        begun = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            test(folder)
        print(f"{test.__name__}: {time.monotonic() - begun:.1f} s", flush=True)
    finish()


main()
