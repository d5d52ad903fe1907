"""teledimos match on scenes with truth: rendered ones (site-trench, site-polyhedra; the oracle of match_scenes.py, not the
library's), Middlebury's Aloe and Motorcycle, a calibrated pair of OpenCV's chessboards, a rover whose calibration is stale.

Bounds: matches of a rendered pair >= 95 % within 1 px and RMS of those <= 0.1 px; guided, the true candidate (within 1 px; Aloe's
truth has steps of a pixel: 1.5) first for >= 90 % and in the first three for >= 97 %; error over sigma between 0.85 and 1.25: over
1000 points chance alone stays within 7 %, the rest is what a window's affine warp cannot follow of a rough surface, which the
sigma (of the images' noise) does not know. Points at 3 m within 3 mm RMS; planes and corners in mm, printed.
Blind to: rigs that are a little wrong (the library's tests of the gate), and motion blur."""

import json
import os
import subprocess
import tempfile

import cv2
import numpy as np
import yaml

import common
from common import FULL, IMAGES, OPENCV_SET, SANITIZED, SOURCE, check, finish, run, skip
from match_scenes import (PIXELS, Truth, columns, faces_of, parallel_rig, read_ply, rig_text, rows_of, solids, textured_points,
                          write_points)

common.quick = True
DATA = os.environ.get("TELEDIMOS_DATA", "")
COUNT, GUIDED = 2000, 500


def match(left, right, rig, out, *arguments, expect=0):
    """The result as a dictionary; None (and a failure) when the run ended otherwise than expected."""
    status, text, errors = run("match", left, right, "--rig", rig, "-o", out, "--json", *arguments)
    if status != expect:
        check(False, f"match {left} {' '.join(map(str, arguments))} ended with {status}: {errors.strip()}")
        return None
    return json.loads(text)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def pair(site, frame):
    return f"{site}/left/{frame}.png", f"{site}/right/{frame}.png", f"{site}/rig.yaml"


def render(name, folder, frames):
    out = os.path.join(folder, name)
    status, _, errors = run("render", os.path.join(SOURCE, "datasets", name), "-o", out, "-q", "--frames", frames, timeout=600)
    check(status == 0, f"{name}, frames {frames}, is rendered {errors.strip()}")
    return out


def test_automatic(site, frame, out):
    truth, result = Truth(site, frame), match(*pair(site, frame), out, "--count", COUNT)
    if not result:
        return None
    rows = rows_of(f"{out}/matches.csv")
    matches, sigma = columns(rows, *PIXELS), columns(rows, "sigma_x_px", "sigma_y_px")
    error, smooth = truth.errors(matches)
    off = np.linalg.norm(error, axis=1)
    near = off < 1
    name = f"{os.path.basename(site)} {frame}"
    check(len(rows) == result["matched"] > COUNT / 4 and near.mean() >= 0.95 and rms(off[near]) <= 0.1,
          f"{name}: {len(rows)} matches, {100 * near.mean():.2f} % within 1 px, RMS of those {rms(off[near]):.4f} px, median {np.median(off):.4f}")
    used = near & smooth
    ratio = np.sqrt(np.mean((error[used] / sigma[used])**2, axis=0))
    check(np.all(ratio > 0.85) and np.all(ratio < 1.25), f"  error over sigma, RMS: {ratio[0]:.3f} in x, {ratio[1]:.3f} in y")
    check(result["frame"] == "vehicle" and result["verdict"] == "warned" and result["sigma_m"]["median"] is None and
          result["sigma_m"]["calibration_median"] is None and "calibration sigma unknown" in " ".join(result["reasons"]) and
          all(row["sigma_m"] == row["sigma_calibration_m"] == "" for row in rows),
          "  points in the vehicle's frame; without a covariance of the rig sigma is unknown, and said to be")
    at = columns(rows, "x_m", "y_m", "z_m")
    _, depth, _ = truth.behind(matches[:, :2])
    apart = np.linalg.norm(at - truth.vehicle(truth.points(matches[:, :2], depth)), axis=1)
    ratio = rms(apart[used] / columns(rows, "sigma_matching_m")[used, 0])
    check(0.85 < ratio < 1.25, f"  points in space: {1e3 * np.median(apart[used]):.2f} mm median, error over sigma {ratio:.3f}")
    return truth, depth, apart, used, at


def ranks(out, count, good):
    """Rank of the first candidate for which good(row numbers of the left points, candidates) holds; 0: none."""
    rows = rows_of(f"{out}/candidates.csv")
    right = good([int(row["point"]) - 1 for row in rows], columns(rows, *PIXELS))
    rank = np.zeros(count, int)
    for row, fits in zip(rows, right):
        point = int(row["point"]) - 1
        if fits and not rank[point]:
            rank[point] = int(row["rank"])
    return rank


def show_ranks(name, rank):
    first, three = np.mean(rank == 1), np.mean((rank > 0) & (rank <= 3))
    check(first >= 0.9 and three >= 0.97,
          f"{name}, guided: of {len(rank)} points the true candidate is first for {100 * first:.1f} %, in the first three for {100 * three:.1f} %")


def test_guided(site, frame, folder):
    truth = Truth(site, frame)
    points = textured_points(truth.image, GUIDED, lambda p: truth.seen_in_both(p, 8))
    _, depth, _ = truth.behind(points)
    there, out = truth.right.project(truth.points(points, depth)), os.path.join(folder, "guided")
    result = match(*pair(site, frame), out, "--points", write_points(f"{folder}/points.csv", points), "--count", COUNT)
    if not result:
        return
    show_ranks(os.path.basename(site), ranks(out, GUIDED, lambda i, c: np.linalg.norm(c[:, 2:] - there[i], axis=1) < 1))
    test_choose(site, frame, folder, out)


def test_choose(site, frame, folder, out):
    """The second candidate is picked where there is one, and comes back with its place. (Two in a hundred may lie where their
    rays do not meet before the cameras.)"""
    with open(f"{out}/candidates.csv") as file:
        lines = file.read().splitlines()
    head, several = lines[:2], {line.split(",")[0] for line in lines if line.split(",")[1] == "2"}
    picked, wanted = list(head), []
    for line in lines[2:]:
        cells = line.split(",")
        cells[2] = str(int(cells[1] == ("2" if cells[0] in several else "1")))
        wanted += [cells] if cells[2] == "1" else []
        picked.append(",".join(cells))
    path, back = os.path.join(folder, "picked.csv"), os.path.join(folder, "back")
    with open(path, "w") as file:
        file.write("\n".join(picked) + "\n")
    status, text, errors = run("match", *pair(site, frame)[:2], "--rig", pair(site, frame)[2], "-o", back, "--json", "--choose", path,
                               "--accept", "--count", COUNT)
    if status:
        check(False, f"--choose ended with {status} {errors.strip()}")
        return
    rows = {row["point"]: row for row in rows_of(f"{back}/matches.csv")}
    same = [np.hypot(float(rows[c[0]]["right_x_px"]) - float(c[5]), float(rows[c[0]]["right_y_px"]) - float(c[6])) < 0.02
            for c in wanted if c[0] in rows and c[7]]
    check(len(several) > GUIDED / 4 and len(rows) > 0.9 * len(wanted) and np.mean(same) > 0.97,
          f"--choose: {len(several)} second candidates picked, {len(rows)} of {len(wanted)} back, {100 * np.mean(same):.1f} % to 0.02 px")
    # Two of one point.
    with open(path, "w") as file:
        file.write("\n".join(head + [",".join(["p7", rank, "1", *line.split(",")[3:]]) for rank, line in zip("12", lines[2:])]) + "\n")
    common.refused("two candidates chosen for one point", 1, ["picked.csv:4", "point p7 is chosen twice"], *pair(site, frame)[:2],
                   "--rig", pair(site, frame)[2], "--choose", path, command="match")


def plane(points):
    """Unit normal and distance of the best plane."""
    middle = points.mean(0)
    normal = np.linalg.svd(points - middle)[2][2]
    return normal, normal @ middle


def test_polyhedra(site, found, folder):
    """Frame 01 stands at the site's origin: the vehicle's frame is the site's."""
    truth, depth, apart, used, at = found
    range_m = depth[used]
    near = used & (depth > 2.5) & (depth < 3.5)
    check(rms(apart[near]) < 0.003, f"points from 2.5 to 3.5 m: RMS {1e3 * rms(apart[near]):.2f} mm of {near.sum()} (all, {range_m.min():.1f} to {range_m.max():.1f} m: {1e3 * rms(apart[used]):.2f} mm)")
    bodies = solids(os.path.join(SOURCE, "datasets/site-polyhedra/scene.yaml"))
    face, distance = faces_of(at, bodies)
    for name in sorted(set(face)):
        mine = np.array([f == name for f in face])
        if mine.sum() >= 10:
            check(rms(distance[mine]) < 0.002, f"  {mine.sum()} points of {name[0]}, face {name[1]}: {1e3 * rms(distance[mine]):.2f} mm RMS from the true plane")
    test_corner(at, face, bodies)
    out = os.path.join(folder, "tin")
    result = match(*pair(site, "01"), out, "--count", 80)
    points, triangles = read_ply(f"{out}/points.ply")
    face, distance = faces_of(points, bodies)
    flat = [t for t in triangles if all(face[i] == ("ground", 0) for i in t)]
    # Within a triangle on the plane the surface is off by what its corners say, linearly: theirs are the largest.
    worst, offs = max(np.abs(distance[t]).max() for t in flat), [distance[list(t)].mean() for t in flat]
    check(20 <= result["matched"] == len(points) <= 50 and rms(distance) < 0.002 and worst < 0.006,
          f"TIN from {len(points)} automatic points, {len(triangles)} triangles: points {1e3 * rms(distance):.2f} mm RMS from their planes; "
          f"{len(flat)} triangles on the ground, {1e3 * rms(offs):.2f} mm RMS off, {1e3 * worst:.2f} mm at worst")
    normal = plane(points[[f == ("ground", 0) for f in face]])[0]
    check(np.degrees(np.arccos(abs(normal[2]))) < 0.1, f"  the ground's plane is {np.degrees(np.arccos(abs(normal[2]))):.3f} degrees off")


def test_corner(at, face, bodies):
    """A corner is where three planes meet, each fitted to the automatic points of a face: the post's at the top and the crate's foot."""
    def fitted(name):
        return plane(at[[f == name for f in face]])

    def true(name):
        if name[0] == "ground":
            return np.array([0, 0, 1.0]), 0.0
        turn, place, faces = bodies[name[0]]
        normal, height = faces[name[1]]
        return turn @ normal, height + turn @ normal @ place

    def meet(planes):
        return np.linalg.solve([n for n, _ in planes], [d for _, d in planes])

    def line(planes):
        """A point and the direction of two planes' edge."""
        along = np.cross(planes[0][0], planes[1][0])
        along /= np.linalg.norm(along)
        return meet([*planes, (along, 0.0)]), along

    top = [("post", 1), ("post", 2), ("post", 4)]
    seen = [face.count(name) for name in top]
    error = np.linalg.norm(meet([fitted(n) for n in top]) - meet([true(n) for n in top]))
    check(error < 0.005, f"the post's upper corner, from planes of {seen} points: {1e3 * error:.2f} mm off")
    for edge in ([("crate", 1), ("crate", 4)], [("crate", 1), ("ground", 0)], [("ramp", 3), ("ground", 0)]):
        point, along = line([fitted(n) for n in edge])
        turn, place, faces = bodies[edge[0][0]]
        sides = [i for i, (n, _) in enumerate(faces) if abs((turn @ n) @ line([true(e) for e in edge])[1]) > 0.99]
        corners = [meet([*(true(e) for e in edge), true((edge[0][0], side))]) for side in sides]
        offs = [np.linalg.norm(np.cross(c - point, along)) for c in corners]
        check(len(offs) == 2 and max(offs) < 0.005, f"corners at the edge of {edge[0]} and {edge[1]}: {1e3 * offs[0]:.2f} and {1e3 * offs[1]:.2f} mm from the planes' edge")


def test_cameras(site, folder):
    """Left and right of the pair are what --cameras says: the points stay where they are."""
    left, right, rig = pair(site, "01")
    one = match(left, right, rig, f"{folder}/one", "--count", 200)
    other = match(right, left, rig, f"{folder}/other", "--cameras", "right,left", "--count", 200)
    if one and other:
        a, b = (columns(rows_of(f"{folder}/{name}/matches.csv"), "x_m", "y_m", "z_m") for name in ("one", "other"))
        apart = np.array([np.linalg.norm(a - p, axis=1).min() for p in b])
        check(other["cameras"] == ["right", "left"] and np.mean(apart < 0.004) > 0.2,
              f"--cameras right,left: {np.mean(apart < 0.004) * 100:.0f} % of the points are also among those of left,right")


def test_aloe(folder):
    paths = [f"{IMAGES}/aloe{name}" for name in ("L.jpg", "R.jpg", "GT.png")]
    if not all(map(os.path.isfile, paths)):
        skip("Aloe: opencv-doc is not installed")
        return
    image, gold = (cv2.imread(p, cv2.IMREAD_GRAYSCALE) for p in (paths[0], paths[2]))
    disparity = gold.astype(float)
    rig = os.path.join(folder, "aloe.yaml")
    with open(rig, "w") as file:
        file.write(parallel_rig(1282, 1110, 3740, 640, 640, 555, 0.16))

    def good(points, half=7, range_px=6):
        """Truth is known and of one surface around; nothing nearer lands on the same right pixel."""
        i, j = np.rint(points[:, 0]).astype(int), np.rint(points[:, 1]).astype(int)
        near = np.stack([disparity[j + v, i + u] for v in range(-half, half + 1) for u in range(-half, half + 1)], 1)
        there = np.arange(1282) - disparity[j]
        hidden = np.any((disparity[j] > disparity[j, i][:, None] + 1) & (np.abs(there - (i - disparity[j, i])[:, None]) <= 1), axis=1)
        return (near.min(1) > 0) & (np.ptp(near, axis=1) <= range_px) & (i - disparity[j, i] > 8) & ~hidden

    def ranked(points):
        true, out = disparity[np.rint(points[:, 1]).astype(int), np.rint(points[:, 0]).astype(int)], f"{folder}/aloe"
        if match(*paths[:2], rig, out, "--points", write_points(f"{folder}/aloe.csv", points), *near):
            return ranks(out, GUIDED, lambda i, c: np.abs(c[:, 0] - c[:, 2] - true[i]) <= 1.5)
        return np.zeros(GUIDED)

    near = ("--near", 3740 * 0.16 / 240, "--count", COUNT)
    show_ranks("Aloe", ranked(textured_points(image, GUIDED, good)))
    # A window over an edge of depth belongs to two surfaces, and the nearer one mostly wins: known, and bounded.
    rank = ranked(textured_points(image, GUIDED, lambda p: good(p, 2, 2)))
    check(np.mean(rank == 1) > 0.85, f"  with edges of depth as near as 2 px: first for {100 * np.mean(rank == 1):.1f} %, in the first three for {100 * np.mean((rank > 0) & (rank < 4)):.1f} %")
    if match(*paths[:2], rig, f"{folder}/aloe-auto", *near):
        found = columns(rows_of(f"{folder}/aloe-auto/matches.csv"), *PIXELS)
        true = disparity[np.rint(found[:, 1]).astype(int), np.rint(found[:, 0]).astype(int)]
        off = np.abs(found[:, 0] - found[:, 2] - true)[true > 0]
        check(len(off) > COUNT / 8 and np.mean(off <= 1.5) >= 0.95, f"Aloe, automatic: {100 * np.mean(off <= 1.5):.2f} % of {len(off)} matches within 1.5 px of its truth")


def test_motorcycle(folder):
    place = os.path.join(DATA, "middlebury-Motorcycle")
    if not DATA or not os.path.isdir(place):
        skip("Motorcycle: no data")
        return
    rig = os.path.join(folder, "motorcycle.yaml")
    with open(rig, "w") as file:
        file.write(parallel_rig(741, 500, 994.978, 311.193, 311.193 + 31.086, 254.877, 0.193001))
    out = os.path.join(folder, "motorcycle")
    if not match(f"{place}/motorcycle_left.png", f"{place}/motorcycle_right.png", rig, out, "--count", COUNT):
        return
    rows = rows_of(f"{out}/matches.csv")
    left, depth, sigma = columns(rows, *PIXELS), columns(rows, "x_m")[:, 0], columns(rows, "sigma_matching_m")[:, 0]
    with np.load(f"{place}/motorcycle_disp.npz") as file:
        gold = file["arr_0"]
    i, j = np.floor(left[:, 0]).astype(int), np.floor(left[:, 1]).astype(int)
    a, b = left[:, 0] - i, left[:, 1] - j
    around = np.stack([gold[j, i], gold[j, i + 1], gold[j + 1, i], gold[j + 1, i + 1]], 1)
    known = np.isfinite(around).all(1) & (around.max(1) < around.min(1) + 1)
    weight = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], 1)
    true = 994.978 * 0.193001 / ((weight * around).sum(1) + 31.086)
    error, pixels = (depth - true)[known], (left[:, 0] - left[:, 2] - (weight * around).sum(1))[known]
    good = np.abs(pixels) < 1
    # Truth itself is good to about 0.2 px; at 3 m a pixel is 47 mm.
    check(known.sum() > len(rows) / 2 and good.mean() >= 0.95 and np.median(np.abs(error)) < 0.01 and rms(error[good]) < 0.025,
          f"Motorcycle: depths of {known.sum()} matches from {true[known].min():.1f} to {true[known].max():.1f} m: median error {1e3 * np.median(np.abs(error)):.1f} mm, "
          f"{100 * good.mean():.1f} % within 1 px, RMS of those {1e3 * rms(error[good]):.1f} mm ({rms(pixels[good]):.3f} px); median sigma {1e3 * np.median(sigma[known]):.1f} mm")


def tsai(path):
    values = {}
    with open(path) as file:
        for line in file:
            if "=" in line:
                key, text = line.split("=")
                values[key.strip()] = np.array([float(v) for v in text.split()])
    return values


def quaternion(r):
    w = np.sqrt(1 + np.trace(r)) / 2
    q = np.array([w, *(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w))])
    return q / np.linalg.norm(q)


def test_stale(folder):
    """K10's cameras have turned since they were calibrated."""
    place = os.path.join(DATA, "k10")
    if not DATA or not os.path.isdir(place):
        skip("k10: no data")
        return
    left, right = (tsai(f"{place}/black_{side}.tsai") for side in ("left", "right"))
    world = [v["R"].reshape(3, 3) for v in (left, right)]
    poses = [([1, 0, 0, 0], [0, 0, 0]), (quaternion(world[1].T @ world[0]), world[1].T @ (left["C"] - right["C"]))]
    rig, out = os.path.join(folder, "k10.yaml"), os.path.join(folder, "k10")
    with open(rig, "w") as file:
        file.write(rig_text([(name, 1024, 768, [v[k][0] for k in ("fu", "fv", "cu", "cv")], [v[k][0] for k in ("k1", "k2", "p1", "p2")] + [0.0], *pose)
                             for name, v, pose in zip(("left", "right"), (left, right), poses)]))
    images = f"{place}/left4.png", f"{place}/right4.png"
    result = match(*images, rig, out, "--count", COUNT, expect=3)
    if not result:
        return
    e = result["epipolar"]
    check(result["verdict"] == "refused" and e["rms_px"] > 0.6 and abs(e["median_px"]) > 0.4 and e["corrected_px"] < 0.7 * e["rms_px"] and
          "px from their epipolar curves" in result["reasons"][0] and "rig-corrected.yaml" in result["reasons"][0],
          f"k10 is refused: {result['reasons'][0]}")
    check(result["products"].get("rig") == "rig-corrected.yaml", "  the turned rig is there")
    fits = match(*images, f"{out}/rig-corrected.yaml", f"{folder}/k10-after", "--count", COUNT, "--accept")
    again = match(*images, rig, f"{folder}/k10-correct", "--count", COUNT, "--correct", "--accept")
    if fits and again:
        check(fits["epipolar"]["rms_px"] < 0.7 * e["rms_px"] and fits["matched"] >= result["matched"],
              f"  with it {fits['matched']} points match instead of {result['matched']}, {fits['epipolar']['rms_px']:.3f} px from their curves")
        check(again["epipolar"]["applied"] and again["matched"] == fits["matched"] and
              abs(again["epipolar"]["corrected_px"] - fits["epipolar"]["rms_px"]) < 1e-9, "  --correct does the same at once")


def test_turned(site, folder):
    """The right camera nods by 0.2 degrees, 8 px: further than the band around the epipolar curves."""
    left, right, rig = pair(site, "01")
    with open(rig) as file:
        described = yaml.safe_load(file)
    pose = described["cameras"][1]["camera_from_rig"]
    w, x, y, z = pose["q"]
    a, b = np.cos(np.radians(0.1)), np.sin(np.radians(0.1))
    q = np.array([a * w - b * x, a * x + b * w, a * y - b * z, a * z + b * y])
    pose["q"] = (q / np.linalg.norm(q)).tolist()
    turned = os.path.join(folder, "turned.yaml")
    with open(turned, "w") as file:
        yaml.safe_dump(described, file)
    result = match(left, right, turned, f"{folder}/turned", "--count", 500, expect=3)
    again = match(left, right, turned, f"{folder}/corrected", "--count", 500, "--correct")
    if result and again:
        e, f = result["epipolar"], again["epipolar"]
        check(abs(e["rms_px"] - 8.35) < 0.2 and abs(e["rotation_deg"][0] + 0.2) < 0.002 and f["corrected_px"] < 0.1 and again["verdict"] == "warned",
              f"a camera turned by 0.2 degrees: refused at {e['rms_px']:.2f} px, found to be {e['rotation_deg'][0]:.4f}; --correct brings {f['corrected_px']:.3f} px, {again['matched']} points")


def test_calibrated(folder):
    """A rig with its covariance: the chessboard of one of its pairs, its corners found by OpenCV, given by --choose."""
    if not os.path.isdir(IMAGES):
        skip("opencv-doc is not installed")
        return
    if not common.calibrate(OPENCV_SET, out=f"{folder}/calibrated"):
        return
    images, rig, out = [f"{IMAGES}/{side}01.jpg" for side in ("left", "right")], f"{folder}/calibrated/rig.yaml", f"{folder}/board"
    corners = []
    for path in images:
        grey = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
        _, found = cv2.findChessboardCorners(grey, (9, 6))
        corners.append(cv2.cornerSubPix(grey, found, (5, 5), (-1, -1), (3, 50, 1e-4)).reshape(-1, 2))
    with open(f"{folder}/corners.csv", "w") as file:
        file.write("point," + ",".join(PIXELS) + "\n" + "".join(f"c{i},{a[0]},{a[1]},{b[0]},{b[1]}\n" for i, (a, b) in enumerate(zip(*corners))))
    result = match(*images, rig, out, "--choose", f"{folder}/corners.csv", "--count", COUNT)
    if not result:
        return
    rows = rows_of(f"{out}/matches.csv")
    at, parts = columns(rows, "x_m", "y_m", "z_m").reshape(6, 9, 3), columns(rows, "sigma_m", "sigma_matching_m", "sigma_calibration_m")
    steps = np.linalg.norm(np.diff(at, axis=1), axis=2)
    normal, distance = plane(at.reshape(-1, 3))
    check(len(rows) == 54 and abs(steps.mean() - 0.025) < 0.0002 and rms(at.reshape(-1, 3) @ normal - distance) < 0.001,
          f"a calibrated pair: 54 chosen corners, squares of {1e3 * steps.mean():.3f} mm (25), {1e3 * rms(steps - steps.mean()):.3f} mm RMS, "
          f"{1e3 * rms(at.reshape(-1, 3) @ normal - distance):.2f} mm RMS from a plane")
    s = result["sigma_m"]
    check(np.isfinite(parts).all() and (parts > 0).all() and (parts[:, 0] <= np.hypot(parts[:, 1], parts[:, 2]) + 2e-5).all() and
          (parts[:, 0] >= parts[:, 1:].max(1) - 2e-5).all() and s["calibration_median"] > 0 and "unknown" not in " ".join(result["reasons"]),
          f"  sigma {1e3 * s['median']:.2f} mm: matching {1e3 * s['matching_median']:.2f}, calibration {1e3 * s['calibration_median']:.2f}")


with tempfile.TemporaryDirectory() as place:
    polyhedra = render("site-polyhedra", place, "1..3" if FULL else "1..1")
    trench = render("site-trench", place, "1..6" if FULL else "4..4")
    seen = test_automatic(polyhedra, "01", f"{place}/auto-polyhedra")
    if seen:
        test_polyhedra(polyhedra, seen, place)
    for name in ("01", "02", "03", "04", "05", "06") if FULL else ("04",):
        test_automatic(trench, name, f"{place}/auto-trench-{name}")
    test_guided(trench, "04", place)
    test_cameras(polyhedra, place)
    test_turned(polyhedra, place)
    if not SANITIZED:  # minutes, and the same code
        test_aloe(place)
        test_motorcycle(place)
        test_stale(place)
    test_calibrated(place)
    finish()
