"""Proves, on the rendered site whose ground is known everywhere (truth/ground-*.tif, truth/poses.csv, read by GDAL's own Python):
- a trench dug between two visits: its volume within 2 % and within 2 sigma of the truth over the same cells; in one fused map it is
  believed after N = 3 frames, and no cell that was not seen again is altered in any bit;
- the machine's arm in view is not in the map, nor is anything else above the ground that is not there: no cell of the whole map stands
  5 sigma above the truth, neither in the arm's reach nor beyond it, before the trench and after. A cell's height is that of its square, so
  the truth is the ground's mean over it; 68 to 78 % of the cells are within one sigma (stones' edges, where sigma is what may be wrong, are
  among them), and more than 55 000 are known;
- a map known before is kept, bit for bit, where nothing is seen;
- frames whose pose is withheld are found: on the map so far (error within 4 sigma in each of x, y, z and below 10 mm), by tags (same),
  and the method and sigma are in the result; one that cannot be is named and left out.
Blind to: real ground, real light, a rig that is not quite what it is said to be (test_real_folders has real images)."""

import csv
import json
import os
import shutil
import subprocess
import tempfile

import cv2
import numpy as np

from common import PROGRAM, SOURCE, check, fault_of_sentence, finish, run, skip

try:
    from osgeo import gdal
    gdal.UseExceptions()
except ImportError:
    skip("the readers of GDAL are not installed (python3-gdal)")
    finish()

work = tempfile.mkdtemp()
site = f"{work}/site"
cell = 0.06
options = ["--near", "3", "--far", "16", "--cell", str(cell)]
pose_columns = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


def read(path):
    """Bands by their names, rows to the north, and (x, y) of the first cell's centre."""
    file = gdal.Open(path)
    bands = {}
    for k in range(1, file.RasterCount + 1):
        band = file.GetRasterBand(k)
        bands[band.GetDescription()] = band.ReadAsArray()[::-1].astype(float)
    x, side, _, y, _, _ = file.GetGeoTransform()
    return bands, x + side / 2, y - side * (file.RasterYSize - 0.5)


def onto(map_, x0, y0, shape):
    """The map's bands on a grid of the same cells: NaN where it has none."""
    bands, x, y = map_
    column, row = round((x - x0) / cell), round((y - y0) / cell)
    out = {}
    for name, band in bands.items():
        wide = np.full((shape[0] + 4000, shape[1] + 4000), np.nan)
        wide[2000 + row:2000 + row + band.shape[0], 2000 + column:2000 + column + band.shape[1]] = band
        out[name] = wide[2000:2000 + shape[0], 2000:2000 + shape[1]]
    return out


def truth_at(name, x, y):
    """Bilinear in the truth, as the ground is drawn."""
    bands, x0, y0 = read(f"{site}/truth/ground-{name}.tif")
    h = bands["height"]
    u, v = np.clip((x - x0) / cell, 0, h.shape[1] - 1.001), np.clip((y - y0) / cell, 0, h.shape[0] - 1.001)
    c, r = u.astype(int), v.astype(int)
    a, b = u - c, v - r
    return (1 - b) * ((1 - a) * h[r, c] + a * h[r, c + 1]) + b * ((1 - a) * h[r + 1, c] + a * h[r + 1, c + 1])


def dataset(name, keep, spoil=None):
    """The site's frames whose names are in `keep`, in a folder of their own."""
    folder = f"{work}/{name}"
    os.mkdir(folder)
    for part in ("left", "right", "robot"):
        os.symlink(f"{site}/{part}", f"{folder}/{part}")
    for part in ("rig.yaml", "dataset.yaml"):
        shutil.copy(f"{site}/{part}", folder)
    rows = list(csv.DictReader(open(f"{site}/frames.csv")))
    with open(f"{folder}/frames.csv", "w", newline="") as file:
        out = csv.DictWriter(file, rows[0].keys())
        out.writeheader()
        for row in rows:
            if row["frame"] in keep:
                if spoil:
                    spoil(row)
                out.writerow(row)
    return folder


def withhold(row, first="01"):
    if row["frame"] != first:
        row.update({column: "" for column in pose_columns})


def reconstruct(name, folder, *more, expect=0):
    code, out, err = run("reconstruct", folder, "-o", f"{work}/map-{name}", "--json", *options, *more)
    check(code == expect, f"{name}: reconstruct ends with {code} {err.strip()[-200:]}")
    return json.loads(out) if code in (0, 3) else {"frames": {"located": [], "failed": []}}


REACH_M = 10.4  # of the stretched arm from the middle of the tracks


def stands(frames):
    """Of the machine."""
    first, last = (int(k) for k in frames.split(".."))
    with open(os.path.join(SOURCE, "datasets/site-trench/frames.csv"), newline="") as file:
        rows = [r for r in csv.DictReader(line for line in file if not line.startswith("#"))]
    return [(float(r["x_m"]), float(r["y_m"])) for r in rows[first - 1:last]]


def test_trench():
    reconstruct("before", dataset("before", ("01", "02", "03")))
    reconstruct("after", dataset("after", ("04", "05", "06")))
    reconstruct("all", dataset("all", ("01", "02", "03", "04", "05", "06")))
    before, after, both = (read(f"{work}/map-{name}/map.tif") for name in ("before", "after", "all"))
    shape, x0, y0 = both[0]["height"].shape, both[1], both[2]
    b, a, all_ = onto(before, x0, y0, shape), onto(after, x0, y0, shape), both[0]
    x, y = np.meshgrid(x0 + cell * np.arange(shape[1]), y0 + cell * np.arange(shape[0]))
    told_b, told_a = truth_at("before", x, y), truth_at("after", x, y)
    # The volume, by the command, over the trench and what lies around it.
    polygon = f"{work}/trench.csv"
    with open(polygon, "w") as file:
        file.write("x_m,y_m\n5.01,-1.21\n9.61,-1.21\n9.61,1.01\n5.01,1.01\n")
    code, out, err = run("measure", "volume", f"{work}/map-before/map.tif", f"{work}/map-after/map.tif", "--polygon", polygon,
                         "-o", f"{work}/volume", "--json")
    volume = json.loads(out)["volume"]
    common = np.isfinite(a["height"]) & np.isfinite(b["height"]) & (x > 5.01) & (x < 9.61) & (y > -1.21) & (y < 1.01)
    cut = (told_b - told_a)[common].sum() * cell**2
    check(code == 0 and volume["cells"] == common.sum(), f"the volume is over the {common.sum()} cells seen in both visits")
    off = volume["cut_m3"] - cut
    check(abs(off) < 0.02 * cut and abs(off) < 2 * volume["sigma_cut_m3"],
          f"trench: {volume['cut_m3']:.4f} +- {volume['sigma_cut_m3']:.4f} m3, true {cut:.4f}: {100 * off / cut:+.2f} %")
    # In one map: believed after three frames, where all three saw the trench; nothing else altered.
    dug = (told_b - told_a > 0.85) & np.isfinite(all_["height"]) & (a["count"] > 20)
    right = np.abs(all_["height"] - told_a)[dug] < 0.05
    check(dug.sum() > 200 and right.mean() > 0.9, f"one map: {100 * right.mean():.1f} % of {dug.sum()} trench cells at the new depth")
    unseen = np.isfinite(b["height"]) & ~np.isfinite(a["height"])
    kept = all_["height"][unseen] == b["height"][unseen]
    gone = np.isnan(all_["height"][unseen])
    check(unseen.sum() > 5000 and (kept | gone).all() and gone.mean() < 0.02,
          f"{unseen.sum()} cells not seen again: {kept.sum()} the same bits, {gone.sum()} looked through and cleared")
    # The arm, and all else.
    offsets = (np.arange(8) + 0.5) / 8 * cell - cell / 2
    for name, map_, frames in (("before", b, "1..3"), ("after", a, "4..6")):
        told = sum(truth_at(name, x + u, y + v) for u in offsets for v in offsets) / 64
        z = (map_["height"] - told) / map_["sigma"]
        near = np.min([np.hypot(x - bx, y - by) for bx, by in stands(frames)], axis=0) < REACH_M
        for where, known in (("in its reach", np.isfinite(z) & near), ("beyond it", np.isfinite(z) & ~near)):
            check(not (z[known] > 5).any(), f"{name}: no cell of the arm, nor other, {where}: {(z[known] > 5).sum()} of {known.sum()} cells are "
                  f"above by 5 sigma, the most by {z[known].max():.1f} sigma")
        known = np.isfinite(z)
        inside = (np.abs(z[known]) <= 1).mean()
        check(0.68 < inside < 0.78 and known.sum() > 55000, f"  {100 * inside:.1f} % of {known.sum()} cells are within one sigma")


def test_prior():
    known, kx, ky = read(f"{site}/truth/ground-before.tif")
    prior_file = f"{work}/prior.tif"
    file = gdal.GetDriverByName("GTiff").Create(prior_file, known["height"].shape[1], known["height"].shape[0], 1, gdal.GDT_Float64)
    file.SetGeoTransform((kx - cell / 2, cell, 0, ky + cell * (known["height"].shape[0] - 0.5), 0, -cell))
    file.GetRasterBand(1).WriteArray(known["height"][::-1])
    file.FlushCache()
    del file
    reconstruct("prior", f"{work}/after", "--prior", prior_file, "--prior-sigma", "0.05", "--region", "4,-4,12,4")
    bands, x0, y0 = read(f"{work}/map-prior/map.tif")
    shape = bands["height"].shape
    prior = onto(read(f"{site}/truth/ground-before.tif"), x0, y0, shape)["height"]
    seen = np.isfinite(onto(read(f"{work}/map-after/map.tif"), x0, y0, shape)["height"])
    kept = bands["provenance"] == 1
    gone = ~seen & np.isnan(bands["height"])
    same = bands["height"] == np.float32(prior)
    check((same & kept | gone)[~seen].all() and (~seen).sum() > 500 and gone.sum() < 0.03 * (~seen).sum(),
          f"{(~seen).sum()} unseen cells keep the map that was known before, {gone.sum()} of them looked through and cleared")
    check((bands["provenance"][seen & ~kept] >= 2).all() and kept[seen].mean() < 0.05, "the others are measured or fused")


def errors_of(result, poses):
    """Largest error of a place over its sigma, largest error, m."""
    worst, far = 0, 0
    for frame in result["frames"]["located"]:
        error = np.array(frame["t_m"]) - poses[frame["name"]]
        z = np.abs(error) / frame["sigma_m"]
        turn = frame["sigma_deg"]
        print(f"  {frame['name']} by {frame['method']}: off by {np.round(1e3 * error, 2)} mm, sigma {np.round(1e3 * np.array(frame['sigma_m']), 2)} mm, "
              f"turn sigma {np.round(np.array(turn) * 60, 2)} arc minutes")
        worst, far = max(worst, z.max()), max(far, np.abs(error).max())
    return worst, far


def places(folder):
    return {row["frame"]: np.array([float(row[c]) for c in pose_columns[:3]]) for row in csv.DictReader(open(f"{folder}/truth/poses.csv"))}


def test_withheld():
    result = reconstruct("held", dataset("held", ("01", "02", "05"), withhold))
    located = result["frames"]["located"]
    check([f["name"] for f in located] == ["02", "05"] and {f["method"] for f in located} == {"map"},
          "two frames without a pose are located on the map, the trench in view of the second")
    worst, far = errors_of(result, places(site))
    check(worst < 4 and far < 0.01, f"located to {1e3 * far:.1f} mm, at most {worst:.1f} sigma")
    lost = reconstruct("lost", dataset("lost", ("01", "02"), lambda row: withhold(row, "02")), expect=3)
    check([f["name"] for f in lost["frames"]["failed"]] == ["01"] and "no frame before it" in lost["frames"]["failed"][0]["reason"],
          "a frame without a pose and none before it is named")
    first = reconstruct("start", dataset("start", ("02",), lambda row: withhold(row, "")), "--prior", f"{work}/prior.tif",
                        "--prior-sigma", "0.01", "--start", "0.4,-0.3,0,3")
    worst, far = errors_of(first, places(site))
    check(len(first["frames"]["located"]) == 1 and worst < 4 and far < 0.02, "located on a known map from --start")


tag_scene = """teledimos: scene 1
name: tagged
rig: rig.yaml
frames: frames.csv
grounds:
  - {name: flat, generate: {columns: 120, rows: 120, cell_m: 0.1, origin_m: [-2, -6], seed: 3, roughness_m: 0.002, scale_m: 6}}
pictures:
  - {name: one, file: tag-3.png, width_m: 0.6, pose: {q: [0.5, -0.5, 0.5, -0.5], t_m: [3.5, 1.1, 1.3]}}
  - {name: two, file: tag-7.png, width_m: 0.6, pose: {q: [0.5, -0.5, 0.5, -0.5], t_m: [3.2, -0.2, 1.2]}}
image: {gain: 1.7}
"""
tag_rig = """teledimos: rig 1
cameras:
  - name: left
    model: pinhole
    width: 640
    height: 480
    intrinsics: {fx: 500, fy: 500, cx: 319.5, cy: 239.5}
    camera_from_rig: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}
  - name: right
    model: pinhole
    width: 640
    height: 480
    intrinsics: {fx: 500, fy: 500, cx: 319.5, cy: 239.5}
    camera_from_rig: {q: [1, 0, 0, 0], t_m: [-0.4, 0, 0]}
vehicle_from_rig: {q: [0.5, -0.5, 0.5, -0.5], t_m: [0, 0, 1.6]}
"""


def test_tags():
    """Pictures of 12 x 12 cells of 0.05 m, a margin of two: the black square is 0.4 m, its centre 0.3 m right of and below the corner."""
    scene = f"{work}/tag-scene"
    os.mkdir(scene)
    dictionary = cv2.aruco.Dictionary_get(cv2.aruco.DICT_APRILTAG_36h11)
    for number in (3, 7):
        cv2.imwrite(f"{scene}/tag-{number}.png", np.pad(cv2.aruco.drawMarker(dictionary, number, 320)[::-1, ::-1], 80, constant_values=255))
    for name, text in (("scene.yaml", tag_scene), ("rig.yaml", tag_rig),
                       ("frames.csv", "frame,time_s,x_m,y_m,z_m,qw,qx,qy,qz\na,0,0,0,0,1,0,0,0\n"
                                      "b,1,0.7,0.3,0.02,0.99875026,0,0,-0.04997917\nc,2,20,0,0,0,0,0,1\n")):
        with open(f"{scene}/{name}", "w") as file:
            file.write(text)
    done = subprocess.run([PROGRAM, "render", scene, "-o", f"{work}/tagged", "-q"], capture_output=True, text=True)
    check(done.returncode == 0, f"the tags are rendered {done.stderr}")
    lines = [",".join(line.split(",")[:4]) for line in open(f"{work}/tagged/frames.csv").read().split()]
    open(f"{work}/tagged/frames.csv", "w").write("\n".join(lines) + "\n")
    def pose(x, y, z):
        return f"{{q: [0.5, -0.5, 0.5, -0.5], t_m: [{x}, {y}, {z}]}}"
    with open(f"{work}/tagged/dataset.yaml", "a") as file:
        file.write("site_tags:\n  sigma_mm: 1\n  sigma_deg: 0.1\n  target: {kind: tags, tags: [\n"
                   f"    {{id: 3, size_m: 0.4, target_from_tag: {pose(3.5, 1.1 - 0.3, 1.3 - 0.3)}}},\n"
                   f"    {{id: 7, size_m: 0.4, target_from_tag: {pose(3.2, -0.2 - 0.3, 1.2 - 0.3)}}}]}}\n")
    result = reconstruct("tagged", f"{work}/tagged", "--near", "2", "--far", "8", expect=3)
    check([(f["name"], f["method"]) for f in result["frames"]["located"]] == [("a", "tags"), ("b", "tags")], "two frames see tags")
    worst, far = errors_of(result, places(f"{work}/tagged"))
    check(worst < 4 and far < 0.03, f"tags: located to {1e3 * far:.1f} mm, at most {worst:.1f} sigma")
    failed = result["frames"]["failed"]
    check([f["name"] for f in failed] == ["c"] and "no tag" in failed[0]["reason"], f"the third sees none: {failed and failed[0]['reason']}")
    text = open(f"{work}/tagged/dataset.yaml").read().replace("t_m: [3.2,", "t_m: [3.4,")
    open(f"{work}/tagged/dataset.yaml", "w").write(text)
    code, _, err = run("reconstruct", f"{work}/tagged", "-o", f"{work}/map-moved", *options)
    check(code == 1 and "of the site lies" in err, f"a tag said to be 0.2 m off is named: {err.strip()[:200]}")


def main():
    done = subprocess.run([PROGRAM, "render", os.path.join(SOURCE, "datasets/site-trench"), "-o", site, "-q"])
    check(done.returncode == 0, "the site is rendered")
    test_trench()
    test_prior()
    test_withheld()
    test_tags()
    shutil.rmtree(work)
    finish()


main()
