"""teledimos match on what it cannot match: swapped images, images of another size, no texture, a texture that repeats, points
outside, hostile tables, a folder that cannot be written, an interruption. Each ends in one sentence that names it with the right
exit status and nothing partial, or the result says that it is not to be trusted. The same input gives the same bytes at any
thread count; the result follows its schema. Images are made by numpy for a pair without distortion (a plane at 2 m: the right
image is the left one moved by 20 px), or rendered (site-polyhedra)."""

import json
import os
import signal
import subprocess
import tempfile
import time

import cv2
import numpy as np

from common import PROGRAM, SANITIZED, SOURCE, check, fault_of_sentence, finish, refused, run
from match_scenes import PIXELS, columns, parallel_rig, rows_of

WIDTH, HEIGHT, SHIFT = 320, 240, 20  # f 200 px, baseline 0.2 m: 20 px are 2 m


def write(path, text):
    with open(path, "w") as file:
        file.write(text)
    return path


def images(folder, name, wide):
    """Left and right of a picture that is wider than both."""
    paths = [os.path.join(folder, f"{name}-{side}.png") for side in ("left", "right")]
    for path, at in zip(paths, (0, SHIFT)):
        cv2.imwrite(path, wide[:, at:at + WIDTH].astype(np.uint8))
    return paths


def grain(seed=0):
    noise = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH + SHIFT))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.clip(128 + 40 * smooth / smooth.std(), 0, 255)


def job(pair, rig, out, *arguments):
    status, text, errors = run("match", *pair, "--rig", rig, "-o", out, "--json", *arguments)
    return status, json.loads(text) if text else {}, errors


def everything(folder):
    """All products but the log, which holds times."""
    found = {}
    for name in os.listdir(folder):
        if name != "log.jsonl":
            with open(os.path.join(folder, name), "rb") as file:
                found[name] = file.read()
    return found


def test_plane(pair, rig, folder):
    status, result, errors = job(pair, rig, f"{folder}/plane")
    rows = rows_of(f"{folder}/plane/matches.csv")
    apart = columns(rows, *PIXELS) @ [[1, 0], [0, 1], [-1, 0], [0, -1]] - [SHIFT, 0]
    depth = columns(rows, "x_m")[:, 0]
    check(status == 0 and len(rows) > 50 and np.abs(apart).max() < 0.05 and np.abs(depth - 2).max() < 0.01,
          f"a plane at 2 m: {len(rows)} matches, at most {np.abs(apart).max():.4f} px and {1e3 * np.abs(depth - 2).max():.2f} mm off {errors.strip()}")
    check(result["frame"] == "rig" and abs(result["depth_m"][0] - 2) < 0.01, "a rig that does not know its vehicle: frame rig, x forward")


def test_schema(pair, rig, folder):
    status, text, _ = run("match", "--schema")
    keys = {line.split()[0] for line in text.splitlines() if line.strip()}
    result = job(pair, rig, f"{folder}/keys")[1]

    def flat(value, prefix=""):
        for key, inner in value.items():
            yield prefix + key
            if isinstance(inner, dict):
                yield from flat(inner, prefix + key + ".")

    unknown = [key for key in flat(result) if key not in keys and key.rsplit(".", 1)[0] + ".*" not in keys]
    check(status == 0 and not unknown and {"verdict", "reasons", "sigma_m.median", "epipolar.rms_px"} <= keys, f"every key is in --schema {unknown}")
    products = set(result["products"].values())
    check(products == set(os.listdir(f"{folder}/keys")), f"products are what is in the folder: {sorted(products)}")


def test_threads(pair, rig, folder):
    points = write(f"{folder}/three.csv", 'point,x_px,y_px\n"a, ""b""",100,100\n"#2",150,120\n,200.25,80.5\n')
    for name, arguments in (("automatic", ()), ("guided", ("--points", points))):
        for threads in (1, 2):
            job(pair, rig, f"{folder}/{name}{threads}", *arguments, "--threads", threads)
        one, two = (everything(f"{folder}/{name}{threads}") for threads in (1, 2))
        check(len(one) > 4 and one == two, f"{name}: the same {len(one)} files at one thread and at two")
    rows = rows_of(f"{folder}/guided1/matches.csv")
    check([row["point"] for row in rows] == ['a, "b"', "#2", "3"], f"names with commas and quotes come back: {[row['point'] for row in rows]}")


def test_images(pair, rig, folder):
    big = f"{folder}/big.png"
    cv2.imwrite(big, np.zeros((HEIGHT, WIDTH + 1), np.uint8))
    refused("another size than the rig's", 1, ["big.png", "321 x 240", "camera left", "320 x 240"], big, pair[1], "--rig", rig, command="match")
    refused("the right one too", 1, ["big.png", "camera right"], pair[0], big, "--rig", rig, command="match")
    refused("left and right swapped", 1, ["only the other way round", "camera left first"], pair[1], pair[0], "--rig", rig, "-q", command="match")
    refused("no image", 1, ["rig-in.yaml"], write(f"{folder}/rig-in.yaml", "no image"), pair[1], "--rig", rig, command="match")
    refused("not there", 1, ["none.png"], f"{folder}/none.png", pair[1], "--rig", rig, command="match")
    refused("no rig", 2, ["--rig RIG is missing"], *pair, command="match")
    refused("a rig of one camera", 1, ["one.yaml", "one camera"], *pair, "--rig",
            write(f"{folder}/one.yaml", open(rig).read().split("  - name: right")[0]), command="match")
    refused("an unknown camera", 1, ["no camera middle"], *pair, "--rig", rig, "--cameras", "left,middle", command="match")
    refused("a camera twice", 2, ["left"], *pair, "--rig", rig, "--cameras", "left,left", command="match")
    refused("both --points and --choose", 2, ["--points and --choose"], *pair, "--rig", rig, "--points", rig, "--choose", rig, command="match")
    refused("an unknown gate", 2, ["colour"], *pair, "--rig", rig, "--gate", "colour=3", command="match")


def test_without_texture(rig, folder):
    point = write(f"{folder}/point.csv", "x_px,y_px\n160,120\n")
    for name, wide in (("plain", np.full((HEIGHT, WIDTH + SHIFT), 128)), ("steps in one direction", np.repeat(grain()[:, :1], WIDTH + SHIFT, 1))):
        pair = images(folder, "flat", wide)
        for mode, arguments in (("automatic", ()), ("guided", ("--points", point))):
            out = f"{folder}/{name}-{mode}"
            status, result, errors = job(pair, rig, out, *arguments, "-q")
            reasons = " ".join(result.get("reasons", []))
            sure = result.get("matched") and result["sigma_m"]["matching_median"] is not None
            named = "no point was matched" in reasons if not result.get("matched") else "without sigma" in reasons or "another place" in reasons
            check(status == (0 if result.get("matched") else 3) and not sure and named and "too few automatic matches" in reasons and not errors,
                  f"{name}, {mode}: status {status}, {reasons[:150]}")
            left = sorted(os.listdir(out))
            check(result["matched"] or not {"matches.csv", "points.ply", "map.tif"} & set(left), f"  products: {left}")


def test_repeated(rig, folder):
    x, y = np.meshgrid(np.arange(WIDTH + SHIFT), np.arange(HEIGHT))
    pair = images(folder, "again", 128 + 50 * np.sin(2 * np.pi * x / 10) * np.sin(2 * np.pi * y / 12))
    status, result, _ = job(pair, rig, f"{folder}/again", "-q")
    tally = result["tally"]
    check(status == 3 and result["matched"] == 0 and tally["ambiguous"] + tally["unseen"] >= 0.9 * tally["left_points"] > 50,
          f"a texture that repeats, automatic: refused; {tally['ambiguous']} of {tally['left_points']} points ambiguous")
    points = write(f"{folder}/again.csv", "x_px,y_px\n" + "".join(f"{x},{y}\n" for x in range(110, 300, 20) for y in range(20, 220, 20)))
    status, result, _ = job(pair, rig, f"{folder}/again-guided", "--points", points, "-q")
    ranks = [row["rank"] for row in rows_of(f"{folder}/again-guided/candidates.csv")]
    check(status == 0 and result["ambiguous"] >= 0.95 * result["points"] and "nearly as well" in " ".join(result["reasons"]) and ranks.count("2") >= 95,
          f"  guided: {result['ambiguous']} of {result['points']} points are said to be ambiguous")


def test_tables(pair, rig, folder):
    def points(what, text, *words, status=1, option="--points"):
        path = f"{folder}/table.csv"
        with open(path, "wb") as file:
            file.write(text if isinstance(text, bytes) else text.encode())
        refused(what, status, ["table.csv", *words], *pair, "--rig", rig, option, path, "--count", 50, command="match")

    points("a point outside", "x_px,y_px\n100,100\n320,50\n", ":3: column x_px", "320 is outside the image", "0 to 319")
    points("a negative one", "x_px,y_px\n100,-1\n", ":2: column y_px", "outside")
    points("a point at the edge", "x_px,y_px\n100,3\n", ":2: column y_px", "window's 7 px")
    points("NaN", "x_px,y_px\nnan,3\n", ":2: column x_px")
    points("a huge number", "x_px,y_px\n1e300,3\n", ":2: column x_px")
    points("a word", "x_px,y_px\nhere,3\n", ":2: column x_px", "here")
    points("other columns", "u,v\n1,2\n", "no column x_px")
    points("no rows", "x_px,y_px\n", "0 points")
    points("nothing at all", "")
    points("no text", bytes(range(256)))
    points("a name twice", "point,x_px,y_px\np,100,100\nq,90,90\np,110,110\n", ":4: column point", "point p is given twice")
    points("a name of two lines", 'point,x_px,y_px\n"p\nq",100,100\n', "line end")
    points("a long name", f"point,x_px,y_px\n{'p' * 64},100,100\n", "at most 63 characters")
    points("a million rows", "x_px,y_px\n" + "100,100\n" * 1000000, "1000000 points", "100000")
    head = ",".join(PIXELS) + "\n"
    points("no choice", "point,chosen," + head + "1,0,100,100,80,100\n", "no row is chosen", option="--choose")
    points("a choice of 2", "point,chosen," + head + "1,2,100,100,80,100\n", ":2: column chosen", option="--choose")
    points("a choice outside the right image", head + "100,100,80,240\n", ":2: column right_y_px", "outside", option="--choose")
    points("a choice without pixels", "point,chosen\n1,1\n", "left_x_px", option="--choose")
    points("100000 choices of one point", "point," + head + "p,100,100,80,100\n" * 100000, ":3:", "chosen twice", option="--choose")


def test_far_choice(pair, rig, folder):
    """A pick whose rays part is no point, one that no window supports has no sigma."""
    head = "point," + ",".join(PIXELS) + "\n"
    path = write(f"{folder}/far.csv", head + "good,100,100,80,100\nbehind,100,60,140,60\n")
    status, result, _ = job(pair, rig, f"{folder}/far", "--choose", path, "-q")
    rows = rows_of(f"{folder}/far/matches.csv")
    check(status == 0 and [row["point"] for row in rows] == ["good"] and "1 of 2 points have no place in space" in " ".join(result["reasons"]),
          f"a pick behind the cameras is left out, and said so: {result['reasons'][0]}")
    plain = images(folder, "plain", np.full((HEIGHT, WIDTH + SHIFT), 128))
    path = write(f"{folder}/plain.csv", head + "a,100,100,80,100\nb,200,100,180,100\nc,150,200,130,200\n")
    status, result, _ = job(plain, rig, f"{folder}/plain", "--choose", path, "-q")
    rows = rows_of(f"{folder}/plain/matches.csv")
    check(status == 0 and len(rows) == 3 and all(row["sigma_matching_m"] == "" for row in rows) and "3 of 3 matches are without sigma" in " ".join(result["reasons"])
          and abs(float(rows[0]["x_m"]) - 2) < 1e-6, f"picks without texture: places without sigma, and said so")


def test_places(pair, rig, folder):
    file = write(f"{folder}/file", "")
    for out in (file, f"{file}/below", "/proc/none"):
        refused(f"-o {os.path.basename(out)}", 1, [file if out.startswith(file) else out], *pair, "--rig", rig, "--count", 50, command="match", out=out)
    refused("no -o", 2, ["-o DIR is missing"], *pair, "--rig", rig, command="match", out="")


def test_interrupted(folder):
    site, out = f"{folder}/site", f"{folder}/stopped"
    status, _, errors = run("render", os.path.join(SOURCE, "datasets/site-polyhedra"), "-o", site, "-q", "--frames", "1..1")
    check(status == 0, f"site-polyhedra is rendered {errors.strip()}")
    many = write(f"{folder}/many.csv", "x_px,y_px\n" + "".join(f"{20 + i % 1240},{20 + i // 1240 * 9}\n" for i in range(100000)))
    for name, arguments, wait in (("automatic", ("--count", 100000), 0.4), ("guided", ("--points", many, "--count", 50), 2.0)):
        stopped = subprocess.Popen([PROGRAM, "match", f"{site}/left/01.png", f"{site}/right/01.png", "--rig", f"{site}/rig.yaml", "-o", out, "-q",
                                    *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
        time.sleep(wait * (4 if SANITIZED else 1))
        begun = time.monotonic()
        os.killpg(stopped.pid, signal.SIGINT)
        text, errors = stopped.communicate(timeout=120)
        check(stopped.returncode == 1 and "interrupted" in errors and not fault_of_sentence(errors, "match") and not text and not os.path.isdir(out),
              f"SIGINT, {name}: {errors.strip()}, after {time.monotonic() - begun:.1f} s")


with tempfile.TemporaryDirectory() as place:
    described = write(f"{place}/rig.yaml", parallel_rig(WIDTH, HEIGHT, 200, 160, 160, 120, 0.2))
    seen = images(place, "grain", grain())
    test_plane(seen, described, place)
    test_schema(seen, described, place)
    test_threads(seen, described, place)
    test_images(seen, described, place)
    test_without_texture(described, place)
    test_repeated(described, place)
    test_tables(seen, described, place)
    test_far_choice(seen, described, place)
    test_places(seen, described, place)
    test_interrupted(place)
    finish()
