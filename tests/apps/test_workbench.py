"""The panel's benches: pictures acquired, calibrated and matched over its services, as a client does it.

Nine clicks on each of ViSP's four grids (its real images) calibrate to the figures that `teledimos calibrate --clicks` prints
for the same clicks, digit for digit as the protocol carries them. A point clicked on in aloe (a real pair) gets candidates on
its epipolar line; the first, chosen, is a point in space within 4 sigma + half a disparity step of the set's measured
disparity; three make a triangle; what is exported is those points. A pair of folders, and a video, are shown, frozen (nothing
new comes) and stored as a dataset whose images are the source's, grey value for grey value.

Refused, told, in the audit log, and the bench works on: clicks that are no numbers, outside the picture, too many, on no mark;
names with paths in them, unknown ones, too large requests; what is stored by who does not hold control; a fifth bench. A bench
that is killed is told, and a new one begins; all end with the panel, however it ends. The session's deadlines are judged in
test_panel.py; here only that the session goes on beside a calibration.

Blind to: cameras (there is none); whether clicks are easy to make (the page's test)."""

import concurrent.futures
import csv
import json
import os
import shutil
import signal
import struct
import subprocess
import tempfile
import time

import cv2
import numpy

from common import IMAGES, PROGRAM, SANITIZED, SOURCE, check, finish, read_points, run, skip
from test_panel import Panel, logged

MARKS = os.path.join(SOURCE, "datasets/visp-marks")
ALOE = os.path.join(SOURCE, "datasets/aloe")
GRIDS = "/usr/share/visp-images-data/ViSP-images/calibration"
CLICKED = (0, 5, 30, 35, 14, 15, 20, 21, 2)


def ask(client, service, **arguments):
    """The answer; a failure ends the tests' part."""
    fine, answer = client.order(service, **arguments)
    check(fine, f"{service} {arguments}: {answer if not fine else ''} {client.closed or ''}")
    return answer if fine else {}


def refuse(panel, client, words, service, **arguments):
    """Told, and in the log."""
    fine, why = client.order(service, **arguments)
    check(not fine and why is not None and words in why, f"{service} {str(arguments)[:80]}: '{why}' instead of '{words}'")
    check(not fine and logged(panel, "refused", request=service, why=why), f"{service}: '{why}' is in the audit log")


def workbenches(panel):
    """Ids of the panel's processes."""
    return children("workbench", panel.process.pid)


def children(program, of):
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/stat") as file:
                head, rest = file.read().rsplit(")", 1)
        except OSError:
            continue
        state, parent = rest.split()[:2]
        if head.endswith("(" + program) and int(parent) == of and state != "Z":
            found.append(int(name))
    return found


# ---- calibrate ----

def test_calibrate(folder):
    if not os.path.isdir(GRIDS):
        return skip("visp-images-data is not installed")
    code, _, errors = run("calibrate", MARKS, "-o", os.path.join(folder, "found"), "--no-models", "--no-leave-one-out")
    check(code == 0, f"calibrate: {errors.strip()}")
    points = read_points(os.path.join(folder, "found/points.csv"))
    with Panel(folder, "--bench", MARKS) as panel:
        client = panel.client().keep_alive()
        check("/acquire" not in client.channels and "Store" not in client.services, "no source, nothing to acquire")
        client.subscribe("/session")
        bench = ask(client, "Benches")["benches"]
        check([b["bench"] for b in bench] == ["visp-marks"] and "marks 6x6" in bench[0]["target"], f"benches: {bench}")
        opened = ask(client, "OpenBench", bench="visp-marks")
        frames = [f["frame"] for f in opened["frames"]]
        check(frames == ["01", "02", "03", "04"] and opened["target"]["clickable"], f"opened: {opened}")
        picture = ask(client, "Picture", frame="01", camera="camera")
        check(picture["width"] == 640 and picture["height"] == 480 and picture["format"] == "jpeg", "its picture")
        refuse_clicks(panel, client, points)
        for frame in frames:
            at = points[frame, "camera"]
            clicks = [{"mark": k, "x": round(at[k][0]) + 1, "y": round(at[k][1]) - 1} for k in CLICKED if k in at]
            found = ask(client, "FindMarks", frame=frame, camera="camera", clicks=clicks)
            seen = {k: p for k, p in enumerate(found["points"]) if p}
            check(found["found"] and len(found["clicks"]) == len(clicks) and len(seen) >= 35, f"{frame}: {found['reason']}")
            off = max((abs(numpy.subtract(p, at[k])).max() for k, p in seen.items() if k in at), default=9)
            check(off < 1e-6, f"{frame}: the marks that the command finds, {off:.2g} px off")
        covered = ask(client, "Coverage")
        check(covered["cameras"][0]["views"] == 4 and sum(covered["cameras"][0]["cells"]) > 140 and
              covered["next"]["text"] and len(covered["next"]["outline"]) == 4, f"coverage: {str(covered)[:300]}")
        refuse(panel, client, "TakeControl", "Calibrate")
        ask(client, "TakeControl")
        result = ask(client, "Calibrate")
        again = compare_with_command(folder, panel, result)
        check(again and client.phase() == "ready", f"the session goes on: {client.phase()}")
        check(ask(client, "Benches")["benches"][0]["rig"] == "calibrated", "it has a rig now")
        check(logged(panel, "bench", request="Calibrate"), "the calibration is in the audit log")
        refuse(panel, client, "one camera makes no pair", "MatchOpen", frame="01")
        code, _, errors = panel.end()
        check(code == 0, f"it ends: {code} {errors.strip()}")
    return None


def refuse_clicks(panel, client, points):
    at = points["01", "camera"]
    good = [{"mark": k, "x": at[k][0], "y": at[k][1]} for k in CLICKED]
    where = {"frame": "01", "camera": "camera"}

    def changed(**how):
        return [{**good[0], **how}, *good[1:]]

    refuse(panel, client, "clicks[0].x", "FindMarks", **where, clicks=changed(x="NaN"))
    refuse(panel, client, "clicks[0].x", "FindMarks", **where, clicks=changed(x=None))
    refuse(panel, client, "clicks[0].y: is -3", "FindMarks", **where, clicks=changed(y=-3))
    refuse(panel, client, "clicks[0].x: is 5000", "FindMarks", **where, clicks=changed(x=5000))
    refuse(panel, client, "clicks[0].mark: is 36", "FindMarks", **where, clicks=changed(mark=36))
    refuse(panel, client, "clicks[0].mark", "FindMarks", **where, clicks=changed(mark=1.5))
    refuse(panel, client, "0 to 9 elements, but has 10", "FindMarks", **where, clicks=good + good[:1])
    refuse(panel, client, "both for mark", "FindMarks", **where, clicks=good[:4] + good[:1])
    refuse(panel, client, "clicks", "FindMarks", **where, clicks="all")
    refuse(panel, client, "argument", "FindMarks", **where, click=good)
    refuse(panel, client, "no frame of that name", "FindMarks", frame="../01", camera="camera")
    refuse(panel, client, "no camera of that name", "Picture", frame="01", camera="/etc/passwd")
    refuse(panel, client, "too large", "OpenBench", bench="x" * 5000)
    for name in ("../visp-marks", "/etc", "visp-marks/", "acquired/../..", ""):
        refuse(panel, client, "no bench of that name", "OpenBench", bench=name)
    client.send(2, b"\x02" + client.services["FindMarks"]["id"].to_bytes(4, "little") + (7777).to_bytes(4, "little") +
                b"\x04\0\0\0json" + b'{"frame": "01", "camera": "camera", "clicks": [{"mark": 1, "x": NaN, "y": 1e999}]}')
    client.until(lambda: 7777 in client.answers)
    check(not client.answers[7777][0] and "no JSON" in client.answers[7777][1], f"a NaN: {client.answers[7777]}")
    client.call_id = 7777
    nowhere = ask(client, "FindMarks", **where, clicks=[{**c, "x": c["x"] + 37, "y": c["y"] + 33} for c in good[:4]])
    check(not nowhere["found"] and "px away" in nowhere["reason"] and not nowhere["clicks"],
          f"clicks on no mark are told, and not kept: {nowhere['reason']}")


def compare_with_command(folder, panel, result):
    code, text, errors = run("calibrate", MARKS, "-o", os.path.join(folder, "command"), "--json", "--clicks",
                             os.path.join(panel.out, "calibrated/visp-marks/clicks.csv"))
    check(code == 0, f"calibrate --clicks: {errors.strip()}")
    command = json.loads(text)
    for key in ("intrinsics", "distortion", "sigma_intrinsics", "sigma_distortion"):
        ours, theirs = result["cameras"]["camera"][key], command["cameras"]["camera"][key]
        check(numpy.allclose(ours, theirs, rtol=1e-10, atol=0), f"{key}: {ours} and by the command {theirs}")
    check(result["verdict"] == command["verdict"] and result["reasons"] == command["reasons"], f"verdict: {result['verdict']}")
    with open(os.path.join(panel.out, "calibrated/visp-marks/rig.yaml")) as ours:
        with open(os.path.join(folder, "command/rig.yaml")) as theirs:
            return ours.read() == theirs.read()


# ---- match ----

def depth_of_truth(truth, x, y):
    """Depth by the set's disparity, and by one a step of it (a grey value) smaller."""
    f, baseline, offset = 1246.67, 0.16, 90.0  # datasets/aloe/rig.yaml: the principal points are 90 px apart
    d = float(truth[y, x])
    return f * baseline / (d + offset), f * baseline / (d - 0.5 + offset)


def test_match(folder):
    if not os.path.isfile(os.path.join(IMAGES, "aloeL.jpg")):
        return skip("opencv-doc is not installed")
    truth = cv2.imread(os.path.join(IMAGES, "aloeGT.png"), cv2.IMREAD_GRAYSCALE)
    moved = os.path.join(folder, "moved")
    shutil.copytree(ALOE, moved)
    with open(os.path.join(moved, "rig.yaml")) as file:
        text = file.read()
    with open(os.path.join(moved, "rig.yaml"), "w") as file:
        file.write(text.replace("cx: 730.5, cy: 554.5", "cx: 730.5, cy: 557.5"))  # as if the right camera had turned
    with Panel(folder, "--bench", ALOE, "--bench", moved) as panel:
        client = panel.client().keep_alive()
        refuse(panel, client, "OpenBench first", "MatchOpen", frame="aloe")
        ask(client, "OpenBench", bench="aloe")
        refuse(panel, client, "MatchOpen first", "MatchPoint", x=10, y=10)
        refuse(panel, client, "near_m", "MatchOpen", frame="aloe", near_m=-1)
        refuse(panel, client, "no bench of that name", "MatchOpen", frame="aloe", rig="../aloe")
        pair = ask(client, "MatchOpen", frame="aloe", near_m=0.55, far_m=2.2)
        check(pair["left"]["width"] == 1282 and pair["in"] == "vehicle" and not pair["calibration_known"], f"pair: {pair}")
        check(len(ask(client, "InterestPoints")["points"]) > 300, "interest points")
        fits = ask(client, "MatchCheck")
        check(fits["belongs"] and fits["rms_px"] < 0.15 and fits["matches"] > 100, f"the pictures belong to the rig: {fits}")
        refuse(panel, client, "MatchPoint first", "MatchChoose", candidate=0)
        for x, y, words in ((-20, 5, "x"), ("NaN", 5, "x"), (1e6, 5, "x"), (1281.4, 5, "edge"), (3, 500, "edge")):
            refuse(panel, client, words, "MatchPoint", x=x, y=y)
        for number, (x, y) in enumerate(((600, 500), (821, 1001), (1000, 900)), 1):
            state = pick(panel, client, truth, x, y)
            check(len(state["points"]) == number and state["points"][-1]["point"] == str(number), f"point {number} stands in the list")
        check(state["triangles"] == [[0, 1, 2]] or len(state["triangles"]) == 1, f"the surface grows: {state['triangles']}")
        ask(client, "MatchPoint", x=400, y=300)
        refuse(panel, client, "candidate", "MatchChoose", candidate=99)
        refuse(panel, client, "outside the right image", "MatchChoose", x=5000, y=300)
        by_hand = ask(client, "MatchChoose", x=345, y=300)
        check(len(by_hand["points"]) == 4 and by_hand["points"][3]["refined"] and
              abs(by_hand["points"][3]["right"][0] - 345.4) < 0.2, f"a place by hand is refined: {by_hand['points'][3]}")
        back = ask(client, "MatchUndo")
        check(back["points"] == state["points"] and back["triangles"] == state["triangles"], "undone")
        refuse(panel, client, "TakeControl", "MatchExport")
        ask(client, "TakeControl")
        files = ask(client, "MatchExport")
        check(files["files"] == ["matches.csv", "points.ply", "map.tif"], f"exported: {files}")
        with open(os.path.join(panel.out, files["folder"], "matches.csv")) as file:
            rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
        check([float(r["z_m"]) for r in rows] == [round(p["p"][2], 5) for p in state["points"]], "the points that were chosen")
        for _ in range(3):
            ask(client, "MatchUndo")
        test_moved(client)
        refuse(panel, client, "no point", "MatchUndo")
        refuse(panel, client, "no points yet", "MatchExport")
    return None


def test_moved(client):
    ask(client, "OpenBench", bench="moved")
    ask(client, "MatchOpen", frame="aloe", near_m=0.55, far_m=2.2)
    fits = ask(client, "MatchCheck")
    turn = abs(fits["rotation_rad"][0])
    check(not fits["belongs"] and fits["rms_px"] > 2 and fits["corrected_px"] < 0.3 and abs(turn - 3 / 1246.67) < 3e-4,
          f"a camera that has turned is told: {fits}")
    ask(client, "OpenBench", bench="aloe")
    ask(client, "MatchOpen", frame="aloe")


def pick(panel, client, truth, x, y):
    answer = ask(client, "MatchPoint", x=x, y=y)
    first = answer["candidates"][0]
    rows = [point[1] for point in answer["curve"]]
    check(max(rows) - min(rows) < 1e-6 and abs(rows[0] - y) < 1e-6, "the epipolar curve of a rectified pair is its row")
    check(all(a["zncc"] >= b["zncc"] for a, b in zip(answer["candidates"], answer["candidates"][1:])), "best first")
    state = ask(client, "MatchChoose", candidate=0)
    depth, further = depth_of_truth(truth, x, y)
    z = 1.5 - state["points"][-1]["p"][2]
    sigma = state["points"][-1]["sigma_matching_m"]
    bound = 4 * sigma + abs(further - depth)
    check(first["zncc"] > 0.9 and abs(z - depth) < bound,
          f"({x}, {y}): depth {z:.4f} m ± {sigma:.4f}, by the set {depth:.4f}, bound {bound:.4f}")
    return state


def test_rig(folder):
    """A pair by the rig that was calibrated here: sigma then holds the calibration's part."""
    if not os.path.isdir(IMAGES):
        return skip("opencv-doc is not installed")
    with Panel(folder, "--bench", os.path.join(SOURCE, "datasets/opencv-stereo")) as panel:
        client = panel.client().keep_alive()
        ask(client, "TakeControl")
        ask(client, "OpenBench", bench="opencv-stereo")
        refuse(panel, client, "has no rig", "MatchOpen", frame="01")
        refuse(panel, client, "only marks", "FindMarks", frame="01", camera="left", clicks=[{"mark": 0, "x": 1, "y": 1}])
        left, right = (ask(client, "FindMarks", frame="01", camera=camera)["points"] for camera in ("left", "right"))
        result = ask(client, "Calibrate")
        check(result["verdict"] == "accepted" and abs(result["stereo"]["baseline_m"] - 0.0831) < 0.0005, f"calibrated: {result['reasons']}")
        pair = ask(client, "MatchOpen", frame="01", near_m=0.2)
        check(pair["rig"] == "calibrated" and pair["calibration_known"] and pair["in"] == "rig", f"the pair: {pair}")
        for k in (0, 8, 45):  # the board's corners look alike: by hand, to a pixel
            ask(client, "MatchPoint", x=left[k][0], y=left[k][1])
            state = ask(client, "MatchChoose", x=round(right[k][0]), y=round(right[k][1]))
        point = state["points"][-1]
        covariance = numpy.reshape(point["covariance"], (3, 3))
        check(point["sigma_m"] > point["sigma_matching_m"] > 0 and point["sigma_calibration_m"] > 0 and
              numpy.all(numpy.linalg.eigvalsh(covariance) > 0) and
              abs(numpy.sqrt(numpy.linalg.eigvalsh(covariance)[-1]) - point["sigma_m"]) < 1e-9, f"its sigma: {point['sigma_m']}")
        p = [numpy.array(q["p"]) for q in state["points"]]
        wide, high = numpy.linalg.norm(p[1] - p[0]), numpy.linalg.norm(p[2] - p[0])
        check(abs(wide - 8 * 0.025) < 0.002 and abs(high - 5 * 0.025) < 0.002, f"the board's sides: {wide:.4f} x {high:.4f} m")
        # Another dataset for calibrating leaves the pair as it is.
        ask(client, "OpenBench", bench="opencv-stereo", **{"for": "calibrate"})
        check(len(ask(client, "MatchUndo")["points"]) == 2, "the pair's points stay")
        ask(client, "OpenBench", bench="opencv-stereo", **{"for": "match"})
        refuse(panel, client, "MatchOpen first", "MatchUndo")
        refuse(panel, client, "calibrate or match", "OpenBench", bench="opencv-stereo", **{"for": "fun"})
        # A solve that is under way does not outlive the panel.
        number = client.services["Calibrate"]["id"]
        client.send(2, struct.pack("<BIII", 2, number, 9999, 4) + b"json{}")
        (bench,) = workbenches(panel)
        check(client.until(lambda: children("calibrate", bench), 10), "a solve is under way")
        end_with_panel(panel, [bench, *children("calibrate", bench)])
    return None


# ---- acquire ----

def write_video(path):
    video = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 20, (320, 240))
    generator = numpy.random.default_rng(1)
    texture = cv2.GaussianBlur(generator.integers(0, 255, (240, 480), dtype=numpy.uint8), (0, 0), 2)
    for k in range(200):
        video.write(cv2.cvtColor(texture[:, k // 2:k // 2 + 320], cv2.COLOR_GRAY2BGR))
    video.release()


def test_acquire(folder):
    if not os.path.isdir(IMAGES):
        return skip("opencv-doc is not installed")
    sources = [os.path.join(IMAGES, side + "??.jpg") for side in ("left", "right")]
    with Panel(folder, "--left", sources[0], "--right", sources[1], "--target", "chessboard 9x6 25mm") as panel:
        client, watcher = panel.client().keep_alive(), panel.client().keep_alive()
        refuse(panel, client, "TakeControl", "Freeze")
        check(not workbenches(panel), "nobody watches, nothing runs")
        ask(client, "TakeControl")
        refuse(panel, client, "watch /acquire", "Store")
        client.subscribe("/acquire", "/acquire/left", "/acquire/right")
        check(client.until(lambda: client.newest("/acquire").get("seen", 0) == 13 and client.counts.get("/acquire/right", 0) > 5),
              f"13 pairs come: {client.newest('/acquire')}")
        state, image = client.newest("/acquire"), client.newest("/acquire/left")
        check(state["names"] == ["left14.jpg", "right14.jpg"] and min(state["focus"]) > 5, f"state: {state}")
        check(image["format"] == "jpeg" and image["frame_id"] == "left" and len(image["data"]) > 10000, "foxglove.CompressedImage")
        refuse(panel, watcher, "another client", "Store")
        check(ask(client, "Freeze", on=True) == {"frozen": True}, "frozen")
        refuse(panel, client, "on", "Freeze", on="yes")
        stored = ask(client, "Store")
        check(stored["folder"] == "acquired" and stored["stored"] == 1, f"stored: {stored}")
        refuse(panel, client, "stored already", "Store")
        ours = cv2.imread(os.path.join(panel.out, "acquired/right", stored["frame"] + ".pgm"), cv2.IMREAD_UNCHANGED)
        theirs = cv2.imread(os.path.join(IMAGES, "right14.jpg"), cv2.IMREAD_GRAYSCALE)
        check(ours is not None and abs(ours.astype(int) - theirs).max() <= 1, "what is stored is the picture")
        bench = ask(client, "Benches")["benches"]
        check(bench[0]["bench"] == "acquired" and bench[0]["target"].startswith("chessboard"), f"a bench of what is stored: {bench}")
        ask(client, "OpenBench", bench="acquired")
        found = ask(client, "FindMarks", frame=stored["frame"], camera="left")
        check(found["found"] and found["seen"] == 54, f"the board is found: {found['reason']}")
        refuse(panel, client, "only marks", "FindMarks", frame=stored["frame"], camera="left", clicks=[{"mark": 0, "x": 1, "y": 1}])
        refuse(panel, client, "", "Calibrate")
        client.close()
        check(watcher.until(lambda: len(workbenches(panel)) == 0, 12), "who watched is gone: nothing runs")
    return None


def test_video(folder):
    path = os.path.join(folder, "moving.avi")
    write_video(path)
    with Panel(folder, "--left", path) as panel:
        client = panel.client().keep_alive()
        check("/acquire/right" not in client.channels, "one camera")
        ask(client, "TakeControl")
        client.subscribe("/acquire", "/acquire/left")
        client.until(lambda: client.newest("/acquire").get("seen", 0) >= 4)
        begun, before = time.monotonic(), client.newest("/acquire")["seen"]
        client.until(lambda: client.newest("/acquire")["seen"] >= before + 20)
        rate = (client.newest("/acquire")["seen"] - before) / (time.monotonic() - begun)
        busy = SANITIZED or os.getloadavg()[0] > os.cpu_count()  # benches give way to whatever else runs
        check(rate < 12 and (rate > 7 or busy), f"about ten pictures a second: {rate:.1f}")
        ask(client, "Freeze")
        client.watch(0.3)
        seen = client.newest("/acquire")["seen"]
        client.watch(1)
        check(client.newest("/acquire")["seen"] == seen and client.newest("/acquire")["frozen"], "frozen: nothing new")
        first = ask(client, "Store")
        ask(client, "Freeze", on=False)
        check(client.until(lambda: client.newest("/acquire")["seen"] > seen, 5), "it goes on")
        second = ask(client, "Store")
        check(second["stored"] == 2 and first["frame"] != second["frame"], f"stored: {first} {second}")
        opened = ask(client, "OpenBench", bench="acquired")
        check(opened["target"] is None and len(opened["frames"]) == 2, f"without a target it can be looked at: {opened}")
        check(ask(client, "Picture", frame=first["frame"], camera="camera")["width"] == 320, "a stored picture")
        refuse(panel, client, "does not say what target", "Coverage")
    with Panel(os.path.join(folder), "--left", os.path.join(folder, "missing.avi")) as panel:
        client = panel.client()
        client.subscribe("/acquire")
        check(client.until(lambda: "missing.avi" in client.newest("/acquire").get("trouble", ""), 10),
              f"a source that is not there is told: {client.newest('/acquire')}")


# ---- many, and their ends ----

def end_with_panel(panel, processes):
    panel.process.kill()
    panel.process.wait()
    end = time.monotonic() + 0.7  # a solve takes longer
    while time.monotonic() < end and any(alive(process) for process in processes):
        time.sleep(0.02)
    check(not any(alive(process) for process in processes), "all end with a panel that is killed")



def test_processes(folder):
    pictures = os.path.join(folder, "pictures")
    os.makedirs(pictures)
    cv2.imwrite(os.path.join(pictures, "one.png"), numpy.full((60, 80), 90, numpy.uint8))
    with Panel(folder, "--bench", pictures) as panel:
        clients = [panel.client().keep_alive() for _ in range(6)]
        for client in clients[:4]:
            check(ask(client, "OpenBench", bench="pictures")["frames"][0]["frame"] == "one", "a folder of pictures")
        check(len(workbenches(panel)) == 4, f"a bench each: {workbenches(panel)}")
        refuse(panel, clients[4], "all four", "Benches")
        ask(clients[5], "TakeControl")
        ask(clients[5], "Benches")
        check(clients[0].until(lambda: any("who holds control" in t.get("message", "") for t in clients[0].texts), 5),
              "who holds control gets the one used longest ago, and its client is told")
        check(len(workbenches(panel)) == 4, "still four")
        refuse(panel, clients[0], "all four", "Benches")
        clients[1].close()
        clients[4].watch(0.5)
        check(ask(clients[4], "Benches")["benches"], "a place that is given up is another's")
        for process in workbenches(panel):
            os.kill(process, signal.SIGKILL)
        check(clients[2].until(lambda: any("signal 9" in t.get("message", "") for t in clients[2].texts), 5),
              f"a bench that is killed is told: {clients[2].texts[-1:]}")
        refuse(panel, clients[2], "OpenBench first", "Picture", frame="one", camera="picture")
        ask(clients[2], "OpenBench", bench="pictures")
        check(ask(clients[2], "Picture", frame="one", camera="picture")["width"] == 80, "a new one works")
        end_with_panel(panel, workbenches(panel))


def alive(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_alone(folder):
    """The program by itself: lines in, lines out."""
    lines = ['{"id": 1, "op": "Benches"}', "not json", '{"id": 3, "op": "Dance"}', '{"id": 4}', "[5]", '{"id": 6, "op": "' + "x" * 9000 + '"}',
             '{"id": 7, "op": "OpenBench", "bench": "visp-marks"}']
    done = subprocess.run([PROGRAM, "workbench", "pictures", MARKS, "-o", folder], input="\n".join(lines) + "\n", text=True,
                          capture_output=True, timeout=60)
    said = [line.split(" ", 2)[:2] for line in done.stdout.splitlines()]
    check(done.returncode == 0 and said == [["answer", "1"], ["failure", "0"], ["failure", "3"], ["failure", "4"], ["failure", "0"],
                                            ["failure", "0"], ["answer", "7"]], f"lines: {said} {done.stderr}")
    for arguments in (("acquire",), ("dance",), ()):
        code, _, errors = run("workbench", *arguments, "-o", folder)
        check(code == 2 and "usage" in errors, f"workbench {arguments}: {code} {errors.strip()}")
    code, _, errors = run("panel", os.path.join(SOURCE, "datasets/zx200/paper.yaml"), "-o", folder, "--right", "x")
    check(code == 2 and "--left" in errors, f"--right alone: {code} {errors.strip()}")


def in_its_folder(test):
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        test(folder)
    print(f"{test.__name__}: {time.monotonic() - begun:.1f} s", flush=True)


with concurrent.futures.ThreadPoolExecutor(3) as pool:
    for done in [pool.submit(in_its_folder, test) for test in (test_acquire, test_video, test_calibrate, test_rig, test_match, test_processes,
                                                           test_alone)]:
        done.result()
finish()
