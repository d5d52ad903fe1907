"""Proves: the files that `teledimos reconstruct` leaves for other tools are what they say, on a rendered frame moved to UTM's coordinates.
map.tif and orthophoto.tif are cloud-optimised GeoTIFFs of one grid and one reference system by GDAL's tools; texels have the colour that
OpenCV's projection of their place into the left image finds there (half of them within 4 of 255; 3 px aside it is many times worse);
map.ply, map.las and map.glb hold the same cells, read here by their formats' descriptions, with the same heights, colours and sigma, and
by readers that are not ours where they are installed (laspy or PDAL, assimp); the reference system comes from --crs or the prior, a
wrong or another one is refused before any work; --texels is obeyed; the figures of --json are in result.yaml and in sane ranges; the
report shows the pictures. A real pair keeps its colours. Blind to: what a viewer makes of it on a screen."""

import json
import os
import re
import shutil
import struct
import subprocess
import tempfile

import cv2
import numpy as np
import yaml

from common import SOURCE, check, fault_of_sentence, finish, run, skip

work = tempfile.mkdtemp()
site, out = f"{work}/site", f"{work}/map"
UTM = np.array([691000, 5334000, 0])
small = ["--near", "3", "--far", "20", "--cell", "0.1"]
installed = shutil.which


def info(path):
    return json.loads(subprocess.run(["gdalinfo", "-json", path], capture_output=True, text=True).stdout)


def raster(path):
    """Bands (rows, columns, bands), the first row in the north, by gdal_translate's plain binary."""
    about = info(path)
    kind = {"Float64": np.float64, "Byte": np.uint8}[about["bands"][0]["type"]]
    subprocess.run(["gdal_translate", "-q", "-of", "ENVI", "-co", "INTERLEAVE=BIP", path, f"{work}/raw"], check=True)
    columns, rows = about["size"]
    return np.fromfile(f"{work}/raw", kind).reshape(rows, columns, -1), about


def test_rasters():
    heights, about = raster(f"{out}/map.tif")
    photo, look = raster(f"{out}/orthophoto.tif")
    for name, what in (("map.tif", about), ("orthophoto.tif", look)):
        check(what["metadata"]["IMAGE_STRUCTURE"].get("LAYOUT") == "COG" and "UTM zone 32N" in what["coordinateSystem"]["wkt"],
              f"{name}: cloud-optimised, in UTM zone 32N")
    check([b["colorInterpretation"] for b in look["bands"]] == ["Red", "Green", "Blue", "Alpha"], "the orthophoto's bands are colours")
    x0, dx, _, y0, _, dy = about["geoTransform"]
    u0, du, _, v0, _, dv = look["geoTransform"]
    offset = np.array([(u0 - x0) / dx, (v0 - y0) / dy])
    check(abs(du * 4 - dx) < 1e-9 and dv == -du and np.allclose(offset, np.round(offset), atol=1e-6), "texels are quarters of the map's cells")
    # Each texel into the left image, by OpenCV.
    rows, columns = np.nonzero(photo[:, :, 3])
    x, y = u0 + (columns + 0.5) * du, v0 + (rows + 0.5) * dv
    z = heights[((y - y0) / dy).astype(int), ((x - x0) / dx).astype(int), 0]
    check(np.isfinite(z).all() and len(z) > 50000, f"{len(z)} texels, all where the map has a height")
    with open(f"{site}/rig.yaml") as file:
        camera = yaml.safe_load(file)["cameras"][0]
    k, d = camera["intrinsics"], camera["distortion"]
    pose = np.genfromtxt(f"{site}/truth/poses.csv", delimiter=",", names=True)
    w, i, j, l = (float(pose[n]) for n in ("qw", "qx", "qy", "qz"))
    turn = np.array([[1 - 2 * (j * j + l * l), 2 * (i * j - w * l), 2 * (i * l + w * j)],
                     [2 * (i * j + w * l), 1 - 2 * (i * i + l * l), 2 * (j * l - w * i)],
                     [2 * (i * l - w * j), 2 * (j * l + w * i), 1 - 2 * (i * i + j * j)]])
    place = np.array([float(pose[n]) for n in ("x_m", "y_m", "z_m")])
    seen = (np.stack([x, y, z], 1) - UTM - place) @ turn
    pixel = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), np.array([[k["fx"], 0, k["cx"]], [0, k["fy"], k["cy"]], [0, 0, 1]]),
                              np.array([d[n] for n in ("k1", "k2", "p1", "p2", "k3")]))[0].reshape(-1, 2).astype(np.float32)
    image = cv2.imread(f"{site}/left/01.png", cv2.IMREAD_GRAYSCALE)

    def difference(aside):
        grid = pixel[:len(pixel) // 512 * 512].reshape(512, -1, 2) + np.float32(aside)  # remap wants no line longer than 32767
        there = cv2.remap(image, grid, None, cv2.INTER_LINEAR).reshape(-1).astype(float)
        return np.median(abs(there - photo[rows, columns, 0][:len(there)]))

    right, wrong = difference(0), difference(3)
    check(right < 4 and wrong > 3 * right, f"texels show what the image has at their place: half within {right:.1f} of 255, {wrong:.1f} aside")
    return heights, about


def read_ply():
    data = open(f"{out}/map.ply", "rb").read()
    head, body = data.split(b"end_header\n", 1)
    count = int(re.search(rb"element vertex (\d+)", head)[1])
    return np.frombuffer(body, [("p", "<f8", 3), ("rgb", "u1", 3), ("sigma", "<f4")], count)


def read_las():
    """By the offsets of the specification (LAS 1.4): points, the text of the reference system."""
    b = open(f"{out}/map.las", "rb").read()
    first, records = struct.unpack_from("<II", b, 96)
    check(b[:4] == b"LASF" and b[24:26] == b"\x01\x04" and b[104] == 7, "LAS 1.4, point format 7")
    at, text = struct.unpack_from("<H", b, 94)[0], {}
    for _ in range(records):
        user, record, size = struct.unpack_from("<2x16sHH", b, at)
        text[user.rstrip(b"\0").decode(), record] = b[at + 54: at + 54 + size]
        at += 54 + size
    check(at == first and text["LASF_Spec", 4][2] == 9 and text["LASF_Spec", 4][4:9] == b"sigma", "sigma is an extra dimension of floats")
    count = struct.unpack_from("<Q", b, 247)[0]
    scale, offset = struct.unpack_from("<3d", b, 131), struct.unpack_from("<3d", b, 155)
    points = np.frombuffer(b, [("q", "<i4", 3), ("skip", "V18"), ("rgb", "<u2", 3), ("sigma", "<f4")], count, first)
    return points["q"] * np.array(scale) + np.array(offset), points, text["LASF_Projection", 2112].decode()


def test_clouds(heights, about):
    ply = read_ply()
    p, las, wkt = read_las()
    check(len(ply) == len(las) == np.isfinite(heights[:, :, 0]).sum(), f"{len(ply)} cells in PLY, LAS and GeoTIFF")
    check(abs(p - ply["p"]).max() < 5.1e-5 and (las["rgb"] == 257 * ply["rgb"].astype(int)).all() and
          np.array_equal(las["sigma"], ply["sigma"], equal_nan=True), "the same places (to 0.05 mm), colours and sigma in both")
    x0, dx, _, y0, _, dy = about["geoTransform"]
    cell = heights[((ply["p"][:, 1] - y0) / dy).astype(int), ((ply["p"][:, 0] - x0) / dx).astype(int)]
    check((cell[:, 0] == ply["p"][:, 2]).all() and (cell[:, 1].astype(np.float32) == ply["sigma"]).all(), "heights and sigma are the GeoTIFF's")
    check("UTM zone 32N" in wkt, "LAS says where on Earth")
    check(np.std(ply["rgb"][:, 0].astype(float)) > 10, "points have colours of their own")
    if installed("pdal"):
        done = subprocess.run(["pdal", "info", "--summary", f"{out}/map.las"], capture_output=True, text=True)
        summary = json.loads(done.stdout)["summary"]
        check(summary["num_points"] == len(ply) and "sigma" in summary["dimensions"], "PDAL reads the LAS")
    else:
        skip("LAS by PDAL: not installed")
    try:
        import laspy
    except ImportError:
        skip("LAS by laspy: not installed")
    else:
        read = laspy.read(f"{out}/map.las")
        check(abs(read.xyz - p).max() < 1e-6 and np.array_equal(np.asarray(read.sigma), las["sigma"]), "laspy reads the LAS")
    return ply


def test_mesh(ply):
    b = open(f"{out}/map.glb", "rb").read()
    magic, version, size, text = struct.unpack_from("<4sIII", b, 0)
    g = json.loads(b[20:20 + text])
    check(magic == b"glTF" and version == 2 and size == len(b), "glTF 2.0, binary")
    start = 28 + text

    def numbers(accessor, kind, width):
        view = g["bufferViews"][g["accessors"][accessor]["bufferView"]]
        return np.frombuffer(b, kind, g["accessors"][accessor]["count"] * width, start + view["byteOffset"]).reshape(-1, width)

    attribute = g["meshes"][0]["primitives"][0]["attributes"]
    q, uv = numbers(attribute["POSITION"], "<f4", 3).astype(float), numbers(attribute["TEXCOORD_0"], "<f4", 2)
    extras = g["nodes"][0]["extras"]
    p = np.stack([q[:, 0], -q[:, 2], q[:, 1]], 1) + extras["origin_m"]
    check(extras["crs"] == "EPSG:32632" and extras["origin_m"][:2] == [691000, 5334000], f"its origin is {extras['origin_m']}")
    key = {(round(v[0] * 10), round(v[1] * 10)): n for n, v in enumerate(ply["p"])}
    match = np.array([key.get((round(v[0] * 10), round(v[1] * 10)), -1) for v in p])
    check((match >= 0).all() and abs(p - ply["p"][match]).max() < 2e-5, f"{len(p)} vertices are cells, to {1e3 * abs(p - ply['p'][match]).max():.4f} mm")
    view = g["bufferViews"][g["images"][0]["bufferView"]]
    jpeg = np.frombuffer(b, np.uint8, view["byteLength"], start + view["byteOffset"])
    texture = cv2.blur(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), (4, 4)).astype(float)
    inside = ((uv > 0.01) & (uv < 0.99)).all(1)
    at = (uv[inside] * [texture.shape[1], texture.shape[0]]).astype(int)
    error = np.median(abs(texture[at[:, 1], at[:, 0], 0] - ply["rgb"][match[inside], 2]))
    check(error < 6, f"the texture is the cells' colours (half within {error:.1f} of 255)")
    if installed("assimp"):
        done = subprocess.run(["assimp", "info", f"{out}/map.glb"], capture_output=True, text=True).stdout
        check(f"[{len(q)} / 0 / {g['accessors'][3]['count'] // 3} | triangle]" in done and "'orthophoto'" in done, "assimp reads the glTF")
    else:
        skip("glTF by assimp: not installed")


def test_result(text):
    result = json.loads(text)
    with open(f"{out}/result.yaml") as file:
        check(yaml.safe_load(file)["products"] == result["products"], "result.yaml lists the products")
    check(all(os.path.getsize(f"{out}/{name}") > 100 or name == "log.jsonl" for name in result["products"].values()), "every product is there")
    m = result["map"]
    check(result["crs"] == "EPSG:32632" and m["share_measured"] == 1 and 0.001 < m["rms_m"] < 0.05,
          f"points lie {1e3 * m['rms_m']:.1f} mm (RMS) from their cells")
    report = open(f"{out}/report.html").read()
    words = ("orthophoto:", "hillshade:", "left image", "right image", "disparities", "sigma (mm)", "standard deviations of the cells", "map.las")
    check(all(word in report for word in words), "the report shows pair, disparities, orthophoto, hillshade, sigma and its histogram")


def test_options():
    code, text, err = run("reconstruct", site, "-o", f"{work}/none", "--texels", "0", "--json", "--prior", f"{out}/map.tif", *small)
    result = json.loads(text)
    check(code == 0 and result["crs"] == "EPSG:32632" and "orthophoto" not in result["products"] and
          not os.path.exists(f"{work}/none/orthophoto.tif"), f"--texels 0: no orthophoto; the prior's reference system is taken over {err[-200:]}")
    subprocess.run(["gdal_translate", "-q", "-b", "1", "-a_nodata", "nan", f"{out}/map.tif", f"{work}/foreign.tif"], check=True)
    subprocess.run(["gdalwarp", "-q", "-t_srs", "EPSG:32632", f"{work}/foreign.tif", f"{work}/plain.tif"], check=True)
    code, text, err = run("reconstruct", site, "-o", f"{work}/onto", "--texels", "1", "--json", "--prior", f"{work}/plain.tif", *small)
    check(code == 0 and json.loads(text)["crs"] == "EPSG:32632", f"a foreign map is a prior of the site {err[-200:]}")
    for extra, status, words in ((["--crs", "EPSG:4326"], 2, "degrees"), (["--crs", "nowhere"], 2, "--crs"), (["--texels", "3"], 2, "--texels"),
                                 (["--crs", "EPSG:32633", "--prior", f"{out}/map.tif"], 1, "EPSG:32633")):
        code, _, err = run("reconstruct", site, "-o", f"{work}/bad", *extra, *small)
        fault = fault_of_sentence(err, "reconstruct")
        check(code == status and words in err and not fault and not os.path.exists(f"{work}/bad/map.tif"), f"{' '.join(extra)}: {err.strip()[-150:]} {fault}")


def test_colour():
    """Debian's colour pair, a quarter of its size: green leaves and a red pot must stay so."""
    images = "/usr/share/doc/opencv-doc/examples/data"
    if not os.path.exists(f"{images}/aloeL.jpg"):
        skip("aloe: opencv-doc has no images here")
        return
    code, _, err = run("reconstruct", f"{SOURCE}/datasets/aloe", "-o", f"{work}/aloe", "--near", "0.55", "--far", "2.2", "--cell", "0.008", "-q")
    photo, _ = raster(f"{work}/aloe/orthophoto.tif")
    seen = photo[photo[:, :, 3] > 0][:, :3].astype(float)
    image = cv2.imread(f"{images}/aloeL.jpg")[:, 200:, ::-1].reshape(-1, 3).astype(float)
    check(code == 0 and abs(seen.mean(0) - image.mean(0)).max() < 25 and np.ptp(seen, axis=1).mean() > 10,
          f"aloe: mean colour {seen.mean(0).round()} of {image.mean(0).round()}")


code, _, err = run("render", f"{SOURCE}/datasets/site-trench", "-o", site, "--frames", "1..1", "-q")
check(code == 0, "a frame is rendered" + err[-200:])
with open(f"{site}/frames.csv") as file:
    head, row = file.read().strip().split("\n")[:2]
cells = row.split(",")
for column, add in (("x_m", UTM[0]), ("y_m", UTM[1])):
    at = head.split(",").index(column)
    cells[at] = str(float(cells[at]) + int(add))
with open(f"{site}/frames.csv", "w") as file:
    file.write(head + "\n" + ",".join(cells) + "\n")
with open(f"{site}/truth/poses.csv") as file:
    lines = file.read().split("\n")[:2]
with open(f"{site}/truth/poses.csv", "w") as file:
    file.write("\n".join(lines) + "\n")
code, text, err = run("reconstruct", site, "-o", out, "--json", "--crs", "EPSG:32632", *small)
check(code == 0, f"reconstruct ends with 0: {err[-200:]}")
test_result(text)
heights, about = test_rasters()
test_mesh(test_clouds(heights, about))
test_options()
test_colour()
shutil.rmtree(work)
finish()
