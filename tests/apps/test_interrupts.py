"""Proves: a job that cannot write, or is stopped or killed, says so in one sentence where it still can, and leaves nothing
that is half written; the products of an earlier run stay, and a new run does as if nothing had been.

Reference: the products of an undisturbed run, byte for byte. Blind to: losses of power, which the order of fsync and rename
is for.
"""

import json
import os
import resource
import shutil
import signal
import subprocess
import tempfile
import time

import cv2

import common
from common import (COLUMNS, FRAMES, PROGRAM, ROWS, SANITIZED, check, clean_runs, fault_of_sentence, finish, image_set,
                    leftovers, points_set, refused, rig_file, run, shortened, skip, views_of)

common.quick = common.SANITIZED

try:
    import yaml as yaml_reader
except ImportError:
    yaml_reader = None

clean = clean_runs()


# ---- places that cannot be written ----


def nobody():
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)


def short_files():
    """What is longer than 60 kB cannot be written; the signal that goes with it is the shell's default."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)


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
        os.remove(os.path.join(out, "report.html"))
        run("calibrate", dataset, "-o", out)
        before = contents(out)
        refused("a limit on the size of files", 1, ["cannot be written", "File too large"], dataset, out=out,
                before=short_files)
        check(not leftovers(out) and contents(out) == before, "no temporary file, and an earlier run's products stay")
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
    check(job.wait() == 1 and not fault_of_sentence(line, "calibrate") and "interrupted" in line,
          f"{signal.Signals(number).name} {delay} s after '{trigger}' no. {count}: {line.strip()} "
          f"({time.monotonic() - sent:.2f} s later)")
    check(not os.path.exists(out) or not os.listdir(out), "  and nothing is written")


def test_interrupts():
    with tempfile.TemporaryDirectory() as folder:
        dataset = image_set(folder, times=4)
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
            whole = whole and (text.count("\n") - 2) % (COLUMNS * ROWS) == 0
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
    """All products but the log, which holds times."""
    products = {}
    for name in ("rig.yaml", "result.yaml", "report.html", "points.csv"):
        path = os.path.join(folder, name)
        products[name] = open(path, "rb").read() if os.path.exists(path) else None
    return products


# A library that is loaded before the C library: dies at the KILL_AT-th call that changes a file, half of the bytes written.
DEADLY = """
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <unistd.h>

static int is_last(void)
{
    static int left;
    if (!left) left = atoi(getenv("KILL_AT"));
    return --left == 0;
}
ssize_t write(int fd, const void *bytes, size_t size)
{
    int last = fd > 2 && is_last();
    long wrote = syscall(SYS_write, fd, bytes, last ? size / 2 : size);
    if (last) kill(getpid(), SIGKILL);
    return wrote;
}
int fsync(int fd)
{
    if (is_last()) kill(getpid(), SIGKILL);
    return (int)syscall(SYS_fsync, fd);
}
int rename(const char *from, const char *to)
{
    if (is_last()) kill(getpid(), SIGKILL);
    return (int)syscall(SYS_renameat, AT_FDCWD, from, AT_FDCWD, to);
}
"""


def test_kills_while_writing():
    """At each write, fsync and rename in turn; in an empty folder, and over the products of another run."""
    if SANITIZED or not shutil.which("cc"):
        skip("kills while writing: no C compiler, or a sanitized program")
        return
    with tempfile.TemporaryDirectory() as folder:
        library, out = os.path.join(folder, "deadly.so"), os.path.join(folder, "out")
        with open(os.path.join(folder, "deadly.c"), "w") as file:
            file.write(DEADLY)
        subprocess.run(["cc", "-D_GNU_SOURCE", "-shared", "-fPIC", "-o", library, os.path.join(folder, "deadly.c")],
                       check=True)
        dataset = points_set(os.path.join(folder, "set"), clean["points"])
        other = points_set(os.path.join(folder, "other"), views_of(clean["points"], FRAMES[:6]))
        run("calibrate", other, "-o", os.path.join(folder, "before"), "-q")
        at, status, broken = 0, -signal.SIGKILL, []
        while status == -signal.SIGKILL and at < 60:
            at += 1
            if at % 2:
                shutil.copytree(os.path.join(folder, "before"), out)
            status, _, _ = run("calibrate", dataset, "-o", out, "-q", "--no-leave-one-out",
                               env={"LD_PRELOAD": library, "KILL_AT": str(at)})
            broken += [f"{name} at {at}" for name in broken_products(out)]
            if status == -signal.SIGKILL:
                shutil.rmtree(out)
        check(at > 15 and status == 0 and not broken,
              f"killed at each of {at - 1} changes to files: every product is whole {broken}")


def test_kills():
    """At moments of the work; what is there then is whole, and a new run in the same folder does as if nothing had been."""
    with tempfile.TemporaryDirectory() as folder:
        dataset, whole, out = points_set(folder, clean["points"]), os.path.join(folder, "whole"), os.path.join(folder, "out")
        begun = time.monotonic()
        run("calibrate", dataset, "-o", whole, "-q")
        took = time.monotonic() - begun
        check(not broken_products(whole), "an undisturbed run's products are whole")
        killed, broken = 0, []
        for share in (0.1, 0.5, 0.8, 0.9, 0.95, 1):
            job = subprocess.Popen([PROGRAM, "calibrate", dataset, "-o", out, "-q"], stdout=subprocess.DEVNULL)
            time.sleep(share * took)
            job.kill()
            killed += job.wait() == -signal.SIGKILL
            broken += broken_products(out)
        status, _, errors = run("calibrate", dataset, "-o", out, "-q")
        check(killed >= 2 and not broken, f"killed {killed} times: every product is whole {broken}")
        check(status == 0 and contents(out) == contents(whole), f"a new run gives the same bytes {errors}")


test_places()
if not SANITIZED:
    test_interrupts()
    test_kills()
test_kills_while_writing()
finish()
