"""Proves: files that are no good, whichever of them, are named in one clear sentence that says where and why; the exit
status is 1, and nothing is written.

Reference: none; the words that the sentence must hold stand beside each case. Blind to: whether a sentence is good English.
"""

import os
import random
import resource
import struct
import tempfile
import time
import zlib

import cv2

from common import (CAMERAS, FRAMES, IMAGES, OPENCV_SET, SANITIZED, TABLE, TARGET, check, clean_runs,
                    finish, image_set, leftovers, points_set, points_text, refused, rig_file, run, shortened,
                    write_dataset)

clean = clean_runs()


# ---- images ----


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_that_claims(width, height):
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + png_chunk(b"IDAT", zlib.compress(b"\0" * 1000)) +
            png_chunk(b"IEND", b""))


def little_memory():
    resource.setrlimit(resource.RLIMIT_AS, (3 << 29, 3 << 29))


def test_images():
    with tempfile.TemporaryDirectory() as folder:
        good = cv2.imread(os.path.join(IMAGES, "left05.jpg"))
        small, png = os.path.join(folder, "small.png"), os.path.join(folder, "good.png")
        cv2.imwrite(small, cv2.resize(good, (320, 240)))
        cv2.imwrite(png, good)

        def file(name, content):
            with open(os.path.join(folder, name), "wb") as out:
                out.write(content)
            return os.path.join(folder, name)

        jpeg_bytes, png_bytes = open(os.path.join(IMAGES, "left05.jpg"), "rb").read(), open(png, "rb").read()
        os.mkfifo(os.path.join(folder, "pipe.png"))
        os.mkdir(os.path.join(folder, "folder.png"))
        damaged = bytearray(png_bytes)
        damaged[len(damaged) // 2] ^= 0xff
        bad = [("another size", small, ["640x480", "320x240"]), ("empty", file("empty.png", b""), ["empty"]),
               ("truncated JPEG", file("cut.jpg", jpeg_bytes[:len(jpeg_bytes) // 2]), []),
               ("JPEG without its end", file("cut2.jpg", jpeg_bytes[:-200]), []),
               ("truncated PNG", file("cut.png", png_bytes[:len(png_bytes) // 2]), []),
               ("damaged PNG", file("damaged.png", bytes(damaged)), []),
               ("text", file("text.png", b"this is no image\n"), []),
               ("a folder", os.path.join(folder, "folder.png"), ["folder"]),
               ("a pipe", os.path.join(folder, "pipe.png"), ["pipe"]), ("a device", "/dev/zero", ["device"]),
               ("missing", os.path.join(folder, "missing.png"), ["No such file"]),
               ("a PNG that claims 60000x60000", file("huge.png", png_that_claims(60000, 60000)), ["60000"]),
               ("a PNG that claims 16000x16000", file("large.png", png_that_claims(16000, 16000)), [])]
        few = FRAMES[2:6]  # the bad one among them, neither first nor last
        for what, path, words in bad:
            begun = time.monotonic()
            dataset = image_set(os.path.join(folder, "set"), {"05": {"left": path}}, frames=few)
            refused(f"image: {what}", 1, [os.path.basename(path), *words], dataset,
                    before=None if SANITIZED else little_memory)
            if "claims" in what:
                check(time.monotonic() - begun < 20, "  and it takes no long")
        rectified, rig = os.path.join(folder, "rectified"), rig_file(folder, clean["rig"])
        for what, path, words in bad[::5]:
            dataset = image_set(os.path.join(folder, "set"), {"05": {"left": path}}, frames=few)
            refused(f"rectify, image: {what}", 1, [os.path.basename(path)], dataset, "--rig", rig, command="rectify",
                    out=rectified)
        left = os.listdir(rectified)
        whole = all(cv2.imread(os.path.join(rectified, name)) is not None for name in left)
        check(whole and len(left) == 7 and not leftovers(rectified),
              f"rectify: the {len(left)} good images are whole, and no result says that all is done")


# ---- the description ----


def bad_descriptions():
    """(what, text, words): what must be named."""
    base = f"name: x\nroot: {IMAGES}\n{TARGET}{CAMERAS}"

    def spacing(text):
        return base.replace("0.025", text)

    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9))
    for text in (".nan", ".inf", "-.inf", "'0.025'", "abc", "[0.025]", "true"):
        yield f"spacing_m {text}", spacing(text), ["target.spacing_m"]
    yield "spacing_m 1e400", spacing("1e400"), ["1e400"]
    for text in ("-0.025", "0", "1e9", "1e-9"):
        yield f"spacing_m {text}", spacing(text), ["target", "spacing_m", "between"]
    for text in ("-9", "0", "1000000", "9.5", "'9'", "99999999999999999999"):
        words = ["target", "columns"] if len(text) < 9 else [text]
        yield f"columns {text}", base.replace("columns: 9", f"columns: {text}"), words
    yield "no columns", base.replace("columns: 9, ", ""), ["target.columns", "missing"]
    yield "no target", base.replace(TARGET, ""), ["target", "missing"]
    yield "no cameras", base.replace(CAMERAS, ""), ["cameras", "missing"]
    yield "cameras: []", base.replace(CAMERAS, "cameras: []\n"), ["cameras"]
    yield "no name", base.replace("name: x\n", ""), ["name", "missing"]
    yield "spacing for spacing_m", base.replace("spacing_m", "spacing"), ["spacing_m"]
    yield "colums for columns", base.replace("columns", "colums"), ["'colums'", "'columns'"]
    yield "camera for cameras", base.replace("cameras:", "camera:"), ["'camera'", "'cameras'"]
    yield "a key of another world", base + "wheels: 4\n", ["wheels"]
    yield "a key twice", base + "name: y\n", ["name", "twice"]
    yield "an unknown lens model", base.replace("brown5", "brown6"), ["brown6", "brown5"]
    yield "an unknown target", base.replace("chessboard", "checkerboard"), ["checkerboard", "chessboard"]
    yield "two cameras of one name", base.replace("right", "left"), ["left", "twice"]
    yield "a camera named ../x", base.replace("left", "../x"), ["../x", "letters"]
    yield "a variable that is not set", base.replace(IMAGES, "${TELEDIMOS_NOT_SET}/x"), ["TELEDIMOS_NOT_SET", "not set"]
    yield "a tolerance of 0", base + "expect: {baseline_m: 0.1, tolerance_m: 0}\n", ["expect.tolerance_m"]
    yield "a baseline in millimetres", base + "expect: {baseline_m: 83000, tolerance_m: 1}\n", ["expect.baseline_m"]
    yield "an alias bomb", bomb + base, ["aliases"]
    yield "10 MB of [", "[" * 10_000_000, []
    yield "10 MB of {", "a: " + "{" * 10_000_000, []
    yield "500 times [ ", "[" * 500 + "]" * 500, []
    yield "binary garbage", random.Random(1).randbytes(5000), []
    yield "NUL bytes", base.encode() + b"\0\0\0", []
    yield "Latin-1", "name: Müller\n".encode("latin-1") + base.encode(), []
    yield "an empty file", "", ["empty"]
    yield "a comment only", "# nothing\n", ["empty"]
    yield "a list at the root", "- name: x\n", ["mapping"]
    yield "a word at the root", "hello\n", ["mapping"]
    yield "two documents", base + "---\n" + base, ["second document"]
    yield "a tag", base.replace("name: x", "name: !!python/object x"), ["tags"]
    yield "an open bracket", base.replace("0.025}", "0.025"), ["YAML"]
    yield "a name of a million letters", base.replace("name: x", "name: " + "x" * 1_000_000), ["name"]


def test_descriptions():
    with tempfile.TemporaryDirectory() as folder:
        dataset = write_dataset(folder, "", open(os.path.join(OPENCV_SET, "frames.csv")).read())
        path = os.path.join(folder, "dataset.yaml")
        for what, text, words in bad_descriptions():
            with open(path, "wb") as file:
                file.write(text if isinstance(text, bytes) else text.encode())
            refused(f"dataset.yaml: {what}", 1, ["dataset.yaml", *words], dataset)
        with open(path, "wb") as file:
            file.truncate(3 << 30)
        refused("dataset.yaml: 3 GB of zeros", 1, ["dataset.yaml", "larger"], dataset,
                before=None if SANITIZED else little_memory)
        os.remove(path)
        os.mkfifo(path)
        refused("dataset.yaml: a pipe", 1, ["dataset.yaml", "pipe"], dataset)
        os.remove(path)
        os.mkdir(path)
        refused("dataset.yaml: a folder", 1, ["dataset.yaml", "folder"], dataset)
        os.rmdir(path)
        # What a dataset is stands below the sentence, for those who begin.
        for what, place in (("no dataset.yaml", folder), ("no dataset", os.path.join(folder, "none"))):
            status, text, errors = run("calibrate", place, "-o", os.path.join(folder, "out"))
            check(status == 1 and place in errors and "dataset.yaml" in errors and not text and
                  not os.path.exists(os.path.join(folder, "out")), f"{what}: {shortened(errors)}")
        image_set(folder, root=os.path.join(folder, "nowhere"))
        refused("a root that does not exist", 1, ["nowhere/left01.jpg"], folder)


def test_tables():
    lines = open(os.path.join(OPENCV_SET, "frames.csv")).read()
    description = f"name: x\nroot: {IMAGES}\n{TARGET}{CAMERAS}"
    bad = [("empty", "", ["empty"]), ("header only", TABLE, ["no frames"]),
           ("another camera's column", lines.replace("right\n", "rear\n", 1), ["right", "rear"]),
           ("a column twice", lines.replace("left,right", "left,left", 1), ["left", "twice"]),
           ("a frame twice", lines + "05,left05.jpg,right05.jpg\n", ["'05'", "line 6"]),
           ("a frame without a name", lines + ",left05.jpg,right05.jpg\n", ["frame", "name"]),
           ("a frame's name of a million letters", lines + "x" * 1_000_000 + ",left05.jpg,right05.jpg\n", ["frame"]),
           ("an image's name of a million letters", lines + "99," + "x" * 1_000_000 + ",right05.jpg\n", ["frames.csv:15", "left", "1000000"]),
           ("NUL bytes", lines + "99,left\0.jpg,right05.jpg\n", ["frames.csv:15"]),
           ("only NUL bytes", "\0" * 100, []), ("a short row", lines + "99,left05.jpg\n", ["frames.csv:15", "cells"]),
           ("an open quote", lines + '99,"left05.jpg,right05.jpg\n', ["frames.csv:15", "quote"]),
           ("Latin-1", lines.encode() + b"99,M\xfcller.jpg,\n", ["UTF-8"]),
           ("2000 columns", ",".join(map(str, range(2000))) + "\n", ["columns"]),
           ("a camera without images", TABLE + "".join(f"{f},left{f}.jpg,\n" for f in FRAMES), ["right"]),
           ("a time that is no number", "frame,time_s,left,right\n1,noon,left01.jpg,right01.jpg\n", ["time_s", "noon"]),
           ("a height that is NaN", "frame,height_m,left,right\n1,nan,left01.jpg,right01.jpg\n", ["height_m", "nan"])]
    with tempfile.TemporaryDirectory() as folder:
        for what, text, words in bad:
            write_dataset(folder, description, "")
            with open(os.path.join(folder, "frames.csv"), "wb") as file:
                file.write(text if isinstance(text, bytes) else text.encode())
            refused(f"frames.csv: {what}", 1, ["frames.csv", *words], folder)
        os.remove(os.path.join(folder, "frames.csv"))
        refused("frames.csv: missing", 1, ["frames.csv", "No such file"], folder)


def test_points():
    good = points_text(clean["points"])
    row = good.splitlines()[1].split(",")

    def changed(column, text):
        cells = list(row)
        cells[column] = text
        return good.replace(",".join(row), ",".join(cells), 1)

    bad = [("empty", "", []), ("no column", good.replace("x_px", "x", 1), ["x_px"]),
           ("another frame", changed(0, "77"), ["77"]), ("another camera", changed(1, "rear"), ["rear"]),
           ("another size", changed(2, "641"), ["641"]), ("a point too many", changed(4, "54"), ["point", "54"]),
           ("a point below 0", changed(4, "-1"), ["point", "-1"]), ("a point twice", changed(4, "1"), ["point", "twice"]),
           ("NaN", changed(5, "nan"), ["x_px", "nan"]), ("infinity", changed(6, "inf"), ["y_px", "inf"]),
           ("1e400", changed(5, "1e400"), ["x_px", "1e400"]), ("far away", changed(5, "1e8"), ["x_px", "1e8"]),
           ("a negative sigma", changed(7, "-1"), ["sigma_px", "-1"]), ("a word", changed(5, "left"), ["x_px", "left"])]
    with tempfile.TemporaryDirectory() as folder:
        for what, text, words in bad:
            refused(f"points.csv: {what}", 1, ["points.csv", *words], points_set(folder, clean["points"], text))
        os.remove(os.path.join(folder, "points.csv"))
        refused("points.csv: missing", 1, ["points.csv", "No such file"], folder)


# ---- rigs ----


def test_rigs():
    good = clean["rig"]
    rows = [i for i, line in enumerate(good.splitlines()) if line.lstrip().startswith("- [")]
    lines = good.splitlines(keepends=True)

    def without_row():
        return "".join(line for i, line in enumerate(lines) if i != rows[-1])

    def with_row(index, change):
        return "".join(change(line) if i == rows[index] else line for i, line in enumerate(lines))

    def cells(line, change):
        head, body = line.split("[")
        return head + "[" + ", ".join(change(body.rstrip("]\n").split(", "))) + "]\n"

    fx = good.split("fx: ")[1].split(",")[0]
    bad = [("NaN", good.replace(fx, ".nan", 1), ["fx"]), ("a word for a number", good.replace(fx, "wide", 1), ["fx"]),
           ("a negative focal length", good.replace(fx, "-" + fx, 1), ["fx"]),
           ("NaN in the covariance", with_row(0, lambda s: cells(s, lambda c: [".nan", *c[1:]])), ["covariance"]),
           ("a row too few in the covariance", without_row(), ["covariance"]),
           ("a number too few in the covariance", with_row(3, lambda s: cells(s, lambda c: c[:-1])), ["covariance"]),
           ("a covariance that is not symmetric", with_row(0, lambda s: cells(s, lambda c: [c[0], "1.0", *c[2:]])),
            ["symmetric"]),
           ("a negative variance", with_row(0, lambda s: cells(s, lambda c: ["-1.0", *c[1:]])), ["covariance"]),
           ("no quaternion", good.replace("q: [1.0, 0.0", "q: [2.0, 0.0", 1), ["unit quaternion"]),
           ("no rig", "name: x\n", ["not a rig"]), ("a later version", good.replace("rig 1", "rig 99", 1), ["99"]),
           ("cut off", good[:len(good) // 2], []), ("empty", "", ["empty"])]
    with tempfile.TemporaryDirectory() as folder:
        dataset = points_set(folder, clean["points"])
        for what, text, words in bad:
            for command, more in (("calibrate", ["--fix", "left.intrinsics"]), ("rectify", [])):
                refused(f"rig.yaml for {command}: {what}", 1, ["rig-in.yaml", *words], dataset, "--rig",
                        rig_file(folder, text), *more, command=command)
        others = rig_file(folder, good.replace("left", "front").replace("right", "rear"))
        refused("--fix left, rig of other cameras", 2, ["left"], dataset, "--rig", others, "--fix", "left")
        refused("rectify, rig of other cameras", 1, ["front"], dataset, "--rig", others, command="rectify")
        refused("rectify, no such pair", 1, ["rear"], dataset, "--rig", rig_file(folder, good), "--pair", "left,rear",
                command="rectify")
        refused("rectify, points instead of images", 1, ["points"], dataset, "--rig", rig_file(folder, good),
                command="rectify")
        refused("--rig missing", 1, ["nowhere.yaml", "No such file"], dataset, "--rig", "nowhere.yaml", "--fix", "left")
        refused("--clicks missing", 1, ["nowhere.csv", "No such file"], dataset, "--clicks", "nowhere.csv")


test_images()
test_descriptions()
test_tables()
test_points()
test_rigs()
finish()
