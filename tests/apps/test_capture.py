"""Proves: `teledimos capture` stores what its sources give, whole and in order, as a dataset that can be read and calibrated:
from folders, from videos (written here by OpenCV: content, times, rate), from pairs with a known skew; killed at any moment
and run again nothing is lost; keys freeze and store on a terminal; the page and its WebSocket give the pictures and take the
buttons, from this machine's own pages only; the text picture shows something; what is wrong is said in one sentence.

Reference: images whose grey value is their number, videos whose times are k / fps, OpenCV's decoding of what the page is sent.
Tolerance: Motion JPEG and the page's JPEG keep a flat grey within 4. Blind to: real cameras (none is here), and to how the
page looks (a browser does not run here).
"""

import base64
import csv
import hashlib
import json
import os
import pty
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time

import cv2
import numpy as np

from common import PROGRAM, SANITIZED, check, fault_of_sentence, finish, run, shortened, skip

EXAMPLES = "/usr/share/doc/opencv-doc/examples/data"
BOARD = "chessboard 9x6 25mm"
if SANITIZED:  # AddressSanitizer's dlopen does not see the program's own RUNPATH.
    os.environ["LD_LIBRARY_PATH"] = os.path.join(os.path.dirname(os.path.dirname(PROGRAM)), "lib")


def grey(value, size=(48, 36)):
    """A flat image with some structure in a corner, so that its focus is not zero."""
    image = np.full((size[1], size[0]), value, np.uint8)
    image[:8:2, :8] = 255 - value
    return image


def fill(folder, values, form="{}.pgm"):
    os.makedirs(folder, exist_ok=True)
    for k, value in enumerate(values):
        cv2.imwrite(os.path.join(folder, form.format(k)), grey(value))


def write_video(path, values, fps):
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), fps, (48, 36))
    for value in values:
        writer.write(cv2.cvtColor(grey(value), cv2.COLOR_GRAY2BGR))
    writer.release()


def table(out):
    with open(os.path.join(out, "frames.csv")) as file:
        return list(csv.DictReader(file))


def values(out, camera):
    """The grey values of a camera's images, by the table."""
    found = []
    for row in table(out):
        image = cv2.imread(os.path.join(out, row[camera]), cv2.IMREAD_UNCHANGED)
        found.append(None if image is None else int(image[30, 40]) if image.ndim == 2 else image[30, 40].tolist())
    return found


def near(found, wanted, tolerance=4):
    return len(found) == len(wanted) and all(f is not None and abs(f - w) <= tolerance for f, w in zip(found, wanted))


def capture(*arguments, status=0, **how):
    """The JSON result."""
    code, text, errors = run("capture", *arguments, "--json", **how)
    check(code == status, f"capture {' '.join(str(a) for a in arguments)[-60:]}: {code} {shortened(errors)}")
    return json.loads(text) if text else {}


# ---- what is stored ----


def test_folder(folder):
    source, out = os.path.join(folder, "in"), os.path.join(folder, "out")
    fill(source, range(20, 32), "img{}.png")
    result = capture(source, "-o", out, "--idle", "0.3", "--target", BOARD)
    check(values(out, "camera") == list(range(20, 32)), f"a folder's images in natural order {values(out, 'camera')}")
    check(result["stored_frames"] == 12 and result["ended_by"] == "idle" and result["rate_hz"] is None and result["cameras"]["camera"]["width_px"] == 48,
          "and the result says so")
    names = [row["frame"] for row in table(out)]
    check(names == [f"{k:06d}" for k in range(12)], f"numbered from 0: {names[:2]}")
    mtime = os.stat(os.path.join(source, "img0.png")).st_mtime
    check(abs(float(table(out)[0]["time_s"]) - mtime) < 1e-5, "time_s is the file's last change")
    check(not [n for n in os.listdir(out) if n.startswith(".")], "no temporary files are left")
    result = capture(source, "-o", out, "--count", "3", "--format", "png")
    check(result["stored_frames"] == 3 and result["dataset_frames"] == 15 and result["ended_by"] == "count",
          "run again with --count 3: three more")
    check([row["frame"] for row in table(out)] == [f"{k:06d}" for k in range(15)], "numbers go on")
    check(table(out)[-1]["camera"] == "camera/000014.png" and values(out, "camera")[-3:] == [20, 21, 22], "as PNG")
    errors = run("capture", source, "-o", out, "--count", "1")[2]
    check("goes on with number 15" in errors, f"and it says so: {errors.splitlines()[0]}")


def test_folder_fills(folder):
    source, out = os.path.join(folder, "in"), os.path.join(folder, "out")
    os.makedirs(source)
    job = subprocess.Popen([PROGRAM, "capture", source, "-o", out, "--count", "6", "--json"], stdout=subprocess.PIPE,
                           stderr=subprocess.PIPE, encoding="utf-8")
    for k in range(6):
        path = os.path.join(source, f"{k}.png")
        with open(path, "wb") as file:
            data = cv2.imencode(".png", grey(50 + k))[1].tobytes()
            file.write(data[:len(data) // 2])
            file.flush()
            time.sleep(0.15)
            file.write(data[len(data) // 2:])
    text, errors = job.communicate(timeout=60)
    check(job.returncode == 0 and values(out, "camera") == [50, 51, 52, 53, 54, 55],
          f"files that are written slowly are taken whole {shortened(errors)}")
    check(json.loads(text)["unreadable_frames"] == 0, "and none is called unreadable")


def test_video(folder):
    video, out = os.path.join(folder, "a.avi"), os.path.join(folder, "out")
    shown = [20 + 4 * k for k in range(40)]
    write_video(video, shown, 20)
    result = capture(video, "-o", out, "--rate", "10", "--names", "front")
    check(near(values(out, "front"), shown[::2]), f"a video of 20 a second at --rate 10: every other {values(out, 'front')[:3]}")
    times = [float(row["time_s"]) for row in table(out)]
    check(all(abs(t - 0.1 * k) < 1e-3 for k, t in enumerate(times)), f"times are the video's {times[:3]}")
    check(abs(result["rate_hz"] - 10) < 0.01 and result["dropped_frames"] == 0 and result["ended_by"] == "end of source",
          "10 a second, none dropped")
    result = capture(video, "-o", out + "2", "--rate", "0", "--colour")
    check(result["stored_frames"] == 40 and table(out + "2")[0]["camera"].endswith(".ppm"), "--rate 0: all; --colour: PPM")
    writer = cv2.VideoWriter(video, cv2.VideoWriter_fourcc(*"MJPG"), 10, (48, 36))
    writer.write(np.full((36, 48, 3), (20, 60, 200), np.uint8))
    writer.release()
    capture(video, "-o", out + "3", "--colour", "--format", "png")
    channels = values(out + "3", "camera")[0]
    check(all(abs(c - w) <= 6 for c, w in zip(channels, (20, 60, 200))), f"of the right colour: blue, green, red {channels}")


def test_pair(folder):
    """10 and 8 a second: pairs at 0, 0.1, 0.2, 0.4, 0.5 against 0, 0.125, 0.25, 0.375, 0.5."""
    a, b, out = (os.path.join(folder, n) for n in ("a.avi", "b.avi", "out"))
    write_video(a, [20 + 4 * k for k in range(6)], 10)
    write_video(b, [100 + 4 * k for k in range(5)], 8)
    result = capture(a, b, "-o", out, "--rate", "0", "--target", BOARD)
    check(near(values(out, "left"), [20, 24, 28, 36, 40]) and near(values(out, "right"), [100, 104, 108, 112, 116]),
          f"pairs are those nearest in time {values(out, 'left')} {values(out, 'right')}")
    check(abs(result["skew_mean_s"] - 0.02) < 1e-4 and abs(result["skew_largest_s"] - 0.05) < 1e-4,
          f"skew: mean {result['skew_mean_s']}, largest {result['skew_largest_s']}")


def test_measures(folder):
    sharp = np.kron(np.random.default_rng(3).integers(40, 200, (30, 40)).astype(np.uint8), np.ones((8, 8), np.uint8))
    focus = []
    for sigma in (0, 1, 2, 4):
        image = cv2.GaussianBlur(sharp, (0, 0), sigma) if sigma else sharp
        path = os.path.join(folder, f"{sigma}.png")
        cv2.imwrite(path, image)
        focus.append(capture("--open", path)["image"]["focus"])
    check(all(x > 1.2 * y for x, y in zip(focus, focus[1:])), f"focus falls with blur {[round(f, 1) for f in focus]}")
    path = os.path.join(folder, "dim.png")
    cv2.imwrite(path, np.round(sharp * 0.5 + 30).astype(np.uint8))
    dim = capture("--open", path)["image"]["focus"]
    check(abs(dim / focus[0] - 1) < 0.01, f"and not with contrast and exposure {dim / focus[0]:.4f}")
    image = np.full((40, 50, 3), 51, np.uint8)
    image[:10, :, 2] = 255
    cv2.imwrite(path, image)
    seen = capture("--open", path)["image"]
    wanted = (0.75 * 51 + 0.25 * (0.299 * 255 + 0.701 * 51)) / 255
    check(seen["colour"] and seen["saturated_share"] == 0.25 and abs(seen["brightness_share"] - wanted) < 0.003 and
          (seen["width_px"], seen["height_px"]) == (50, 40), f"--open: brightness, saturation, size {seen}")
    status, text, errors = run("capture", "--open", path, "--live", "text", env={"COLORTERM": "truecolor"})
    check(status == 0 and "50 × 40 px" in text and errors.count("▀") > 200 and "\033[38;2;255;51;51m" in errors,
          "--open --live text: in colour")
    status, text, errors = run("capture", "--open", os.path.join(folder, "0.png"), "--live", "text",
                               env={"COLORTERM": ""})
    lines = errors.splitlines()
    check(status == 0 and "\033" not in errors and 5 < len(lines) <= 24 and max(map(len, lines)) <= 80 and
          len(set(errors)) > 5, f"without colours: ASCII, {len(lines)} lines")
    check(abs(max(map(len, lines)) / len(lines) - 2 * 320 / 240) < 0.2, "of the picture's shape")


def test_calibrates(folder):
    if not os.path.isdir(EXAMPLES):
        skip("opencv-doc is not installed")
        return
    out, cal = os.path.join(folder, "set"), os.path.join(folder, "cal")
    capture(f"{EXAMPLES}/left??.jpg", f"{EXAMPLES}/right??.jpg", "-o", out, "--idle", "0.3", "--target", BOARD)
    status, text, errors = run("calibrate", out, "-o", cal, "--json", "--no-leave-one-out")
    baseline = json.loads(text)["stereo"]["baseline_m"] if text else 0
    check(status in (0, 3) and abs(baseline - 0.0832) < 5e-4,
          f"what is captured is calibrated as it is: baseline {1e3 * baseline:.2f} mm {shortened(errors)}")


# ---- killed, interrupted ----


def whole_dataset(out, most):
    """Names what is not as it should be."""
    if not os.path.exists(os.path.join(out, "frames.csv")):
        return []
    bad = []
    for row in table(out):
        number = int(row["frame"])
        image = cv2.imread(os.path.join(out, row["camera"]), cv2.IMREAD_UNCHANGED)
        if image is None or image[30, 40] != (number % most) + 1:
            bad.append(row["frame"])
    return bad


def test_kill(folder):
    source, out = os.path.join(folder, "in"), os.path.join(folder, "out")
    fill(source, range(1, 201), "{:04}.pgm")
    killed, bad, lost, before = 0, [], 0, 0
    for delay in (0.05, 0.08, 0.12, 0.2, 0.3):
        shutil.rmtree(out, ignore_errors=True)
        job = subprocess.Popen([PROGRAM, "capture", source, "-o", out, "--target", BOARD, "-q"], stderr=subprocess.DEVNULL)
        while not os.path.exists(os.path.join(out, "frames.csv")) and job.poll() is None:
            time.sleep(0.002)
        time.sleep(delay)
        job.kill()
        killed += job.wait() == -signal.SIGKILL
        bad += whole_dataset(out, 200)
        images = sorted(os.listdir(os.path.join(out, "camera")))
        stored = [n for n in images if n.endswith(".pgm") and not n.startswith(".")]
        before += len(stored)
        result = capture(source, "-o", out, "--count", "1", "-q")
        lost += len(stored) + 1 - result["dataset_frames"]
        names = [row["frame"] for row in table(out)]
        if names != [f"{k:06d}" for k in range(len(stored) + 1)] or None in values(out, "camera"):
            bad.append(f"after {delay} s: {names[-3:]}")
    check(killed == 5 and not bad and before > 5, f"killed {killed} times with {before} images: all that is named is whole {bad}")
    check(lost == 0, f"and run again, every image that was stored is in the table ({lost} lost)")
    # The moment between an image and the table, made by hand: the last two rows never written.
    with open(os.path.join(out, "frames.csv")) as file:
        lines = file.readlines()
    with open(os.path.join(out, "frames.csv"), "w") as file:
        file.writelines(lines[:-2])
    result = capture(source, "-o", out, "--count", "1")
    check(result["adopted_frames"] == 2 and result["dataset_frames"] == len(lines) and table(out)[-2]["time_s"] == "",
          "images that no row names are taken in, without a time")


def test_interrupt(folder):
    source, out = os.path.join(folder, "in"), os.path.join(folder, "out")
    fill(source, range(1, 8), "{:04}.pgm")
    for number in (signal.SIGINT, signal.SIGTERM):
        job = subprocess.Popen([PROGRAM, "capture", source, "-o", out, "--json"], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, encoding="utf-8")
        time.sleep(1.0)
        job.send_signal(number)
        text, errors = job.communicate(timeout=30)
        check(job.returncode == 0 and json.loads(text)["ended_by"] == "signal" and json.loads(text)["stored_frames"] == 7,
              f"{signal.Signals(number).name}: ends with what was stored {shortened(errors)}")
    empty = os.path.join(folder, "empty")
    os.makedirs(empty)
    status, text, errors = run("capture", empty, "-o", out + "2", "--idle", "0.2")
    check(status == 1 and "no image came" in errors and not os.path.exists(out + "2"), f"nothing came: {errors.strip()}")


# ---- a terminal ----


class Terminal:
    """A job whose terminal is ours."""

    def __init__(self, *arguments, env=None):
        self.text = ""
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.environ.update({"TERM": "xterm", "COLORTERM": "truecolor", **(env or {})})
            os.execv(PROGRAM, [PROGRAM, *arguments])

    def read(self, seconds, until=None):
        """What it writes in so many seconds, or until the pattern is seen."""
        end, since = time.monotonic() + seconds, len(self.text)
        while time.monotonic() < end:
            if until and re.search(until, self.text[since:]):
                return True
            if select.select([self.fd], [], [], 0.05)[0]:
                try:
                    data = os.read(self.fd, 65536)
                except OSError:
                    break
                if not data:
                    break
                self.text += data.decode(errors="replace")
        return bool(until and re.search(until, self.text[since:]))

    def press(self, keys):
        os.write(self.fd, keys.encode())

    def wait(self):
        self.read(20)
        status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        os.close(self.fd)
        return status


def test_keys(folder):
    video, out = os.path.join(folder, "a.avi"), os.path.join(folder, "out")
    write_video(video, [20 + k for k in range(200)], 10)
    job = Terminal("capture", video, "-o", out, "--store", "keys", "--live", "none", "--rate", "10")
    check(job.read(20, r"0 stored · [0-9.]+/s"), "keys: the video plays, nothing is stored")
    job.press(" ")
    check(job.read(10, "1 stored"), "space stores")
    job.read(0.5)
    job.press("f")
    check(job.read(10, "frozen · 1 stored"), "f freezes")
    job.press("\n")
    check(job.read(10, "frozen · 2 stored"), "enter stores the frozen picture")
    job.press(" ")
    job.read(0.6)
    check("3 stored" not in job.text, "once only")
    job.press("f")
    check(job.read(10, r"K2 stored"), "f lets it go on")
    job.read(0.5)
    job.press("s")
    check(job.read(10, "3 stored"), "s stores")
    job.press("q")
    status = job.wait()
    check(status == 0 and "3 images stored" in job.text, f"q ends: {status}")
    found = values(out, "camera")
    times = [float(row["time_s"]) for row in table(out)]
    check(all(abs(v - 20 - 10 * t) <= 4 for v, t in zip(found, times)), f"what was shown is what is stored {found} {times}")
    check(1 < found[2] - found[1] and times == sorted(times), "the video waited while it was frozen")
    with open(os.path.join(out, "result.yaml")) as file:
        text = file.read()
    check("ended_by: key\n" in text and "stored_frames: 3\n" in text, "and result.yaml says so")


def test_text(folder):
    source, out = os.path.join(folder, "in"), os.path.join(folder, "out")
    fill(source, [200, 100])
    job = Terminal("capture", source, "-o", out, "--duration", "1.5", env={"SSH_CONNECTION": "1 2 3 4"})
    status = job.wait()
    check(status == 0 and job.text.count("▀") > 100 and "\033[38;2;" in job.text, "over ssh: the picture as text, in colour")
    check("\033[?1049h" in job.text and job.text.rindex("\033[?1049l") > job.text.rindex("▀") and "2 images stored" in job.text,
          "on a screen of its own, which is put away in the end")
    job = Terminal("capture", source, "-o", out, "--duration", "1", env={"SSH_CONNECTION": ""})
    status = job.wait()
    check(status == 0 and re.search(r"live picture: http://127\.0\.0\.1:\d+/", job.text) and "▀" not in job.text,
          "at the machine: the page is offered")


# ---- the page ----


def http_get(port, path="/"):
    with socket.create_connection(("127.0.0.1", port), 10) as link:
        link.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode())
        data = b""
        while True:
            part = link.recv(65536)
            if not part:
                return data.decode()
            data += part
            head, _, body = data.partition(b"\r\n\r\n")
            length = re.search(rb"content-length: *(\d+)", head, re.I)
            if length and len(body) >= int(length[1]):
                return data.decode()


class Page:
    """A WebSocket of the live page (RFC 6455), without a browser."""

    def __init__(self, port, origin=None):
        self.link = socket.create_connection(("127.0.0.1", port), 10)
        key = base64.b64encode(os.urandom(16)).decode()
        lines = ["GET / HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade",
                 f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Protocol: teledimos-live"]
        self.link.sendall(("\r\n".join(lines + ([f"Origin: {origin}"] if origin else [])) + "\r\n\r\n").encode())
        self.data = b""
        while b"\r\n\r\n" not in self.data and self.more():
            pass
        self.head, _, self.data = self.data.partition(b"\r\n\r\n")
        accept = base64.b64encode(hashlib.sha1((key + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11").encode()).digest())
        self.open = self.head.startswith(b"HTTP/1.1 101") and accept in self.head

    def more(self):
        try:
            part = self.link.recv(65536)
        except OSError:
            part = b""
        self.data += part
        return bool(part)

    def take(self, count):
        while len(self.data) < count:
            if not self.more():
                raise EOFError
        part, self.data = self.data[:count], self.data[count:]
        return part

    def message(self):
        whole = b""
        while True:
            first, size = self.take(2)
            size = {126: lambda: struct.unpack("!H", self.take(2))[0], 127: lambda: struct.unpack("!Q", self.take(8))[0]}.get(
                size & 127, lambda: size & 127)()
            whole += self.take(size)
            if first & 0x80:
                return whole if first & 15 != 1 or isinstance(whole, str) else whole.decode()

    def view(self):
        """The next view: its text, and the pictures."""
        while True:
            text = self.message()
            if isinstance(text, str):
                break
        view = json.loads(text)
        pictures = {}
        for picture in view["pictures"]:
            if picture["width"]:
                data = self.message()
                pictures[data[0]] = cv2.imdecode(np.frombuffer(data[1:], np.uint8), cv2.IMREAD_UNCHANGED)
        return view, pictures

    def send(self, text):
        mask = os.urandom(4)
        body = bytes(b ^ mask[i % 4] for i, b in enumerate(text.encode()))
        self.link.sendall(bytes([0x81, 0x80 | len(body)]) + mask + body)


def wait_for(page, what):
    """The first view for which what(view) holds, of the next 60."""
    for _ in range(60):
        view, pictures = page.view()
        if what(view):
            return view, pictures
    return None, None


def test_page(folder):
    left, right, out = (os.path.join(folder, n) for n in ("left", "right", "out"))
    fill(left, range(60, 160))
    fill(right, range(100, 200))
    job = subprocess.Popen([PROGRAM, "capture", left, right, "-o", out, "--store", "keys", "--live", "page", "--port", "0",
                            "--json"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                           encoding="utf-8")
    try:
        port = int(re.search(r"http://127\.0\.0\.1:(\d+)/", job.stderr.readline())[1])
        answer = http_get(port)
        check(answer.startswith("HTTP/1.1 200") and "text/html" in answer and answer.rstrip().endswith("</html>"),
              f"the page is served: {len(answer)} bytes")
        check(not re.search(r"(src|href)=.https?:|@import|url\(", answer), "and needs nothing from elsewhere")
        check(http_get(port, "/etc/passwd").startswith("HTTP/1.1 404"), "nothing else is")
        check(not Page(port, "http://example.org").open, "pages of other sites are refused")
        own = Page(port, f"http://127.0.0.1:{port}")
        page = Page(port)
        check(page.open and own.open and b"teledimos-live" in page.head, "the WebSocket's handshake")
        view, pictures = wait_for(page, lambda v: v["pictures"][0]["width"] > 0)
        check([p["label"] for p in view["pictures"]] == ["left", "right"] and view["buttons"] == "freeze store done" and
              "Focus: " in view["facts"] and view["headline"] and not view["frozen"], "a view has names, facts, buttons")
        difference = int(pictures[1][30, 40]) - int(pictures[0][30, 40])
        check(pictures[0].shape == (36, 48) and abs(difference - 40) <= 6, f"and its pictures, which belong together: {difference}")
        page.send("freeze")
        view, frozen = wait_for(page, lambda v: v["frozen"])
        check(bool(view), "the button freezes")
        later = page.view()[1]
        check(int(later[0][30, 40]) == int(frozen[0][30, 40]), "the picture stands still")
        page.send("store")
        view, _ = wait_for(page, lambda v: "Stored: 1" in v["facts"])
        check(bool(view) and "tored" in view["headline"], "the button stores")
        check(wait_for(own, lambda v: "Stored: 1" in v["facts"])[0] is not None, "a second browser sees the same")
        page.send("nonsense")
        page.send("freeze")
        check(wait_for(page, lambda v: not v["frozen"])[0] is not None, "and it goes on")
        page.send("done")
        text, errors = job.communicate(timeout=20)
        check(job.returncode == 0 and json.loads(text)["stored_frames"] == 1 and json.loads(text)["ended_by"] == "key",
              f"the button ends {shortened(errors)}")
        check(abs(values(out, "left")[0] - int(frozen[0][30, 40])) <= 4 and
              abs(values(out, "right")[0] - int(frozen[1][30, 40])) <= 4, "what was frozen is what is stored")
    finally:
        if job.poll() is None:
            job.kill()


def test_page_port(folder):
    fill(os.path.join(folder, "in"), [50])
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        status, text, errors = run("capture", os.path.join(folder, "in"), "-o", os.path.join(folder, "out"), "--live", "page",
                                   "--port", port, "--idle", "0.2")
        check(status == 1 and f"{port}" in errors and "--port" in errors and not fault_of_sentence(errors, "capture"),
              f"a port that is taken: {errors.strip()}")


# ---- what is wrong ----


def test_refusals(folder):
    source, out = os.path.join(folder, "in"), os.path.join(folder, "out")
    fill(source, [50, 60])
    text_file, image = os.path.join(folder, "text.mp4"), os.path.join(source, "0.pgm")
    with open(text_file, "w") as file:
        file.write("no video")
    video = os.path.join(folder, "a.avi")
    write_video(video, [10, 20, 30], 10)
    cases = [(1, ["/nowhere", "no such"], ("/nowhere",)), (1, ["/dev/video77", "no such device"], ("/dev/video77",)),
             (1, ["camera:webcam", "there is none"], ("camera:webcam",)), (1, ["text.mp4", "not a video"], (text_file,)),
             (2, ["0.pgm", "single image"], (image,)), (2, ["--target", "chessboard"], (source, "--target", "board")),
             (2, ["--target", "spacing_m"], (source, "--target", "chessboard 9x6 25m")),
             (2, ["--target"], (source, "--target", "{kind: chessboard}")),
             (2, ["--target"], (source, "--target", "{kind")),
             (2, ["--names"], (source, "--names", "left,right")), (2, ["--names", "twice"], (source, source, "--names", "a,a")),
             (2, ["--names"], (source, "--names", "time_s")), (2, ["--names"], (source, "--names", "a b")),
             (2, ["--size"], (source, "--size", "640")), (2, ["--format", "pgm"], (source, "--format", "bmp")),
             (2, ["--store", "terminal"], (source, "--store", "keys")), (2, ["kinds"], (source, video)),
             (2, ["--rate"], (source, "--rate", "-1")), (2, ["--live"], (source, "--live", "tv"))]
    for wanted, words, arguments in cases:
        status, text, errors = run("capture", *arguments, "-o", out, "--idle", "0.2", timeout=60)
        fault = fault_of_sentence(errors, "capture")
        check(status == wanted and not fault and all(w in errors for w in words) and not text and not os.path.exists(out),
              f"{' '.join(os.path.basename(a) for a in arguments)}: {status} {shortened(errors)} {fault}")
    for arguments, word in (((source,), "-o"), (("-o", out), "SOURCE"), ((source, source, source, "-o", out), "too many")):
        status, text, errors = run("capture", *arguments)
        check(status == 2 and word in errors, f"usage: {shortened(errors)}")
    status, text, errors = run("capture", source, "-o", image, "--idle", "0.2")
    check(status == 1 and image in errors, f"-o is a file: {shortened(errors)}")
    status, text, errors = run("capture", "--open", text_file)
    check(status == 1 and "text.mp4" in errors, f"--open of no image: {shortened(errors)}")
    capture(source, "-o", out, "--idle", "0.2", "--target", BOARD)
    for words, more in ((["--target", "another"], ("--target", "chessboard 8x6 25mm")), (["cameras", "--names"], ("--names", "x"))):
        before = open(os.path.join(out, "frames.csv")).read()
        status, text, errors = run("capture", source, "-o", out, "--idle", "0.2", *more)
        check(status in (1, 2) and all(w in errors for w in words) and open(os.path.join(out, "frames.csv")).read() == before,
              f"another dataset is there: {shortened(errors)}")
    with open(os.path.join(source, "2.pgm"), "w") as file:
        file.write("P5 damaged")
    os.utime(os.path.join(source, "2.pgm"), (1e9, 1e9))
    cv2.imwrite(os.path.join(source, "3.pgm"), grey(70, (64, 48)))
    cv2.imwrite(os.path.join(source, "4.pgm"), grey(80))
    status, text, errors = run("capture", source, "-o", out + "2", "--idle", "0.3")
    check(status == 0 and "2.pgm" in errors and "3.pgm is 64x48" in errors and values(out + "2", "camera") == [50, 60, 80],
          f"one that cannot be read and one of another size are named and left out: {shortened(errors)}")


def test_cameras():
    status, text, errors = run("capture", "--list")
    result = capture("--list")
    if result["devices"]:
        check(status == 0 and all(d["path"] in text for d in result["devices"]), f"--list: {text.strip()}")
    else:
        check(status == 0 and "no camera" in text and not errors, f"--list without a camera: {text.strip()}")


def test_help(folder):
    text = run("capture", "--help")[1]
    wide = [line for line in text.splitlines() if len(line) > 100 and not line.startswith("  teledimos")]
    check(not wide and not re.search(r"[ \t]\n", text), f"--help: at most 100 columns {wide[:1]}")
    examples = re.findall(r"^  (teledimos .*)$", text, re.M)
    check(len(examples) >= 2, f"--help has {len(examples)} examples")
    for example in examples if os.path.isdir(EXAMPLES) else []:
        done = subprocess.run(["bash", "-c", example], cwd=folder, capture_output=True, encoding="utf-8", timeout=100,
                              env={**os.environ, "PATH": os.path.dirname(PROGRAM) + ":" + os.environ["PATH"]})
        out = re.search(r"-o (\S+)", example)[1]
        check(done.returncode == 0 and os.path.exists(os.path.join(folder, out, "result.yaml")),
              f"as typed: {example[:60]} {shortened(done.stderr)}")


def in_folder(test):
    with tempfile.TemporaryDirectory() as folder:
        test(folder)


for one in (test_folder, test_folder_fills, test_video, test_pair, test_measures, test_interrupt, test_keys, test_text,
            test_page, test_page_port, test_refusals, test_help):
    in_folder(one)
test_cameras()
if not SANITIZED:
    in_folder(test_calibrates)
in_folder(test_kill)
finish()
