"""Simulated datasets for `teledimos vehicle`: the excavator of datasets/zx200 with a stereo rig on its upper structure or its
undercarriage, six points on the stick, boards on stick or ground. Kinematics and projection are written here once more, from the
URDF and Brown's model alone, so that they are a reference for the program's own.

    python3 tests/apps/vehicle_sets.py datasets/zx200-stick      writes the set that is shipped, byte for byte
"""

import os
import sys
import xml.etree.ElementTree as xml

import numpy as np

SOURCE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
URDF = os.path.join(SOURCE, "datasets/zx200/zx200.urdf")
JOINTS = ["swing", "boom", "arm", "bucket"]
PLACES = [[0.35, 0.25, 0.1], [1.2, -0.25, -0.05], [2.5, 0.2, 0.25], [1.0, -0.2, 0.25], [1.7, 0.3, -0.1], [2.1, -0.3, 0.0]]
SIZE = (1280, 960)
INTRINSICS = [900, 901, 640, 480, -0.1, 0.05, 1e-4, 2e-4, 0]
ABOUT = ("Simulated, not measured: the machine of datasets/zx200 with a stereo rig on its upper structure sees six points on the "
         "stick (link arm) in 20 poses of the arm. Noise: 0.2 px in every coordinate of a sight, 0.05 degrees in every reading of "
         "a joint, normal. Points and rig are exact. Truth: vehicle_from_rig q {q}, t_m {t}; all zeros of the joints 0.")


def rotation(w):
    w = np.asarray(w, float)
    angle = np.linalg.norm(w)
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / max(angle, 1e-300)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def pose(r, t):
    m = np.eye(4)
    m[:3, :3] = r
    m[:3, 3] = t
    return m


def quaternion(r):
    w = np.sqrt(max(0, 1 + np.trace(r))) / 2
    return np.array([w, (r[2, 1] - r[1, 2]) / (4 * w), (r[0, 2] - r[2, 0]) / (4 * w), (r[1, 0] - r[0, 1]) / (4 * w)])


class Machine:
    """root_from_link of every link of a URDF; fixed and turning joints."""

    def __init__(self, path=URDF):
        self.joints = []
        for joint in xml.parse(path).getroot().findall("joint"):
            origin, axis = joint.find("origin"), joint.find("axis")
            xyz = [float(v) for v in origin.get("xyz", "0 0 0").split()]
            roll, pitch, yaw = [float(v) for v in origin.get("rpy", "0 0 0").split()]
            turn = rotation([0, 0, yaw]) @ rotation([0, pitch, 0]) @ rotation([roll, 0, 0])
            limit = joint.find("limit")
            self.joints.append({"name": joint.get("name"), "parent": joint.find("parent").get("link"),
                                "child": joint.find("child").get("link"), "origin": pose(turn, xyz),
                                "axis": None if joint.get("type") == "fixed" else np.array([float(v) for v in axis.get("xyz").split()]),
                                "limits": [float(limit.get(k, 0)) for k in ("lower", "upper")] if limit is not None else [0, 0]})

    def limits(self, name):
        return next(j["limits"] for j in self.joints if j["name"] == name)

    def links(self, q):
        known = {"undercarriage": np.eye(4)}
        for j in self.joints:  # parents stand before their children in the file
            turn = np.eye(4) if j["axis"] is None else pose(rotation(j["axis"] * q[j["name"]]), [0, 0, 0])
            known[j["child"]] = known[j["parent"]] @ j["origin"] @ turn
        return known


CAMERA_FROM_RIG = {"left": np.eye(4), "right": pose(rotation([0.002, 0.01, -0.003]), [-0.6, 0, 0])}


def mount_from_rig(on_cab=True):
    straight = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    return pose(rotation([0.03, 0.06 if on_cab else -0.15, 0.02]) @ straight, [0.9, 0.35, 1.7] if on_cab else [1.6, 0.2, 1.1])


def project(x):
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = INTRINSICS
    a, b = x[0] / x[2], x[1] / x[2]
    r = a * a + b * b
    radial = 1 + r * (k1 + r * (k2 + r * k3))
    return np.array([fx * (a * radial + 2 * p1 * a * b + p2 * (r + 2 * a * a)) + cx,
                     fy * (b * radial + p1 * (r + 2 * b * b) + 2 * p2 * a * b) + cy])


def seen_at(camera, rig_from_link, place):
    x = CAMERA_FROM_RIG[camera] @ rig_from_link @ np.append(place, 1)
    if x[2] < 0.5:
        return None
    pixel = project(x)
    return pixel if 0 < pixel[0] < SIZE[0] - 1 and 0 < pixel[1] < SIZE[1] - 1 else None


def rig_text(covariance=True):
    text = "teledimos: rig 1\ncameras:\n"
    for name, m in CAMERA_FROM_RIG.items():
        v = INTRINSICS
        q, t = quaternion(m[:3, :3]), m[:3, 3]
        text += (f"  - name: {name}\n    model: brown5\n    width: {SIZE[0]}\n    height: {SIZE[1]}\n"
                 f"    intrinsics: {{fx: {v[0]}, fy: {v[1]}, cx: {v[2]}, cy: {v[3]}}}\n"
                 f"    distortion: {{k1: {v[4]}, k2: {v[5]}, p1: {v[6]}, p2: {v[7]}, k3: {v[8]}}}\n"
                 f"    camera_from_rig: {{q: [{', '.join(repr(float(k)) for k in q)}], t_m: [{', '.join(repr(float(k)) for k in t)}]}}\n")
    if covariance:
        names = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "rx", "ry", "rz", "tx", "ty", "tz"]
        order = [f"{camera}.{name}" for camera in CAMERA_FROM_RIG for name in names]
        text += f"covariance:\n  order: [{', '.join(order)}]\n  matrix:\n" + f"    - [{', '.join(['0'] * 30)}]\n" * 30
    return text + "provenance: {job: simulated, about: the cameras are exact}\n"


def make(folder, poses=20, seed=4, on_cab=True, slew=0.0, noise=1.0, places=None, know=lambda p, k: True, ground=None,
         know_ground=True, offset=None, sigma_m=None, columns="deg", rig_covariance=True, about=None, robot=None, extra=""):
    """Writes a dataset. know(p, k): coordinate k of point p is given; ground: places of points on the undercarriage; offset: by
    joint, true minus read, rad. Returns truth: vehicle_from_rig."""
    machine, rng = Machine(), np.random.default_rng(seed)
    places = PLACES if places is None else places
    ground = [] if ground is None else ground
    mount, truth = "upper" if on_cab else "undercarriage", mount_from_rig(on_cab)
    angles, sights = [], []
    for k in range(poses):
        for _ in range(100000):
            q = {}
            for name in JOINTS:
                low, high = (-slew, slew) if name == "swing" else (machine.limits(name)[0] + 0.02, machine.limits(name)[1] - 0.02)
                q[name] = rng.uniform(low, high)
            links = machine.links(q)
            rig_from_root = np.linalg.inv(links[mount] @ truth)
            pixels = {(f"s{p + 1}", c): seen_at(c, rig_from_root @ links["arm"], place) for p, place in enumerate(places) for c in CAMERA_FROM_RIG}
            if all(v is not None for v in pixels.values()):
                break
        pixels.update({(f"g{p + 1}", c): seen_at(c, rig_from_root, place) for p, place in enumerate(ground) for c in CAMERA_FROM_RIG})
        name = f"{k + 1:02d}"
        read = {j: q[j] - (offset or {}).get(j, 0) + noise * np.radians(0.05) * rng.normal() for j in JOINTS}
        angles.append((name, read))
        for (point, camera), pixel in pixels.items():
            if pixel is not None:
                sights.append((name, camera, point, *(pixel + noise * 0.2 * rng.normal(size=2))))
    os.makedirs(folder, exist_ok=True)
    listed = [(f"s{p + 1}", "arm", [place[k] if know(p, k) else None for k in range(3)]) for p, place in enumerate(places)]
    listed += [(f"g{p + 1}", "undercarriage", place if know_ground else [None] * 3) for p, place in enumerate(ground)]
    said = "".join(f"  - {{name: {n}, link: {link}, place_m: [{', '.join('null' if v is None else repr(float(v)) for v in place)}]"
                   + (f", sigma_m: {sigma_m}" if sigma_m and link == "arm" else "") + "}\n" for n, link, place in listed)
    with open(f"{folder}/dataset.yaml", "w") as file:
        file.write(f"name: {os.path.basename(os.path.normpath(folder))}\n" + (f"about: >-\n  {about}\n" if about else "")
                   + f"rig: rig.yaml\nrobot:\n  urdf: {robot or URDF}\n  joints: angles.csv\n  mount: {mount}\n  tip: bucket_tip\n"
                   + f"  sigma_deg: 0.05\nsights: sights.csv\nsigma_px: 0.2\npoints:\n{said}{extra}")
    with open(f"{folder}/angles.csv", "w") as file:
        file.write("frame," + ",".join(f"{j}_{columns}" for j in JOINTS) + "\n")
        for name, read in angles:
            file.write(name + "," + ",".join(f"{np.degrees(read[j]) if columns == 'deg' else read[j]:.7f}" for j in JOINTS) + "\n")
    with open(f"{folder}/sights.csv", "w") as file:
        file.write("frame,camera,point,x_px,y_px\n" + "".join(f"{n},{c},{p},{x:.4f},{y:.4f}\n" for n, c, p, x, y in sights))
    with open(f"{folder}/rig.yaml", "w") as file:
        file.write(rig_text(rig_covariance))
    return truth


# ---- a board of tags on the stick, in images ----

GRID = {"columns": 3, "rows": 2, "tag": 0.2, "spacing": 0.26}
BOARD = pose(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], float) @ rotation([0.05, -0.1, 0.03]), [0.9, 0.35, -0.3])  # arm_from_target
BOARD_TEXT = (f"target: {{kind: aprilgrid, columns: {GRID['columns']}, rows: {GRID['rows']}, tag_size_m: {GRID['tag']}, "
              f"spacing_m: {GRID['spacing']}, border: 1, order: downward}}")


def board_picture(cell=20):
    """The board from above, cell px for each of a tag's cells; its first point is at (margin, margin)."""
    import cv2
    dictionary = cv2.aruco.Dictionary_get(cv2.aruco.DICT_APRILTAG_36h11)
    size, step, margin = 8 * cell, round(8 * cell * GRID["spacing"] / GRID["tag"]), 2 * cell
    picture = np.full((step * (GRID["rows"] - 1) + size + 2 * margin, step * (GRID["columns"] - 1) + size + 2 * margin), 235, np.uint8)
    for row in range(GRID["rows"]):
        for column in range(GRID["columns"]):
            tag = cv2.aruco.drawMarker(dictionary, row * GRID["columns"] + column, size, borderBits=1)[::-1, ::-1]  # as libapriltag reads it
            picture[margin + row * step:margin + row * step + size, margin + column * step:margin + column * step + size] = np.maximum(tag, 20)
    return picture, margin, size / GRID["tag"]


def unproject(u, v):
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = INTRINSICS
    x0, y0 = (u - cx) / fx, (v - cy) / fy
    x, y = x0, y0
    for _ in range(12):
        r = x * x + y * y
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        x, y = (x0 - 2 * p1 * x * y - p2 * (r + 2 * x * x)) / radial, (y0 - p1 * (r + 2 * y * y) - 2 * p2 * x * y) / radial
    return x, y


def render(camera_from_board, board, rng, fine=4):
    """What a camera sees of the board, each pixel the mean of fine x fine rays, with noise of 1.5 grey levels."""
    picture, margin, scale = board
    height, width = picture.shape
    corners = [project((camera_from_board @ [(u - margin) / scale, (v - margin) / scale, 0, 1])[:3]) for u in (0, width) for v in (0, height)]
    low, high = np.floor(np.min(corners, 0)).astype(int) - 3, np.ceil(np.max(corners, 0)).astype(int) + 4
    step = (np.arange(fine) + 0.5) / fine - 0.5
    u, v = np.meshgrid((np.arange(low[0], high[0])[:, None] + step).ravel(), (np.arange(low[1], high[1])[:, None] + step).ravel())
    # At random within its share of the pixel: rays in a grid would shift edges that lie along it.
    x, y = unproject(u + (rng.random(u.shape) - 0.5) / fine, v + (rng.random(v.shape) - 0.5) / fine)
    h = np.linalg.inv(camera_from_board[:3, [0, 1, 3]])
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    a = np.floor((h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w * scale + margin).astype(int)
    b = np.floor((h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w * scale + margin).astype(int)
    inside = (a >= 0) & (b >= 0) & (a < width) & (b < height)
    grey = np.where(inside, picture[np.clip(b, 0, height - 1), np.clip(a, 0, width - 1)], 120).astype(float)
    grey = grey.reshape(high[1] - low[1], fine, high[0] - low[0], fine).mean((1, 3))
    image = np.full((SIZE[1], SIZE[0]), 120.0)
    image[low[1]:high[1], low[0]:high[0]] = grey + 1.5 * rng.normal(size=grey.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def make_board(folder, poses=8, seed=6, slew=0.1, said="", on_cab=True):
    """A dataset of images of the board on the stick. said: what dataset.yaml tells of its pose."""
    import cv2
    machine, rng, board = Machine(), np.random.default_rng(seed), board_picture()
    mount, truth = "upper" if on_cab else "undercarriage", mount_from_rig(on_cab)
    os.makedirs(folder, exist_ok=True)
    extent = [GRID["spacing"] * (GRID[k] - 1) + GRID["tag"] for k in ("columns", "rows")]
    angles, k = [], 0
    while k < poses:
        q = {n: rng.uniform(-slew, slew) if n == "swing" else rng.uniform(*machine.limits(n)) for n in JOINTS}
        links = machine.links(q)
        rig_from_board = np.linalg.inv(links[mount] @ truth) @ links["arm"] @ BOARD
        shown = all(seen_at(c, rig_from_board, [x, y, 0]) is not None for c in CAMERA_FROM_RIG for x in (-0.05, extent[0] + 0.05) for y in (-0.05, extent[1] + 0.05))
        towards = rig_from_board[:3, 3] / np.linalg.norm(rig_from_board[:3, 3])
        if not shown or rig_from_board[:3, 2] @ towards < 0.6 or np.linalg.norm(rig_from_board[:3, 3]) > 6:
            continue
        k += 1
        for camera, camera_from_rig in CAMERA_FROM_RIG.items():
            cv2.imwrite(f"{folder}/{camera}{k:02d}.png", render(camera_from_rig @ rig_from_board, board, rng))
        angles.append((f"{k:02d}", {j: q[j] + np.radians(0.05) * rng.normal() for j in JOINTS}))
    with open(f"{folder}/dataset.yaml", "w") as file:
        file.write(f"name: board\nrig: rig.yaml\nrobot: {{urdf: {URDF}, joints: angles.csv, mount: {mount}, tip: bucket_tip}}\n"
                   f"cameras: [{{name: left, model: brown5}}, {{name: right, model: brown5}}]\n"
                   f"boards:\n  - name: plate\n    link: arm\n    {BOARD_TEXT}\n{said}")
    with open(f"{folder}/angles.csv", "w") as file:
        file.write("frame," + ",".join(f"{j}_deg" for j in JOINTS) + "\n"
                   + "".join(n + "," + ",".join(f"{np.degrees(read[j]):.7f}" for j in JOINTS) + "\n" for n, read in angles))
    with open(f"{folder}/frames.csv", "w") as file:
        file.write("frame,left,right\n" + "".join(f"{n},left{n}.png,right{n}.png\n" for n, _ in angles))
    with open(f"{folder}/rig.yaml", "w") as file:
        file.write(rig_text())
    return truth


def board_pose(m=BOARD):
    return f"    link_from_target: {{q: [{', '.join(repr(float(v)) for v in quaternion(m[:3, :3]))}], t_m: [{', '.join(repr(float(v)) for v in m[:3, 3])}]}}\n"


if __name__ == "__main__":
    m = mount_from_rig()
    make(sys.argv[1], robot="../zx200/zx200.urdf",
         about=ABOUT.format(q=[round(float(v), 6) for v in quaternion(m[:3, :3])], t=[float(v) for v in m[:3, 3]]))
