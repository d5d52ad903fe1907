"""What the tests of teledimos match judge by: truth of rendered scenes through OpenCV's camera model and numpy, none of it the
library's. A left pixel is undistorted, its rendered depth interpolated (inverse depth, bilinear: a plane's is linear), the point
carried to the right camera and projected by cv2.projectPoints."""

import csv
import os

import cv2
import numpy as np
import yaml


def pfm(path):
    with open(path, "rb") as file:
        assert file.readline().strip() == b"Pf"
        width, height = map(int, file.readline().split())
        order = "<f4" if float(file.readline()) < 0 else ">f4"
        return np.frombuffer(file.read(), order).reshape(height, width)[::-1]


def rotation(q):
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


class Camera:
    def __init__(self, description):
        i, d = description["intrinsics"], description.get("distortion", {})
        self.matrix = np.array([[i["fx"], 0, i["cx"]], [0, i["fy"], i["cy"]], [0, 0, 1.0]])
        self.distortion = np.array([d.get(k, 0.0) for k in ("k1", "k2", "p1", "p2", "k3")])
        self.rotation = rotation(description["camera_from_rig"]["q"])
        self.translation = np.array(description["camera_from_rig"]["t_m"])

    def rays(self, pixels):
        """Points at depth 1, camera's frame."""
        return cv2.undistortPointsIter(np.array(pixels)[:, None, :2], self.matrix, self.distortion, None, None,
                                       (3, 100, 1e-14)).reshape(-1, 2)

    def from_rig(self, points):
        return points @ self.rotation.T + self.translation

    def project(self, points):
        """Pixels of points of the rig's frame."""
        return cv2.projectPoints(self.from_rig(points), np.zeros(3), np.zeros(3), self.matrix, self.distortion)[0].reshape(-1, 2)


class Truth:
    """One rendered frame of a dataset."""

    def __init__(self, dataset, frame):
        with open(os.path.join(dataset, "rig.yaml")) as file:
            rig = yaml.safe_load(file)
        self.left, self.right = (Camera(c) for c in rig["cameras"][:2])
        self.depth, self.other = (pfm(os.path.join(dataset, f"truth/{side}/{frame}.pfm")) for side in ("left", "right"))
        self.turn = rotation(rig["vehicle_from_rig"]["q"])
        self.at = np.array(rig["vehicle_from_rig"]["t_m"])
        self.image = cv2.imread(os.path.join(dataset, f"left/{frame}.png"), cv2.IMREAD_GRAYSCALE)

    def behind(self, left):
        """Points (rig's frame) behind left pixels, and whether the four depths around each are of one surface (3 cm)."""
        i, j = np.floor(left[:, 0]).astype(int), np.floor(left[:, 1]).astype(int)
        a, b = left[:, 0] - i, left[:, 1] - j
        around = np.stack([self.depth[j, i], self.depth[j, i + 1], self.depth[j + 1, i], self.depth[j + 1, i + 1]], 1)
        weight = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], 1)
        return around, 1 / (weight / around).sum(1), np.ptp(around, axis=1) < 0.03

    def points(self, left, depth):
        rays = np.c_[self.left.rays(left), np.ones(len(left))] * depth[:, None]
        return (rays - self.left.translation) @ self.left.rotation

    def vehicle(self, points):
        return points @ self.turn.T + self.at

    def errors(self, matches):
        """Right pixel minus truth (n,2), and whether the surface is smooth there. At an edge of depth the pixel may belong to
        either side: the better one counts."""
        left, right = matches[:, :2], matches[:, 2:4]
        around, depth, smooth = self.behind(left)
        every = np.stack([self.right.project(self.points(left, z)) - right for z in np.c_[depth, around].T], 1)
        best = np.where(smooth, 0, 1 + np.argmin(np.linalg.norm(every[:, 1:], axis=2), axis=1))
        return every[np.arange(len(left)), best], smooth

    def seen_in_both(self, left, margin):
        """Where the truth is one: no edge of depth within 2 px, the right camera sees the same point `margin` px inside."""
        i, j = np.rint(left[:, 0]).astype(int), np.rint(left[:, 1]).astype(int)
        near = np.stack([self.depth[j + v, i + u] for v in range(-2, 3) for u in range(-2, 3)], 1)
        _, depth, smooth = self.behind(left)
        points = self.points(left, depth)
        there = self.right.project(points)
        u, v = np.rint(there[:, 0]), np.rint(there[:, 1])
        height, width = self.other.shape
        inside = (u >= margin) & (v >= margin) & (u < width - margin) & (v < height - margin)
        seen = self.other[np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)]
        same = np.abs(seen - self.right.from_rig(points)[:, 2]) < 0.02
        return smooth & inside & same & (np.ptp(near, axis=1) < 0.02 * depth)


def textured_points(image, count, good, least=6.0, margin=12, seed=1):
    """`count` random pixels (with a fraction) whose 15 x 15 window has a standard deviation of `least` grey levels, and for which
    good(points) holds."""
    random, found = np.random.default_rng(seed), np.zeros((0, 2))
    grey = image.astype(float)
    spread = np.sqrt(np.maximum(cv2.blur(grey * grey, (15, 15)) - cv2.blur(grey, (15, 15))**2, 0))
    while len(found) < count:
        points = np.round(random.uniform([margin, margin], [image.shape[1] - margin, image.shape[0] - margin], (4 * count, 2)), 3)
        points = points[spread[np.rint(points[:, 1]).astype(int), np.rint(points[:, 0]).astype(int)] > least]
        found = np.r_[found, points[good(points)]]
    return found[:count]


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def columns(rows, *names):
    """Numbers (rows, names); what is empty is NaN."""
    return np.array([[float(row[name] or "nan") for name in names] for row in rows]).reshape(len(rows), len(names))


PIXELS = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")


def write_points(path, points):
    with open(path, "w") as file:
        file.write("x_px,y_px\n" + "".join(f"{x!r},{y!r}\n" for x, y in np.array(points).tolist()))
    return path


def rig_text(cameras):
    """rig.yaml of (name, width, height, (fx, fy, cx, cy), distortion of five or None, q, t)."""
    text = "teledimos: rig 1\ncameras:\n"
    for name, width, height, (fx, fy, cx, cy), distortion, q, t in cameras:
        text += f"  - name: {name}\n    model: {'brown5' if distortion else 'pinhole'}\n    width: {width}\n    height: {height}\n"
        text += f"    intrinsics: {{fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy}}}\n"
        if distortion:
            text += "    distortion: {" + ", ".join(f"{k}: {v}" for k, v in zip(("k1", "k2", "p1", "p2", "k3"), distortion)) + "}\n"
        text += f"    camera_from_rig: {{q: {[float(v) for v in q]}, t_m: {[float(v) for v in t]}}}\n"
    return text


def parallel_rig(width, height, f, left_cx, right_cx, cy, baseline):
    return rig_text([(name, width, height, (f, f, cx, cy), None, [1, 0, 0, 0], [x, 0, 0])
                     for name, cx, x in (("left", left_cx, 0), ("right", right_cx, -baseline))])


def read_ply(path):
    """Points (n,3) and triangles (m,3) of points.ply."""
    vertex = np.dtype([("p", "<f8", 3), ("rgb", "u1", 3), ("sigma", "<f4")])
    face = np.dtype([("n", "u1"), ("corner", "<u4", 3)])
    with open(path, "rb") as file:
        counts = {}
        for line in iter(file.readline, b"end_header\n"):
            words = line.split()
            if words[0] == b"element":
                counts[words[1]] = int(words[2])
        points = np.frombuffer(file.read(vertex.itemsize * counts[b"vertex"]), vertex)
        faces = np.frombuffer(file.read(), face)
    assert len(faces) == counts[b"face"]
    return points["p"], faces["corner"]


def solids(scene):
    """The boxes and wedges of scene.yaml: name: (rotation, place, faces as outward normals and distances, own frame)."""
    with open(scene) as file:
        described = yaml.safe_load(file)["solids"]
    found = {}
    for solid in described:
        size = np.array(solid.get("box_m") or solid["wedge_m"])
        turn = rotation([np.cos(np.radians(solid["yaw_deg"]) / 2), 0, 0, np.sin(np.radians(solid["yaw_deg"]) / 2)])
        normals = [np.array(n, float) for n in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1))]
        faces = [(n, np.abs(n) @ size / (1 if n[2] else 2)) for n in normals]
        if "wedge_m" in solid:
            slope = np.array([-size[2], 0, size[0]]) / np.hypot(size[0], size[2])
            faces = [faces[0], *faces[2:4], (slope, slope @ [size[0] / 2, 0, size[2]])]
        found[solid["name"]] = (turn, np.array(solid["at_m"], float), faces)
    return found


def faces_of(points, bodies):
    """Which face each point (site's frame) lies on, as (name, index) or ("ground", 0), and its distance from it."""
    names, distances = [], []
    for p in points:
        found = ("ground", 0), p[2]
        for name, (turn, at, faces) in bodies.items():
            own = (p - at) @ turn
            apart = np.array([n @ own - h for n, h in faces])
            if apart.max() < 0.02 and own[2] > 0.01:
                found = (name, int(apart.argmax())), apart.max()
        names.append(found[0])
        distances.append(found[1])
    return names, np.array(distances)
