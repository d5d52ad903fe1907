"""teledimos measure: on the rendered trench the volumes are the sums of its true grounds' difference (by GDAL and numpy, to
1e-9), inside a polygon too; the difference, slope and profile that GDAL reads are numpy's; on noisy maps the sigma is what the
noise makes it and a shift is found, or refused; bad maps, polygons and usage end with one sentence and no product. Blind to:
how good a sigma is (tests/recon/test_volume.c)."""

import csv
import json
import os
import subprocess
import tempfile

import numpy as np

from common import PROGRAM, SOURCE, check, finish, refused, run, skip

try:
    from osgeo import gdal
    gdal.UseExceptions()
except ImportError:
    skip("the readers of GDAL are not installed (python3-gdal)")
    finish()


def read(path):
    """Bands by their names, rows to the north, and (x, y) of the first cell's centre, cell."""
    file = gdal.Open(path)
    bands = {}
    for k in range(1, file.RasterCount + 1):
        band = file.GetRasterBand(k)
        bands[band.GetDescription()] = band.ReadAsArray()[::-1].astype(float)
    x, cell, _, y, _, _ = file.GetGeoTransform()
    return bands, x + cell / 2, y - cell * (file.RasterYSize - 0.5), cell


def write(path, height, cell=0.1, x=0.0, y=0.0, crs=None):
    """A foreign map: one band of heights (rows to the north), (x, y) its first cell's centre."""
    file = gdal.GetDriverByName("GTiff").Create(path, height.shape[1], height.shape[0], 1, gdal.GDT_Float64)
    file.SetGeoTransform((x - cell / 2, cell, 0, y + cell * (height.shape[0] - 0.5), 0, -cell))
    if crs:
        from osgeo import osr
        reference = osr.SpatialReference()
        reference.ImportFromEPSG(crs)
        file.SetProjection(reference.ExportToWkt())
    file.GetRasterBand(1).WriteArray(height[::-1])
    file.FlushCache()
    return path


def write_text(path, text):
    with open(path, "w") as file:
        file.write(text)
    return path


def measure(*arguments, expect=0):
    status, text, errors = run("measure", *arguments, "--json")
    check(status == expect and not errors, f"measure {arguments[0]} ends with {status} {errors.strip()}")
    return json.loads(text) if status in (0, 3) else None


def near(a, b, tolerance=1e-9):
    return abs(a - b) <= tolerance * max(abs(a), abs(b), 1e-12)


def noise(seed, shape=(120, 160), width=2, sigma=0.01):
    """Correlated over 2 width cells, of this sigma."""
    white = np.random.default_rng(seed).standard_normal(shape)
    fx, fy = np.meshgrid(np.fft.fftfreq(shape[1]), np.fft.fftfreq(shape[0]))
    smooth = np.fft.ifft2(np.fft.fft2(white) * np.exp(-2 * np.pi**2 * width**2 * (fx**2 + fy**2))).real
    return sigma * smooth / smooth.std()


def test_trench(folder, before, after):
    out = os.path.join(folder, "volume")
    result = measure("volume", before, after, "-o", out)
    (a, x, y, cell), (b, *_) = read(before), read(after)
    d = b["height"] - a["height"]
    volume = result["volume"]
    cut, fill = -d[d < 0].sum() * cell**2, d[d > 0].sum() * cell**2
    check(near(volume["cut_m3"], cut) and near(volume["fill_m3"], fill) and near(volume["net_m3"], d.sum() * cell**2),
          f"trench: cut {volume['cut_m3']:.6f}, fill {volume['fill_m3']:.6f} m3 are numpy's")
    check(volume["rest_m3"] == 0 and volume["sigma_net_m3"] == 0 and volume["cells"] == d.size, "truth has no noise")
    check(sorted(os.listdir(out)) == ["difference.tif", "log.jsonl", "report.html", "result.yaml"], "volume: its products")
    product, px, py, _ = read(os.path.join(out, "difference.tif"))
    check(np.abs(product["height"] - d).max() < 1e-6 and near(px, x) and near(py, y), "difference.tif is after - before")
    check(b"<svg" in open(os.path.join(out, "report.html"), "rb").read(), "the report has plots")
    corners = [(5.513, -1.011), (9.017, -1.213), (9.221, 0.819), (5.611, 0.707)]  # no cell's centre on a side
    polygon = write_text(os.path.join(folder, "polygon.csv"), "x_m,y_m\n" + "".join(f"{u},{v}\n" for u, v in corners))
    gx, gy = np.meshgrid(x + cell * np.arange(d.shape[1]), y + cell * np.arange(d.shape[0]))
    inside = np.ones(d.shape, bool)
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1]):
        inside &= (x1 - x0) * (gy - y0) - (y1 - y0) * (gx - x0) > 0
    volume = measure("volume", before, after, "--polygon", polygon, "-o", out)["volume"]
    check(volume["cells"] == inside.sum() and near(volume["net_m3"], d[inside].sum() * cell**2),
          f"polygon: {volume['cells']} cells, net {volume['net_m3']:.6f} m3 are numpy's")


def test_profile(folder, after):
    out = os.path.join(folder, "profile")
    result = measure("profile", after, "--from", "4,-0.1", "--to", "11,-0.1", "--step", "0.5", "-o", out)
    bands, x, y, cell = read(after)
    rows = list(csv.DictReader(line for line in open(os.path.join(out, "profile.csv")) if not line.startswith("#")))
    r = (-0.1 - y) / cell
    i = int(r)
    line = (1 - r + i) * bands["height"][i] + (r - i) * bands["height"][i + 1]
    expected = np.interp([4 + 0.5 * k for k in range(15)], x + cell * np.arange(line.size), line)
    check(len(rows) == 15 == result["profile"]["known"] and
          np.abs(expected - [float(row["height_m"]) for row in rows]).max() < 1e-5, "profile.csv is numpy's line")
    check(run("measure", "profile", after, "--from", "-30,0", "--to", "11,0", "-o", out)[0] == 0,
          "a line that leaves the map, and begins with a minus")


def test_slope(folder, after):
    out = os.path.join(folder, "slope")
    result = measure("slope", after, "-o", out)
    z, _, _, cell = read(after)
    gy, gx = np.gradient(z["height"], cell)
    slope = read(os.path.join(out, "slope.tif"))[0]["height"]
    check(np.abs(slope - np.arctan(np.hypot(gx, gy))).max() < 1e-5, "slope.tif is numpy's gradient")
    check(near(result["slope"]["steepest_deg"], np.degrees(slope.max()), 1e-6), "degrees in the result")


def test_noise(folder):
    ground = np.fromfunction(lambda r, c: 0.02 * r + 0.3 * np.sin(c / 9), (120, 160))
    change = np.zeros_like(ground)
    change[40:70, 50:100] = -0.3
    before = write(os.path.join(folder, "before.tif"), ground)
    after = write(os.path.join(folder, "after.tif"), ground + change + noise(1))
    shifted = write(os.path.join(folder, "shifted.tif"), ground + change + noise(2) + 0.012)
    out = os.path.join(folder, "noise")
    result = measure("volume", before, after, "-o", out)
    volume = result["volume"]
    check(result["verdict"] == "warned" and volume["scatter"] is None, "maps without a sigma: warned")
    check(0.009 < volume["noise_m"] < 0.011 and 0.3 < volume["correlation_m"] < 0.5,
          f"noise {volume['noise_m']:.4f} m over {volume['correlation_m']:.2f} m (true 0.01, 0.4)")
    sigma = 0.01 * 0.01 * np.sqrt(1500 * np.pi * 4**2)
    check(abs(volume["cut_m3"] - 4.5) < 3 * volume["sigma_cut_m3"] and sigma < volume["sigma_cut_m3"] < 1.6 * sigma,
          f"cut {volume['cut_m3']:.3f} +- {volume['sigma_cut_m3']:.3f} (true 4.5; without margin {sigma:.3f})")
    check(run("measure", "volume", before, shifted, "-o", out)[0] == 3, "a shifted map is refused")
    check(run("measure", "volume", before, shifted, "-o", out, "--accept")[0] == 0, "--accept")
    check(run("measure", "volume", before, shifted, "-o", out, "--gate", "rest_sigmas=1000")[0] == 0, "--gate")
    check(run("measure", "volume", before, shifted, "-o", out, "--common", "0.012")[0] == 0, "--common covers it")
    volume = measure("volume", before, shifted, "--level", "-o", out)["volume"]
    check(abs(volume["shift_m"] - 0.012) < 3 * volume["sigma_shift_m"] < 0.005 and
          abs(volume["cut_m3"] - 4.5) < 3 * volume["sigma_cut_m3"], f"--level finds {1e3 * volume['shift_m']:.2f} mm")
    status, first, _ = run("measure", "volume", before, after, "--json", "-o", out, "--threads", "1")
    check((status, first) == run("measure", "volume", before, after, "--json", "-o", out, "--threads", "2")[:2],
          "the same at any thread count")


def test_bad(folder):
    def bad(what, status, words, *arguments):
        refused(what, status, words, *arguments, command="measure")

    plain = np.zeros((30, 40))
    a = write(os.path.join(folder, "a.tif"), plain)
    far = write(os.path.join(folder, "far.tif"), plain, x=1000)
    zones = [write(os.path.join(folder, f"zone-{zone}.tif"), plain, crs=zone) for zone in (32632, 32633)]
    empty = write(os.path.join(folder, "empty.tif"), plain * np.nan)
    cut_off = os.path.join(folder, "cut-off.tif")
    with open(cut_off, "wb") as file:
        file.write(open(a, "rb").read()[:3000])
    bad("no map", 1, ["none.tif"], "volume", a, os.path.join(folder, "none.tif"))
    bad("half a file", 1, ["cut-off.tif"], "volume", a, cut_off)
    bad("maps apart", 1, ["a.tif", "far.tif", "in common"], "volume", a, far)
    bad("another CRS", 1, ["zone-32632.tif", "EPSG:32632", "EPSG:32633"], "volume", *zones)
    bad("another frame", 1, ["zone-32632.tif", "site"], "volume", a, zones[0])
    bad("nothing but NaN", 1, ["empty.tif"], "volume", a, empty)
    bad("slope of NaN", 1, ["empty.tif"], "slope", empty)
    bad("line elsewhere", 1, ["a.tif", "no height"], "profile", a, "--from", "50,50", "--to", "60,50")
    polygon = os.path.join(folder, "bad.csv")
    for what, text, words in (("NaN corner", "x_m,y_m\n0,0\n1,nan\n1,1\n", ["bad.csv:3", "y_m"]),
                              ("two corners", "x_m,y_m\n0,0\n1,1\n", ["bad.csv", "corners"]),
                              ("no column", "x,y\n0,0\n1,0\n1,1\n", ["bad.csv", "x_m"])):
        bad("polygon: " + what, 1, words, "volume", a, a, "--polygon", write_text(polygon, text))
    bad("polygon elsewhere", 1, ["bad.csv", "holds no cell"], "volume", a, a, "--polygon",
        write_text(polygon, "x_m,y_m\n90,0\n91,0\n91,1\n"))
    bad("no kind", 2, ["volume, profile or slope"], )
    bad("unknown kind", 2, ["colour"], "colour", a)
    bad("one map", 2, ["two maps"], "volume", a)
    bad("two maps", 2, ["one MAP"], "slope", a, a)
    bad("no --to", 2, ["--to"], "profile", a, "--from", "0,0")
    bad("half a point", 2, ["--to 3"], "profile", a, "--from", "0,0", "--to", "3")
    bad("NaN point", 2, ["--from nan,0"], "profile", a, "--from", "nan,0", "--to", "3,3")
    bad("one place", 2, ["same place"], "profile", a, "--from", "1,1", "--to", "1,1")
    bad("--polygon of a slope", 2, ["--polygon", "volume"], "slope", a, "--polygon", polygon)
    bad("--step of a volume", 2, ["--step", "profile"], "volume", a, a, "--step", "1")
    bad("--level and --common", 2, ["--level"], "volume", a, a, "--level", "--common", "1")
    bad("unknown gate", 2, ["colour"], "volume", a, a, "--gate", "colour=1")
    status, _, errors = run("measure", "volume", a, a)
    check(status == 2 and "-o DIR" in errors, "no -o")
    listed = run("measure", "--schema")[1]
    check("volume.sigma_net_m3" in listed, "--schema")


def main():
    with tempfile.TemporaryDirectory() as folder:
        scene = os.path.join(folder, "site")
        done = subprocess.run([PROGRAM, "render", os.path.join(SOURCE, "datasets/site-trench"), "-o", scene, "--frames", "1..1", "-q"])
        check(done.returncode == 0, "the trench is rendered")
        before, after = (os.path.join(scene, "truth", f"ground-{name}.tif") for name in ("before", "after"))
        test_trench(folder, before, after)
        test_profile(folder, after)
        test_slope(folder, after)
        test_noise(folder)
        test_bad(folder)
    finish()


main()
