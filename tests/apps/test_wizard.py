"""Proves: the wizard, driven by keys through a pseudo-terminal as a person does, asks, looks at pictures as they come,
names a bad one, says what is next, and ends with the same rig as the job on the same pictures, bit for bit; also when it
was killed or left at any of five moments and gone on with. A video's pictures are chosen and stored. Wrong answers are
told and asked again.
Reference: `teledimos calibrate` on datasets/opencv-stereo (OpenCV's 13 pairs). Blind to: real cameras (none is here)."""

import fcntl
import glob
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import tempfile
import termios
import time

import yaml

from common import FULL, PROGRAM, SANITIZED, SOURCE, check, finish, run, skip

IMAGES = "/usr/share/doc/opencv-doc/examples/data"
PATIENCE = 240 if SANITIZED else 60
if SANITIZED:  # AddressSanitizer's dlopen does not see the program's own RUNPATH.
    os.environ["LD_LIBRARY_PATH"] = os.path.join(os.path.dirname(os.path.dirname(PROGRAM)), "lib")


class Wizard:
    """teledimos calibrate on a pseudo-terminal of 100x50."""

    def __init__(self, *arguments, cwd):
        self.text = ""
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 100, 0, 0))
        environment = {k: v for k, v in os.environ.items() if k not in ("SSH_CONNECTION", "NO_COLOR")}
        environment["TERM"] = "xterm"

        def own_terminal():
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen([PROGRAM, "calibrate", *arguments], stdin=slave, stdout=slave, stderr=slave,
                                        cwd=cwd, env=environment, preexec_fn=own_terminal, close_fds=True)
        self.slave = slave

    def read(self, seconds):
        ready, _, _ = select.select([self.master], [], [], seconds)
        if ready:
            try:
                self.text += os.read(self.master, 65536).decode("utf-8", "replace")
            except OSError:
                return False
        return bool(ready)

    def wait_for(self, words, after=0):
        """Position behind the words, -1 when they do not come."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = re.search(words, self.text[after:])
            if found:
                return after + found.end()
            if self.process.poll() is not None and not self.read(0):
                break
            self.read(0.05)
        return -1

    def type(self, keys):
        os.write(self.master, keys.encode())

    def answer(self, question, keys):
        at = self.wait_for(question, self.at if hasattr(self, "at") else 0)
        if at >= 0:
            self.at = at
            self.type(keys + "\n")
        return at >= 0

    def end(self):
        limit = time.monotonic() + PATIENCE
        while self.process.poll() is None and time.monotonic() < limit:
            self.read(0.05)
        while self.read(0):
            pass
        if self.process.poll() is None:
            self.process.kill()
        echo = bool(termios.tcgetattr(self.slave)[3] & termios.ECHO)
        os.close(self.master)
        os.close(self.slave)
        return self.process.wait(), echo


def numbers_of(folder):
    with open(os.path.join(folder, "rig.yaml")) as file:
        rig = yaml.safe_load(file)
    return rig["cameras"], rig["covariance"]


def feed(folder, number):
    """As a camera program writes: under another name first."""
    for side in ("left", "right"):
        name = f"{side}{number:02d}.jpg"
        shutil.copy(f"{IMAGES}/{name}", f"{folder}/.{name}")
    for side in ("right", "left"):
        name = f"{side}{number:02d}.jpg"
        os.rename(f"{folder}/.{name}", f"{folder}/{name}")


NUMBERS = [n for n in range(1, 15) if n != 10]


def begin(work, output="out"):
    pictures = f"{work}/pictures"
    os.makedirs(pictures, exist_ok=True)
    return Wizard("--source", f"{pictures}/left*", "--source", f"{pictures}/right*", "--target", "chessboard 9x6 25mm",
                  "--model", "brown5", "-o", output, cwd=work), pictures


def test_asked(reference):
    """All questions, wrong answers among them; pictures one by one; the same rig as the job."""
    with tempfile.TemporaryDirectory() as work:
        pictures = f"{work}/pictures"
        os.makedirs(pictures)
        for number in NUMBERS[:2]:
            feed(pictures, number)
        w = Wizard(cwd=work)
        check(w.answer("Where do pictures come from", "nowhere"), "asks where pictures come from")
        check(w.answer("nowhere.*[\\s\\S]*Where do pictures", "pictures"), "a folder that is not there is named, and asked again")
        check(w.answer(r"2 pictures left… and 2 right….*\[yes\]", ""), "sees that the folder holds a pair")
        check(w.answer("Target:", "chessboard 9x6"), "asks for the target")
        check(w.answer("spacing_m[\\s\\S]*Target:", "chessboard 9 x 6 25mm"), "a target without its size is told")
        check(w.answer("'9' is not understood[\\s\\S]*Target:", "chessboard 9x6 25mm"), "and one that cannot be read")
        check(w.answer("The lens", "wide"), "asks for the lens")
        check(w.answer("say normal or fisheye[\\s\\S]*The lens", ""), "a lens that it does not know is told")
        check(w.answer("Folder for the results", ""), "asks for the folder")
        check(w.wait_for("left02 .*left: found, 54 of 54 points; right: found, 54 of 54") > 0, "looks at what is there")
        for number in NUMBERS[2:]:
            feed(pictures, number)
            if w.wait_for(f"left{number:02d} .*left: found.*right: found") < 0:
                check(False, f"sees pair {number} when it comes")
                break
        panel = w.wait_for("fit: 0.1[0-9] px RMS, baseline 83.1[0-9] ")
        check(panel > 0 and w.wait_for("NEXT: \\S.{10,}") > 0, "the panel has fit, baseline and what is next")
        check(w.wait_for("left: board in 13 pictures", panel) > 0, "and counts 13 pictures")
        w.type("\n")
        status, echo = w.end()
        check(status == 0 and "verdict: accepted" in w.text and echo, f"Enter finishes with the table (exit {status}), echo is back")
        check(numbers_of(f"{work}/calibration") == reference, "the rig is the job's, bit for bit")
        names = {os.path.basename(p) for p in glob.glob(f"{work}/calibration/*")}
        check({"rig.yaml", "result.yaml", "report.html", "dataset.yaml", "frames.csv", "wizard.yaml"} <= names,
              "dataset and products stand in the folder")
        status, out, err = run("calibrate", f"{work}/calibration", "-o", f"{work}/again")
        check(status == 0 and numbers_of(f"{work}/again") == reference, "the dataset can be calibrated like any other")


def test_bad_picture():
    """A bent left02, and a right05 without the board, are named."""
    import cv2
    import numpy as np
    with tempfile.TemporaryDirectory() as work:
        w, pictures = begin(work)
        for number in NUMBERS:
            feed(f"{pictures}", number) if number not in (2, 5) else None
        left = cv2.imread(f"{IMAGES}/left02.jpg", 0)
        y, x = np.mgrid[0:left.shape[0], 0:left.shape[1]].astype(np.float32)
        bent = cv2.remap(left, x + 5 * np.sin(y / 40), y + 5 * np.sin(x / 50), cv2.INTER_CUBIC)
        blank = np.full_like(left, 128)
        def put(number, left, right):
            for name, image in ((f"right{number}", right), (f"left{number}", left)):
                cv2.imwrite(f"{pictures}/.{name}.png", image)
                os.rename(f"{pictures}/.{name}.png", f"{pictures}/{name}.png")

        put("02", bent, cv2.imread(f"{IMAGES}/right02.jpg", 0))  # lower numbers, late: pairs go by their numbers
        put("05", cv2.imread(f"{IMAGES}/left05.jpg", 0), blank)
        check(w.wait_for(r"left02 is left out: .+") > 0, "a left02 with bad corners is named and left out")
        check(w.wait_for(r"left05 .*right: not found: looked for a chessboard of 9x6") > 0, "a picture without the board is named, with why")
        w.type("\n")
        status, _ = w.end()
        check(status == 0 and "verdict" in w.text, "and the result is there")


def test_resumed(reference):
    """Killed in five moments, each time gone on with."""
    with tempfile.TemporaryDirectory() as work:
        moments = {0: "watching", 2: "left02 ", 5: "left05 ", 9: "left09 ", 13: "left14 "}
        done = -1
        w, pictures = begin(work)
        for count, words in moments.items():
            for number in NUMBERS[max(done, 0):count]:
                feed(pictures, number)
            done = count
            check(w.wait_for(words) > 0 or count == 0, f"with {count} pairs there")
            w.process.send_signal(signal.SIGKILL)
            w.end()
            w = Wizard("--resume", "-o", "out", cwd=work)
        check(w.wait_for("going on with 13 pictures") > 0, "after five kills it goes on with all 13 pictures")
        w.wait_for("fit: 0.1")
        w.type("\n")
        status, _ = w.end()
        check(status == 0 and numbers_of(f"{work}/out") == reference, "and ends with the same rig")


def test_left():
    """q and Ctrl-C keep everything and say how to go on; a folder that was begun is not begun again."""
    for key, name in (("q", "q"), ("\x03", "Ctrl-C")):
        with tempfile.TemporaryDirectory() as work:
            w, pictures = begin(work)
            for number in NUMBERS[:4]:
                feed(pictures, number)
            w.wait_for("left04 ")
            w.type(key)
            status, echo = w.end()
            check(status == 1 and "--resume -o out" in w.text and echo, f"{name} ends with status 1, says how to go on, gives the terminal back")
            with open(f"{work}/out/frames.csv") as file:
                check(len(file.readlines()) == 5, f"after {name} all 4 pairs are in frames.csv")
            w, _ = begin(work)
            status, _ = w.end()
            check(status == 2 and "--resume" in w.text, "the same folder again is refused with --resume named")
    with tempfile.TemporaryDirectory() as work:
        w = Wizard(cwd=work)
        w.wait_for("Where do pictures come from")
        w.type("\x04")
        status, _ = w.end()
        check(status == 1 and "ended before the first picture" in w.text, "an end of input at a question ends it")
        w = Wizard("--resume", "-o", "nothing", cwd=work)
        status, _ = w.end()
        check(status == 1 and "nothing was begun there" in w.text, "--resume without a beginning is named")


def test_video():
    """A video of the left camera: still boards are taken once each, and stored."""
    import cv2
    with tempfile.TemporaryDirectory() as work:
        video = cv2.VideoWriter(f"{work}/left.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
        for number in NUMBERS:
            for _ in range(3):
                video.write(cv2.imread(f"{IMAGES}/left{number:02d}.jpg"))
        video.release()
        w = Wizard("--source", "left.avi", "--target", "chessboard 9x6 25mm", "--model", "brown5", "-o", "out", cwd=work)
        check(w.wait_for("no more pictures come") > 0, "a video comes to its end")
        status, _ = w.end()
        with open(f"{work}/out/result.yaml") as file:
            result = yaml.safe_load(file)
        views = result["cameras"]["camera"]["views"]
        check(status == 0 and 10 <= views <= 13, f"of 39 frames of 13 boards {views} are taken")
        check(len(glob.glob(f"{work}/out/images/*.png")) == views, "and stored as PNG")
        check(abs(result["cameras"]["camera"]["intrinsics"][0] - 533) < 4, "the camera is the one that it is")


def main():
    if not os.path.exists(f"{IMAGES}/left01.jpg"):
        skip("OpenCV's pairs are missing (install opencv-doc)")
        finish()
    with tempfile.TemporaryDirectory() as folder:
        run("calibrate", f"{SOURCE}/datasets/opencv-stereo", "-o", folder)
        reference = numbers_of(folder)
    test_asked(reference)
    test_bad_picture()
    test_resumed(reference)
    test_left()
    test_video()
    finish()


main()
