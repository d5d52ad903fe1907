"""Proves of `teledimos reconstruct` as a batch: killed at random moments and run again it ends with the bytes of an
undisturbed run, as it does with one thread and two, with MPI's ranks (of which one is killed, and mpirun itself), and with
memory for a single tile; a full disk is one sentence, leaves no product in part, and the run goes on when there is space; two
runs do not mix in one folder; an image that was damaged and is whole again is taken anew; the cameras' times matter by the
base's motion; frames of two lossless videos make the same bytes as their images; memory is foreseen, and not too little.

Reference: the undisturbed run on images; drawn here are a plane of random texture 3 m below a camera of f 400 px and baseline
0.4 m, so the heights are 0 (within 30 mm: 0.1 px is 5.6 mm there,
and the worst of 27 000 cells lies five times as far). By f v / near * dt, 0.5 m/s and 10 ms are 1 px at 2 m,
which is refused. Blind to: machines that differ, networks; losses of power."""

import fcntl
import json
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time

import cv2
import numpy as np

from common import FULL, PROGRAM, SANITIZED, check, fault_of_sentence, finish, leftovers, run, skip

work = tempfile.mkdtemp()
site = os.path.join(work, "site")
COUNT = 4 if SANITIZED else 24 if FULL else 8
SIZE, F, BASE, HIGH = (320, 240), 400.0, 0.4, 3.0
how = ["--near", "2", "--far", "5", "--cell", "0.02"]
PRODUCTS = ("map.tif", "map.ply")
HEADER = "frame,time_s,left,right,x_m,y_m,z_m,qw,qx,qy,qz\n"
RIG = """teledimos: rig 1
cameras:
""" + "".join(f"""  - name: {name}
    model: pinhole
    width: {SIZE[0]}
    height: {SIZE[1]}
    intrinsics: {{fx: {F}, fy: {F}, cx: 159.5, cy: 119.5}}
    distortion: {{}}
    camera_from_rig: {{q: [1, 0, 0, 0], t_m: [{x}, 0, 0]}}
""" for name, x in (("left", 0), ("right", -BASE))) + """vehicle_from_rig: {q: [0, 0.70710678118654752, -0.70710678118654752, 0], t_m: [0, 0, 3]}
"""


def draw_site():
    """The camera's x is the vehicle's -y, its y the vehicle's -x. The texture has 5 mm a pixel, from x -2 m, y -3 m on."""
    for side in ("left", "right"):
        os.makedirs(f"{site}/{side}")
    rng = np.random.default_rng(4)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (1200, 2000)).astype(np.float32), (0, 0), 1.2)
    texture = np.clip(128 + 3 * (texture - 128), 0, 255)
    v, u = np.mgrid[0:SIZE[1], 0:SIZE[0]].astype(np.float32)
    rows = HEADER
    for i in range(COUNT):
        for side, shift in (("left", 0), ("right", BASE)):
            y, x = -((u - 159.5) / F * HIGH + shift), 0.5 * i - (v - 119.5) / F * HIGH
            image = cv2.remap(texture, ((x + 2) / 0.005).astype(np.float32), ((y + 3) / 0.005).astype(np.float32), cv2.INTER_CUBIC)
            cv2.imwrite(f"{site}/{side}/{i:02}.png", np.clip(image, 0, 255).astype(np.uint8))
        rows += f"{i:02},{i},left/{i:02}.png,right/{i:02}.png,{0.5 * i},0,0,1,0,0,0\n"
    write_site(site, rows)


def write_site(folder, rows):
    os.makedirs(folder, exist_ok=True)
    for name, text in (("rig.yaml", RIG), ("frames.csv", rows),
                       ("dataset.yaml", "name: plane\nrig: rig.yaml\ncameras:\n  - {name: left, model: pinhole}\n"
                                        "  - {name: right, model: pinhole}\n")):
        with open(f"{folder}/{name}", "w") as file:
            file.write(text)
    return folder


def table():
    return open(f"{site}/frames.csv").read()


def products(folder):
    return {name: open(f"{folder}/{name}", "rb").read() for name in PRODUCTS if os.path.exists(f"{folder}/{name}")}


def same(folder):
    return products(folder) == reference


def whole(folder):
    """What is there under the products' names is all there."""
    return all(bytes_ == reference[name] for name, bytes_ in products(folder).items())


def begin(folder, *before, dataset=site):
    environment = dict(os.environ, OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
    return subprocess.Popen([*before, PROGRAM, "reconstruct", dataset, "-o", folder, "--json", *how], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, encoding="utf-8", env=environment)


def ranks(count):
    return ["mpirun", "--oversubscribe", "-n", str(count)]


def again(folder, what):
    code, out, err = run("reconstruct", site, "-o", folder, "--json", *how)
    resumed = json.loads(out)["frames"]["resumed"] if code == 0 else -1
    check(code == 0 and same(folder), f"{what}: run again, {resumed} of {COUNT} frames taken over, the same bytes {err[-150:]}")
    return resumed


def test_reference():
    global reference, took
    began = time.monotonic()
    code, out, err = run("reconstruct", site, "-o", f"{work}/plain", "--threads", "1", *how)
    took = time.monotonic() - began
    check(code == 0 and f"frames: {COUNT} in the map, 0 left out" in out and "MB were foreseen" in out and " s a frame" in out,
          f"the run is summed up: {out[out.find('frames:'):][:150]!r} {err[-150:]}")
    reference = products(f"{work}/plain")
    code, out, _ = run("reconstruct", site, "-o", f"{work}/two", "--threads", "2", "--json", "--memory", "1", "-v", *how)
    result = json.loads(out)
    check(code == 0 and same(f"{work}/two") and not os.path.exists(f"{work}/two/state/tiles"),
          "two threads and memory for one tile: the same bytes, and no tile is left")
    low, high = result["map"]["height_m"]
    check(result["map"]["cells"] > 10000 and -0.03 < low and high < 0.03,
          f"{result['map']['cells']} cells from {1e3 * low:.1f} to {1e3 * high:.1f} mm")
    text = open(f"{work}/two/log.jsonl").read()
    check("memory: at most" in text, "the memory is foreseen in the log")


def test_memory():
    """Peak by the kernel's count against what was foreseen (a sanitizer takes more)."""
    _, out, _ = run("reconstruct", site, "-o", f"{work}/memory", *how)
    words = out[out.find("memory:"):].split()
    foreseen, used = float(words[3]), float(words[7])
    check(SANITIZED or (0 < used < foreseen < 4 * used), f"{used:.0f} MB were used, at most {foreseen:.0f} MB foreseen")


def test_kills():
    moments = random.Random(7)
    resumed = 0
    for k in range(20 if FULL else 4):
        folder, moment = f"{work}/kill{k}", moments.uniform(0.05, 1.05) * took
        child = begin(folder)
        time.sleep(moment)
        child.kill()
        child.communicate()
        check(whole(folder), f"killed after {moment:.2f} s: nothing in part")
        resumed += again(folder, "killed") > 0
        check(not leftovers(folder) and not leftovers(f"{folder}/state"), "no temporary file is left")
        shutil.rmtree(folder)
    check(resumed > 0 or SANITIZED, f"{resumed} runs took over frames")


# A library that is loaded before the C library: dies just after the KILL_AT-th file has got its name. Files that are not waited
# for make saving so quick that it is done after each frame.
DEADLY = """
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <unistd.h>

int fsync(int fd)
{
    return fd < 0 ? -1 : 0;
}
int rename(const char *from, const char *to)
{
    static int left;
    int status = (int)syscall(SYS_renameat, AT_FDCWD, from, AT_FDCWD, to);
    if (!left) left = atoi(getenv("KILL_AT"));
    if (--left == 0) kill(getpid(), SIGKILL);
    return status;
}
"""


def test_kills_between_files():
    """Three files a frame, the picture's, the map's and the progress; then the products."""
    if SANITIZED or not shutil.which("cc"):
        skip("kills between files: no C compiler, or a sanitized program")
        return
    with open(f"{work}/deadly.c", "w") as file:
        file.write(DEADLY)
    subprocess.run(["cc", "-D_GNU_SOURCE", "-shared", "-fPIC", "-o", f"{work}/deadly.so", f"{work}/deadly.c"], check=True)
    folder, resumed = f"{work}/between", []
    for at in range(1, 3 * COUNT + 9) if FULL else (2, 5, 3 * COUNT + 1):
        code, _, _ = run("reconstruct", site, "-o", folder, *how, env={"LD_PRELOAD": f"{work}/deadly.so", "KILL_AT": str(at)})
        check(code in (0, -signal.SIGKILL) and whole(folder), f"killed after file {at}: nothing in part")
        resumed.append(again(folder, f"killed after file {at}"))
        shutil.rmtree(folder)
    check(len(set(resumed)) > 2, f"frames taken over: {resumed}")


def test_ranks():
    if not shutil.which("mpirun"):
        skip("mpirun is not installed")
        return
    for count in (2, 4):
        child = begin(f"{work}/ranks{count}", *ranks(count))
        out, err = child.communicate(timeout=300)
        check(child.returncode == 0 and same(f"{work}/ranks{count}") and json.loads(out)["frames"]["used"] == COUNT,
              f"{count} ranks: the same bytes, said once {err[-200:]}")
    code, _, err = run("reconstruct", site, "-o", f"{work}/alone", *how, env={"SLURM_STEP_NUM_TASKS": "2"})
    err = "".join(line for line in err.splitlines(True) if line.strip() and not line.startswith("[hwloc"))  # Open MPI's, where /sys is hidden
    check(code == 1 and "srun --mpi=pmix" in err and not fault_of_sentence(err, "reconstruct") and not os.path.exists(f"{work}/alone"),
          f"Slurm's tasks that do not know of each other: {err.strip()[-100:]}")
    folder = f"{work}/one-bad"
    shutil.copytree(site, folder)
    os.remove(f"{folder}/right/01.png")
    child = begin(f"{work}/out-bad", *ranks(2), dataset=folder)
    out, err = child.communicate(timeout=300)
    failed = json.loads(out)["frames"]["failed"]
    check(child.returncode == 3 and [f["name"] for f in failed] == ["01"] and "01.png" in failed[0]["reason"],
          f"a frame that fails on another rank is named, and mpirun ends with {child.returncode}: {failed}")
    child = begin(f"{work}/out-none", *ranks(2), dataset=f"{work}/none")
    out, err = child.communicate(timeout=300)
    check(child.returncode == 1 and err.count(f"{work}/none") == 1, "a dataset that is not there is named once")
    for whom in ("mpirun", "a rank"):
        folder = f"{work}/mpi-{whom[-4:]}"
        child = begin(folder, *ranks(2))
        until = time.monotonic() + 60
        while not os.path.exists(f"{folder}/state/progress.yaml") and child.poll() is None and time.monotonic() < until:
            time.sleep(0.01)
        children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(child.pid)], capture_output=True, text=True).stdout.split()
        os.kill(child.pid if whom == "mpirun" else int(children[-1]), signal.SIGKILL)
        child.communicate(timeout=60)
        check(child.returncode != 0 and whole(folder), f"{whom} is killed: {child.returncode}, nothing in part")
        check(again(folder, f"{whom} killed") > 0, "what was done is not done again")


def test_full_disk():
    disk = f"{work}/disk"
    os.mkdir(disk)
    stages = set()
    for size, state_there in (("400k", True), ("2500k" if SANITIZED else "4m", True), ("100k", False), ("700k", False)):
        if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk], capture_output=True).returncode != 0:
            skip("a full disk: none can be mounted here")
            return
        try:
            folder = f"{disk}/out"
            os.mkdir(folder)
            if not state_there:
                os.mkdir(f"{work}/state{size}")
                os.symlink(f"{work}/state{size}", f"{folder}/state")
            code, out, err = run("reconstruct", site, "-o", folder, *how)
            stages.add(err.split(disk)[-1].split(":")[0])
            check(code == 1 and not fault_of_sentence(err, "reconstruct") and "No space left" in err and whole(folder)
                  and "result.yaml" not in os.listdir(folder) and not leftovers(folder), f"a disk of {size}: {err.strip()[-110:]}")
            subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
            again(folder, "space was made")
        finally:
            subprocess.run(["umount", disk], check=True)
    check(len(stages) > 2, f"it was full at different times: {sorted(stages)}")


def test_folder_in_use():
    os.makedirs(f"{work}/used/state")
    with open(f"{work}/used/state/lock", "w") as lock:
        fcntl.lockf(lock, fcntl.LOCK_EX)
        code, _, err = run("reconstruct", site, "-o", f"{work}/used", *how)
        check(code == 1 and "another run" in err and not fault_of_sentence(err, "reconstruct"), f"a folder in use: {err.strip()[-90:]}")
    again(f"{work}/used", "then free")


def test_repaired():
    """Frame 2 damaged, frame 3 without a pose: with frame 2 whole again the map begins anew, and frame 3 still has no pose."""
    folder = f"{work}/damaged"
    shutil.copytree(site, folder)
    path = f"{folder}/left/02.png"
    data = open(path, "rb").read()
    write_site(folder, table().replace("03,3,left/03.png,right/03.png,1.5", "03,3,left/03.png,right/03.png,nan"))
    for content, names in ((data[:2000], ["02", "03"]), (data[:2000], ["02", "03"]), (data, ["03"])):
        open(path, "wb").write(content)
        code, out, err = run("reconstruct", folder, "-o", f"{work}/repaired", "--json", *how)
        failed = [f["name"] for f in json.loads(out)["frames"]["failed"]]
        check(code == 3 and failed == names, f"left out: {failed}")
    check("beginning anew" in err and "images have changed" in err, "an image that is whole again is taken")


def test_skew():
    lines = table().strip().split("\n")
    for seconds, moving, status, words in ((0.01, True, 3, " px in between"), (0.0001, True, 0, None), (0.5, False, 0, None)):
        rows = lines[0] + ",left_time_s,right_time_s\n"
        for i, line in enumerate(lines[1:3]):
            cells = line.split(",")
            if not moving:
                cells[4] = "0"
            rows += ",".join(cells) + f",{i},{i + seconds}\n"
        rows = rows.replace(",left/", f",{site}/left/").replace(",right/", f",{site}/right/")
        folder = write_site(f"{work}/skew", rows)
        code, out, _ = run("reconstruct", folder, "-o", f"{work}/skewed", "--json", *how)
        reasons = json.loads(out)["reasons"]
        found = [r for r in reasons if "times differ" in r]
        check(code == status and (words in found[0] if words else not found),
              f"{1e3 * seconds:g} ms, {'at 0.5 m/s' if moving else 'standing'}: {code} {found}")
    rows = rows.replace("time_s,left,", "when,left,")
    write_site(folder, rows)
    code, out, _ = run("reconstruct", folder, "-o", f"{work}/skewed", "--json", *how)
    check(code == 3 and any("500.0 ms" in r for r in json.loads(out)["reasons"]), "without times of the frames the skew itself counts")


def test_video():
    folder = f"{work}/video"
    os.makedirs(folder)
    for side in ("left", "right"):
        video = cv2.VideoWriter(f"{folder}/{side}.mkv", cv2.VideoWriter_fourcc(*"FFV1"), 10, SIZE)
        if not video.isOpened():
            skip("videos: OpenCV writes no FFV1 here")
            return
        for i in range(COUNT):
            grey = cv2.imread(f"{site}/{side}/{i:02}.png", cv2.IMREAD_GRAYSCALE)
            video.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
        video.release()
    rows = table()
    for i in range(COUNT):
        for side in ("left", "right"):
            rows = rows.replace(f"{side}/{i:02}.png", f"{side}.mkv#{i}")
    write_site(folder, rows)
    code, out, err = run("reconstruct", folder, "-o", f"{work}/filmed", "--json", *how)
    check(code == 0 and same(f"{work}/filmed"), f"pictures of two videos: the bytes of their images {err[-200:]}")
    code, out, err = run("reconstruct", folder, "-o", f"{work}/filmed", "--json", *how)
    check(code == 0 and json.loads(out)["frames"]["resumed"] == COUNT, "and taken over in the next run")
    late = rows.replace("right.mkv#1,", "right.mkv#3,").replace(f"left.mkv#{COUNT - 1}", "left.mkv#999")
    late = late.replace("left.mkv#2,", "nothing.mkv#2,")
    write_site(folder, late)
    code, out, err = run("reconstruct", folder, "-o", f"{work}/late", "--json", *how)
    result = json.loads(out)
    reasons = {f["name"]: f["reason"] for f in result["frames"]["failed"]}
    check(code == 3 and f"has {COUNT} pictures" in reasons.get(f"{COUNT - 1:02}", ""), f"a picture past the end: {reasons}")
    check("nothing.mkv" in reasons.get("02", ""), "a video that is not there")
    check(any("times differ" in r for r in result["reasons"]), f"pictures of different times are told: {result['reasons']}")


draw_site()
test_reference()
test_memory()
test_kills()
test_kills_between_files()
test_ranks()
test_full_disk()
test_folder_in_use()
test_repaired()
test_skew()
test_video()
shutil.rmtree(work)
finish()
