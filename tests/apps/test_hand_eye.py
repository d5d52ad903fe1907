"""Proves: `teledimos hand-eye` on real sets (ViSP's two Franka sets, RWHE's kuka_2, ETHZ's streams, OpenCV's stereo pairs)
gives X, Z, their sigma and its verdict under the keys that are promised, marks the closed forms that fail, and stays within
the figures known for these sets; a wrong square, confused conventions and motions that determine nothing are named.
Reference: figures of a trial of the same noise model on the same sets; the stereo pair's own relative pose; synthetic motions
made here with numpy. Bounds of leave-one-out are the trial's, rounded up by 1 %. Blind to: X's truth on the robots, which is
not known (tests/calib/test_hand_eye_real.c has its repeatability)."""

import csv
import json
import os
import re
import tempfile

import numpy as np
import yaml

from common import SANITIZED, SOURCE, check, fault_of_sentence, finish, run, skip

DATA = os.environ.get("TELEDIMOS_DATA")


def job(dataset, *options, expect=0):
    """Result of a run with --json, or None."""
    with tempfile.TemporaryDirectory() as out:
        status, text, errors = run("hand-eye", dataset, "-o", out, "--json", "-q", *options)
        if status != expect:
            check(False, f"hand-eye {dataset}: exit {status} instead of {expect}: {errors[:300]}")
        return json.loads(text) if text else None


def rotation(q):
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def matrix(pose):
    m = np.eye(4)
    m[:3, :3] = rotation(pose["q"])
    m[:3, 3] = pose["t_m"]
    return m


def quaternion(r):
    """w x y z of a rotation matrix, by its largest component."""
    k = np.array([[r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0], [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
                  [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
                  [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]]]) / 3
    values, vectors = np.linalg.eigh(k)
    x, y, z, w = vectors[:, np.argmax(values)]
    return np.array([w, x, y, z]) * (1 if w >= 0 else -1)


def angle(r):
    return np.degrees(np.arccos(np.clip((np.trace(r) - 1) / 2, -1, 1)))


def position_covariance(pose, c):
    """Of t under the left perturbation: t moves by tau + omega x t."""
    t = pose["t_m"]
    j = np.hstack([np.array([[0, t[2], -t[1]], [-t[2], 0, t[0]], [t[1], -t[0], 0]]), np.eye(3)])
    return j @ c @ j.T


# ---- Real sets ----


def report(name, result):
    loo, noise = result["leave_one_out"], result["robot_noise"]
    print(f"        {name}: {result['model']}, left out {loo['rms_px'] or np.nan:.3f} px {loo['rms_mm']:.3f} mm {loo['rms_deg']:.4f} deg "
          f"(floor {loo['floor_px'] or np.nan:.2f} px {loo['floor_mm']:.3f} mm {loo['floor_deg']:.4f} deg), robot {noise['mm']:.3f} mm {noise['deg']:.4f} deg, "
          f"sigma of X {result['x']['sigma_mm']:.2f} mm {result['x']['sigma_deg']:.3f} deg, scale {result['scale']:.3f} ± {result['sigma_scale']:.3f}")


def test_real():
    if not DATA:
        skip("the robots' sets are not there (TELEDIMOS_DATA)")
        return
    failed = {"franka_in": {"andreff", "li"}, "franka_to": {"tsai", "horaud", "daniilidis", "li"},
              "kuka_2": {"andreff", "li"}}
    bound = {"franka_in": 5.6, "franka_to": 9.4, "kuka_2": 0.86}
    for name in failed:
        r = job(f"{SOURCE}/tests/data/{name}")
        if not r:
            continue
        report(name, r)
        if SANITIZED:  # whose dlopen does not find ViSP's module
            failed[name].add("visp")
        check({s["name"] for s in r["solvers"] if s["failed"]} == failed[name], f"{name}: marked as failed are {sorted(failed[name])}")
        check(all(s["why"] for s in r["solvers"] if s["failed"]), f"{name}: each with why")
        check(r["best_solver"] not in failed[name], f"{name}: the refinement begins from {r['best_solver']}")
        check(r["leave_one_out"]["rms_px"] <= bound[name], f"{name}: leave-one-out {r['leave_one_out']['rms_px']:.3f} <= {bound[name]} px")
        check(r["verdict"] in ("accepted", "warned"), f"{name}: {r['verdict']} {r['reasons'][:1]}")
        c = np.array(r["covariance"])
        worst = [1e3 * np.sqrt(np.linalg.eigvalsh(position_covariance(r["x"], c[:6, :6]))[-1]), np.degrees(np.sqrt(np.linalg.eigvalsh(c[:3, :3])[-1]))]
        check(c.shape == (12, 12) and np.allclose([r["x"]["sigma_mm"], r["x"]["sigma_deg"]], worst, rtol=1e-6),
              f"{name}: sigma_mm and sigma_deg are the covariance's worst axes")
        check(np.allclose(c, c.T) and np.linalg.eigvalsh(c)[0] > 0, f"{name}: the covariance is one")
        check(r["x"]["name"] == ("base_from_rig" if name == "franka_to" else "hand_from_rig") and "<origin" in r["x"]["urdf"],
              f"{name}: X is {r['x']['name']}, with URDF and ROS lines")


def test_lens():
    """The Franka's camera is given without distortion; 8 boards tell of k1 = 0.064 ± 0.004, 8 tags do not."""
    if not DATA:
        return
    held = job(f"{SOURCE}/tests/data/franka_in")
    taken = job(f"{SOURCE}/tests/data/franka_in", "--intrinsics", "lens")
    tag = job(f"{SOURCE}/tests/data/franka_to", "--intrinsics", "lens")
    if not (held and taken and tag):
        return
    check(any("k1 = 0.064 ± 0.004" in r and "--intrinsics lens" in r for r in held["reasons"]), f"a lens left out is told: {held['reasons'][:2]}")
    check(any("k1 = 0.064" in r and "taken in" in r for r in taken["reasons"]) and "distortion that the views tell of" in taken["cameras"],
          f"and taken in when asked for: {taken['cameras']}")
    check(taken["robot_noise"]["mm"] < 0.7 * held["robot_noise"]["mm"],
          f"the robot is blamed for less: {held['robot_noise']['mm']:.2f} mm, with the lens {taken['robot_noise']['mm']:.2f} mm")
    # 3.4 % with tags searched for in the image as it is, 3.3 % in the logarithm of its light.
    unsure = re.search(r"unsure by ([0-9.]+) %", tag["cameras"])
    check(not any("k1" in r for r in tag["reasons"]) and "held; its lens" in tag["cameras"] and unsure and 3.2 <= float(unsure[1]) <= 3.5,
          f"too little to tell: nothing is taken in, sigma holds it: {tag['cameras']}")
    check("unsure" not in held["cameras"] and "unsure" not in taken["cameras"], "a lens that is told of, or taken in, is not unsure")


def test_wrong_square():
    if not DATA:
        return
    with tempfile.TemporaryDirectory() as folder:
        with open(f"{SOURCE}/tests/data/franka_in/dataset.yaml") as file:
            text = file.read().replace("0.0262", "0.0236")
        with open(f"{folder}/dataset.yaml", "w") as file:
            file.write(text)
        os.symlink(f"{SOURCE}/tests/data/franka_in/frames.csv", f"{folder}/frames.csv")
        r = job(folder, expect=3)
        named = [s for s in (r or {}).get("reasons", []) if "26." in s and "23.6" in s]
        check(bool(named), f"Franka's 23.6 mm squares are refused: {named[:1]}")


def test_stereo():
    """The right camera seen from the left one as from a robot's hand: X is the pair's own relative pose."""
    if not os.path.exists("/usr/share/doc/opencv-doc/examples/data/left01.jpg"):
        skip("OpenCV's pairs are missing (install opencv-doc)")
        return
    with tempfile.TemporaryDirectory() as out:
        run("calibrate", f"{SOURCE}/datasets/opencv-stereo", "-o", out, "--no-models")
        with open(f"{out}/result.yaml") as file:
            right_from_left = matrix(yaml.safe_load(file)["stereo"]["second_from_first"])
    r = job(f"{SOURCE}/datasets/hand-eye-stereo")
    apart = right_from_left @ matrix(r["x"])
    mm, deg = 1e3 * np.linalg.norm(apart[:3, 3]), angle(apart[:3, :3])
    check(mm < 0.25 and deg < 0.08, f"OpenCV's pairs: X is {mm:.3f} mm and {deg:.4f} deg from the stereo pose")
    c = position_covariance(r["x"], np.array(r["covariance"])[:6, :6])
    turned = right_from_left[:3, :3].T @ apart[:3, 3]
    chi2 = turned @ np.linalg.solve(c, turned)
    check(chi2 < 16.3, f"its position's chi-square is {chi2:.1f} of 3 (99.9 %: 16.3); an upper bound, since both use the same images")
    z = matrix(r["z"])
    check(1e3 * np.linalg.norm(z[:3, 3]) < 0.3 and angle(z[:3, :3]) < 0.1, "and Z the identity")


def test_ethz():
    if not DATA:
        return
    r = job(f"{SOURCE}/tests/data/ethz")
    if not r:
        return
    report("ethz", r)
    print(f"        real time offset {1e3 * r['time_offset_s']:.2f} ± {1e3 * r['sigma_time_offset_s']:.2f} ms")
    import zipfile
    shift = 0.137
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(f"{DATA}/ethz-robot-arm/robot_arm_w_color_camera_real.zip") as archive:
            for name in archive.namelist():
                lines = archive.read(name).decode().splitlines()
                moved = "target" in name
                with open(f"{folder}/{'target' if moved else 'robot'}.csv", "w") as file:
                    for line in lines:
                        t, rest = line.split(",", 1)
                        file.write(f"{float(t) - shift:.7f},{rest}\n" if moved else line + "\n")
        with open(f"{folder}/dataset.yaml", "w") as file:
            file.write("name: moved\nsetup: eye-in-hand\nrobot: {poses: robot.csv, convention: ethz}\n"
                       "target_poses: {poses: target.csv, convention: ethz, inverted: true}\n")
        found = job(folder)
        off = found["time_offset_s"] - r["time_offset_s"] - shift
        check(abs(off) < 1e-3, f"a shift of {shift} s of one stream is found again to {1e3 * off:.3f} ms")


# ---- Synthetic motions: what may be confused ----


def poses(count, seed, spread=0.7, axis=None):
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        w = rng.uniform(-spread, spread, 3) if axis is None else axis * rng.uniform(-spread, spread)
        th = np.linalg.norm(w)
        k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / max(th, 1e-12)
        m = np.eye(4)
        m[:3, :3] = np.eye(3) + np.sin(th) * k + (1 - np.cos(th)) * k @ k
        m[:3, 3] = rng.uniform(-0.3, 0.3, 3) + [0.5, 0, 0.6]
        out.append(m)
    return out


def write(folder, robot, target, more="", robot_more=""):
    with open(f"{folder}/dataset.yaml", "w") as file:
        file.write(f"name: made\nsetup: eye-in-hand\nrobot: {{poses: robot.csv{robot_more}}}\ntarget_poses: {{poses: target.csv}}\n{more}")
    for name, rows in (("robot", robot), ("target", target)):
        if isinstance(rows, str):
            text = rows
        else:
            text = "x_m,y_m,z_m,qw,qx,qy,qz\n" + "\n".join(",".join(f"{v:.12g}" for v in [*m[:3, 3], *quaternion(m[:3, :3])]) for m in rows) + "\n"
        with open(f"{folder}/{name}.csv", "w") as file:
            file.write(text)


def made(count=14, seed=1, noise=True, **how):
    """Robot poses and the target's poses in the camera, eye-in-hand."""
    rng = np.random.default_rng(seed + 100)
    x, z = poses(1, seed + 1)[0], poses(1, seed + 2)[0]
    robot = poses(count, seed, **how)
    target = []
    for a in robot:
        b = np.linalg.inv(a @ x) @ z
        if noise:
            b = b.copy()
            b[:3, 3] += rng.normal(0, 3e-4, 3)
        target.append(b)
    return robot, target, x


def refused(title, words, robot, target, expect=3, **how):
    with tempfile.TemporaryDirectory() as folder:
        write(folder, robot, target, **how)
        with tempfile.TemporaryDirectory() as out:
            status, text, errors = run("hand-eye", folder, "-o", out, "--json", "-q")
        said = " ".join(json.loads(text)["reasons"]) if text else errors
        fine = status == expect and any(w in said for w in words)
        if not text:
            fine &= not fault_of_sentence(errors, "hand-eye")
        check(fine, f"{title} (exit {status}): {said[:170].strip()}")


def test_mistakes():
    robot, target, x = made()
    with tempfile.TemporaryDirectory() as folder:
        write(folder, robot, target)
        r = job(folder)
        apart = np.linalg.inv(x) @ matrix(r["x"])
        check(np.linalg.norm(apart[:3, 3]) < 1e-3 and angle(apart[:3, :3]) < 0.1 and not r["mistakes"], "made motions: X is found, no mistake is named")
    refused("inverted robot poses", ["inverted"], [np.linalg.inv(m) for m in robot], target)
    scaled = [m.copy() for m in robot]
    for m in scaled:
        m[:3, 3] *= 1000
    refused("mm for m", [" mm"], scaled, target)
    refused("views in another order", ["order", "shifted", "exchanged", "reversed"], robot[::-1], target)
    refused("one pose missing, the rest shifted", ["shifted", "order"], robot[1:] + robot[:1], target)
    swapped = "x_m,y_m,z_m,qw,qx,qy,qz\n" + "\n".join(
        ",".join(f"{v:.12g}" for v in [*m[:3, 3], *np.roll(quaternion(m[:3, :3]), -1)]) for m in robot) + "\n"
    refused("quaternions in the other order", ["quaternion"], swapped, target)

    def vector(r):
        w = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        s = np.linalg.norm(w)
        return w / max(s, 1e-12) * np.radians(angle(r))
    degrees = "x_m,y_m,z_m,rx_rad,ry_rad,rz_rad\n" + "\n".join(
        ",".join(f"{v:.12g}" for v in [*m[:3, 3], *np.degrees(vector(m[:3, :3]))]) for m in robot) + "\n"
    refused("degrees for radians", ["degree", "radian"], degrees, target)
    refused("two poses", ["3 are the least"], robot[:2], target[:2], expect=1)
    parallel, seen, _ = made(axis=np.array([0.0, 0.0, 1.0]))
    refused("parallel axes", ["parallel"], parallel, seen, expect=1)
    still, same, _ = made(spread=1e-4)
    refused("a hand that does not turn", ["turn", "rotat"], still, same, expect=1)
    bad = "x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,1,0,0,0\nnan,0,0,1,0,0,0\n0,0,0,1,0,0,0\n"
    refused("NaN", ["robot.csv:3"], bad, target[:3], expect=1)
    refused("fewer poses than targets", ["holds 13 poses"], robot[:13], target, expect=1)
    other = [m.copy() for m in target]
    other[5] = other[5] @ poses(1, 77)[0]
    with tempfile.TemporaryDirectory() as folder:
        write(folder, robot, other)
        r = job(folder)
        check(r["outlier_views"] == ["6"], f"one wrong view is left out and named: {r['outlier_views']}")


def test_reversed_corners():
    """The corners of one view numbered from the other end: a half turn of the board."""
    if not os.path.exists("/usr/share/doc/opencv-doc/examples/data/left01.jpg"):
        return
    with tempfile.TemporaryDirectory() as folder:
        run("calibrate", f"{SOURCE}/datasets/opencv-stereo", "-o", f"{folder}/c", "--no-models", "--no-leave-one-out")
        with open(f"{folder}/c/points.csv") as file:
            rows = [row for row in csv.DictReader(line for line in file if not line.startswith("#")) if row["camera"] == "right"]
        for row in rows:
            if row["frame"] == "05":
                row["point"] = str(53 - int(row["point"]))
        with open(f"{folder}/corners.csv", "w", newline="") as file:
            out = csv.DictWriter(file, rows[0].keys())
            out.writeheader()
            out.writerows(rows)
        with open(f"{SOURCE}/datasets/hand-eye-stereo/dataset.yaml") as file:
            text = file.read() + "corners: corners.csv\n"
        with open(f"{folder}/dataset.yaml", "w") as file:
            file.write(text)
        for name in ("frames.csv", "poses.csv"):
            os.symlink(f"{SOURCE}/datasets/hand-eye-stereo/{name}", f"{folder}/{name}")
        r = job(folder)
        check("05" in r["outlier_views"], f"a view with its corners reversed is left out and named: {r['outlier_views']}")
        check(r["leave_one_out"]["rms_px"] < 0.5, f"and does no harm: {r['leave_one_out']['rms_px']:.3f} px")


def test_init_and_threads():
    with tempfile.TemporaryDirectory() as folder:
        status, text, errors = run("hand-eye", f"{folder}/new", "--init", "--setup", "eye-to-hand")
        check(status == 0 and "eye-to-hand" in open(f"{folder}/new/dataset.yaml").read(), "--init writes a dataset to fill in")
        status, text, errors = run("hand-eye", f"{folder}/new", "--init")
        check(status == 2 and "writes nothing over" in errors, "and nothing over one that is there")
        status, text, errors = run("hand-eye", f"{folder}/new", "-o", f"{folder}/out")
        check(status == 1 and not fault_of_sentence(errors, "hand-eye"), f"as it stands it names what is missing: {errors[:120].strip()}")
        robot, target, _ = made()
        write(folder, robot, target)
        same = set()
        for threads in (1, 2, 5):
            run("hand-eye", folder, "-o", f"{folder}/t", "--threads", threads)
            same.add(open(f"{folder}/t/result.yaml").read())
        check(len(same) == 1, "result.yaml: the same bytes with 1, 2 and 5 threads")


test_real()
test_lens()
test_wrong_square()
test_stereo()
test_ethz()
test_mistakes()
test_reversed_corners()
test_init_and_threads()
finish()
