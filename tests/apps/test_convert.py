"""Proves that a rig means the same to the tool whose format it was converted to, and the other way round, with files written
or read by that tool itself: OpenCV's FileStorage (YAML, XML, JSON), ROS' camera_calibration_parsers, ViSP's
vpXmlParserCamera, mrcal.cameramodel; Kalibr is no Debian package, so its definition is computed here with numpy. The measure is the largest distance in pixels between the two tools'
projections of the same points (mrcal's and OpenCV's compiled code, not ours), all to 1e-9 px: double precision and
17 digits lose less. Poses are compared as matrices to 1e-12. URDF and ROS transform lines against numpy. Then approximations,
refusals, bad files and usage. Blind to what the other tools do with a rig afterwards."""

import json
import os
import shutil
import subprocess
import tempfile

import cv2
import numpy as np
import yaml

import common
from common import check, run, skip

try:
    import mrcal
except ImportError:
    mrcal = None
try:
    import camera_calibration_parsers as ros
except ImportError:
    ros = None

DATA = os.environ.get("TELEDIMOS_DATA", "")
DOCS = "/usr/share/doc/opencv-doc/examples"
TABLE = []
PX, POSE = 1e-9, 1e-12
K = {"left": [536.5, 536.25, 342.5, 235.5], "right": [537.125, 538.5, 326.75, 249.25]}
COUNT = {"pinhole": 0, "brown5": 5, "brown8": 8, "fisheye": 4}
D = {"pinhole": [], "brown5": [-0.265, 0.047, 0.0018, -0.0003, 0.025],
     "brown8": [0.31, 0.12, 0.0009, -0.0004, 0.006, 0.62, 0.21, 0.02], "fisheye": [-0.013, 0.021, -0.009, 0.0017]}
NAMES = {"pinhole": [], "brown5": "k1 k2 p1 p2 k3".split(), "brown8": "k1 k2 p1 p2 k3 k4 k5 k6".split(),
         "fisheye": "k1 k2 k3 k4".split()}
ROTATION = cv2.Rodrigues(np.array([0.02, -0.05, 0.03]))[0]
SHIFT = np.array([-0.0835, 0.0017, -0.0021])


# ---- rigs and points ----

def quaternion(r):
    v = cv2.Rodrigues(r)[0].ravel()
    angle = np.linalg.norm(v)
    q = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * (v / angle if angle else v)])
    return (q / np.linalg.norm(q)).tolist()


def rotation(q):
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def rig(model, names=("left", "right"), distortion=None):
    d = D[model] if distortion is None else distortion
    cameras = []
    for i, name in enumerate(names):
        q, t = (quaternion(ROTATION), SHIFT.tolist()) if i else ([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        if i > 1:
            t = (SHIFT * i).tolist()
        camera = {"name": name, "model": model, "width": 640, "height": 480,
                  "intrinsics": dict(zip(["fx", "fy", "cx", "cy"], K.get(name, K["left"])))}
        if model != "pinhole":
            camera["distortion"] = dict(zip(NAMES[model], d))
        cameras.append({**camera, "camera_from_rig": {"q": q, "t_m": t}})
    return {"teledimos": "rig 1", "cameras": cameras}


def write_rig(folder, content, name="rig.yaml"):
    path = os.path.join(folder, name)
    with open(path, "w") as file:
        yaml.safe_dump(content, file, sort_keys=False)
    return path


def read_rig(path):
    with open(path) as file:
        return yaml.safe_load(file)


def convert(*arguments, expect=0):
    status, text, errors = run("convert", *arguments)
    if status != expect:
        check(False, f"convert {' '.join(map(str, arguments))}: status {status}: {errors.strip()}")
    return text


def points(n=400):
    """Of the camera's frame, over the whole image."""
    random = np.random.default_rng(3)
    xy = random.uniform([-0.55, -0.42], [0.55, 0.42], (n, 2))
    z = random.uniform(0.5, 4, n)
    return np.column_stack([xy * z[:, None], z])


def image_rays(d):
    """Points on the rays of a grid of the left camera's pixels, to the corners, by OpenCV's undistortion."""
    u, v = np.meshgrid(np.linspace(-0.5, 639.5, 41), np.linspace(-0.5, 479.5, 31))
    pixels = np.column_stack([u.ravel(), v.ravel()]).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-15)
    rays = cv2.undistortPointsIter(pixels, matrix(K["left"]), np.array(d), np.eye(3), np.eye(3), criteria)
    return np.hstack([rays.reshape(-1, 2), np.ones((len(rays), 1))])


def matrix(p):
    return np.array([[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1.0]])


def project(camera, p):
    """A camera of rig.yaml by OpenCV's compiled code."""
    k = matrix(list(camera["intrinsics"].values()))
    d = np.array(list(camera.get("distortion", {}).values()) or [0.0] * 5)
    return project_opencv(k, d, p, camera["model"] == "fisheye")


def project_opencv(k, d, p, fisheye=False):
    zero = np.zeros(3)
    if fisheye:
        return cv2.fisheye.projectPoints(p.reshape(-1, 1, 3), zero, zero, k, np.asarray(d, float).ravel())[0].reshape(-1, 2)
    return cv2.projectPoints(p, zero, zero, k, np.asarray(d, float).ravel())[0].reshape(-1, 2)


def pose_of(camera):
    m = np.eye(4)
    m[:3, :3] = rotation(camera["camera_from_rig"]["q"])
    m[:3, 3] = camera["camera_from_rig"]["t_m"]
    return m


def note(file, direction, model, px, pose=None):
    TABLE.append((file, direction, model, px, pose))
    good = px <= PX and (pose is None or pose <= POSE)
    check(good, f"{file}: {direction}, {model}: {px:.1e} px" + ("" if pose is None else f", pose {pose:.1e}"))


def apart(a, b):
    return float(np.max(np.abs(np.asarray(a) - np.asarray(b))))


# ---- OpenCV ----

def opencv_reads_ours(folder, model):
    source = rig(model)
    convert(write_rig(folder, source), "-o", os.path.join(folder, "o.yml"))
    storage = cv2.FileStorage(os.path.join(folder, "o.yml"), cv2.FILE_STORAGE_READ)
    px = max(apart(project_opencv(storage.getNode(f"M{i + 1}").mat(), storage.getNode(f"D{i + 1}").mat(), points(),
                                  model == "fisheye"), project(source["cameras"][i], points())) for i in range(2))
    pose = max(apart(storage.getNode("R").mat(), pose_of(source["cameras"][1])[:3, :3]),
               apart(storage.getNode("T").mat().ravel(), SHIFT))
    note("OpenCV YAML", "ours read by OpenCV", model, px, pose)
    return storage


def rectification_of_opencv(storage):
    """R1 R2 P1 P2 Q as cv2 uses them: rows of a pair are equal, and Q gives the point back; E and F."""
    m = {key: storage.getNode(key).mat() for key in "M1 D1 M2 D2 R T E F R1 R2 P1 P2 Q".split()}
    p = points() * [1, 1, 3]
    seen = [cv2.projectPoints(p, cv2.Rodrigues(m["R"])[0] * i, m["T"] * i, m[f"M{i + 1}"], m[f"D{i + 1}"])[0]
            for i in range(2)]
    # 100 steps: the default 5 leave 1e-3 px
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-15)
    flat = [cv2.undistortPointsIter(seen[i], m[f"M{i + 1}"], m[f"D{i + 1}"], m[f"R{i + 1}"], m[f"P{i + 1}"],
                                    criteria).reshape(-1, 2) for i in range(2)]
    check(apart(flat[0][:, 1], flat[1][:, 1]) < 1e-6, f"OpenCV: rows match rows to {apart(flat[0][:, 1], flat[1][:, 1]):.1e} px")
    homogeneous = np.column_stack([flat[0], flat[0][:, 0] - flat[1][:, 0], np.ones(len(p))]) @ m["Q"].T
    back = homogeneous[:, :3] / homogeneous[:, 3:] @ m["R1"]
    check(apart(back, p) < 1e-6, f"OpenCV: Q gives the points back to {apart(back, p):.1e} m")
    ideal = [cv2.undistortPointsIter(seen[i], m[f"M{i + 1}"], m[f"D{i + 1}"], np.eye(3), np.eye(3), criteria).reshape(-1, 2)
             for i in range(2)]
    one = np.ones((len(p), 1))
    x = [np.hstack([v, one]) for v in ideal]
    check(np.max(np.abs(np.sum(x[1] @ m["E"] * x[0], 1))) < 1e-10, "OpenCV: x2' E x1 = 0")
    pixel = [v @ m[f"M{i + 1}"].T for i, v in enumerate(x)]
    check(np.max(np.abs(np.sum(pixel[1] @ m["F"] * pixel[0], 1))) < 1e-8 and abs(m["F"][2, 2] - 1) < 1e-12, "OpenCV: p2' F p1 = 0")


def we_read_opencv(folder, model, ending):
    """A pair as stereo_calib keeps it, in two files."""
    paths = [os.path.join(folder, f"{part}.{ending}") for part in ("intrinsics", "extrinsics")]
    storage = cv2.FileStorage(paths[0], cv2.FILE_STORAGE_WRITE)
    for i, side in enumerate(["left", "right"]):
        storage.write(f"M{i + 1}", matrix(K[side]))
        storage.write(f"D{i + 1}", np.array([D[model] or [0.0] * 5]))
    if model == "fisheye":
        storage.write("fisheye_model", 1)
    storage.release()
    storage = cv2.FileStorage(paths[1], cv2.FILE_STORAGE_WRITE)
    storage.write("R", ROTATION)
    storage.write("T", SHIFT.reshape(3, 1))
    storage.release()
    out = os.path.join(folder, "back.yaml")
    convert(*paths, "-o", out, "--to", "teledimos", "--width", 640, "--height", 480)
    cameras = read_rig(out)["cameras"]
    px = max(apart(project(cameras[i], points()), project_opencv(matrix(K[side]), D[model] or [0.0] * 5, points(),
                                                                 model == "fisheye")) for i, side in enumerate(["left", "right"]))
    m = pose_of(cameras[1])
    note(f"OpenCV {ending}", "theirs read by us", model, px, max(apart(m[:3, :3], ROTATION), apart(m[:3, 3], SHIFT)))


def opencv_files_as_shipped(folder):
    for name, size in [("data/left_intrinsics.yml", ()), ("data/intrinsics.yml", ("--width", 640, "--height", 480)),
                       ("aruco/tutorial_camera_charuco.yml", ()), ("aruco/tutorial_camera_params.yml", ("--width", 640, "--height", 480))]:
        path = os.path.join(DOCS, name)
        if not os.path.exists(path):
            skip(f"{path}: opencv-doc is not installed")
            continue
        storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
        pair = name == "data/intrinsics.yml"
        k, d = [storage.getNode(key).mat() for key in (("M1", "D1") if pair else ("camera_matrix", "distortion_coefficients"))]
        out = os.path.join(folder, "shipped.yaml")
        convert(path, "-o", out, "--to", "teledimos", *size, *(["--camera", "left"] if pair else []))
        note(name, "shipped, read by us", "brown5", apart(project(read_rig(out)["cameras"][0], points()), project_opencv(k, d, points())))


def many_cameras(folder):
    source = rig("brown8", ["a", "b", "c"])
    path, out = os.path.join(folder, "many.yml"), os.path.join(folder, "back.yaml")
    convert(write_rig(folder, source), "-o", path)
    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
    pose = max(apart(storage.getNode(f"camera_pose_{i}").mat(), pose_of(c)) for i, c in enumerate(source["cameras"]))
    convert(path, "-o", out, "--to", "teledimos")
    back = max(apart(pose_of(a), pose_of(b)) for a, b in zip(read_rig(out)["cameras"], source["cameras"]))
    note("OpenCV multicalib", "there and back", "brown8", 0.0, max(pose, back))


# ---- ROS ----

def ros_both_ways(folder, model):
    source = rig(model)
    base = os.path.join(folder, "ros")
    convert(write_rig(folder, source), "--to", "ros", "-o", base + "/")
    px = pose = 0
    infos = []
    for i, camera in enumerate(source["cameras"]):
        name, info = ros.readCalibration(os.path.join(base, camera["name"] + ".yaml"))
        infos.append(info)
        check(name == camera["name"] and (info.width, info.height) == (640, 480), f"ROS: {name}, {info.distortion_model}")
        px = max(px, apart(project_opencv(np.reshape(info.K, (3, 3)), info.D, points(), info.distortion_model == "equidistant"),
                           project(camera, points())))
    # image_geometry: Tx = -fx B; here from the definition, camera from rectified = R' [I | t].
    r = [np.reshape(i.R, (3, 3)) for i in infos]
    p = [np.reshape(i.P, (3, 4)) for i in infos]
    t = np.linalg.solve(p[1][:, :3], p[1][:, 3])
    relative = r[1].T @ r[0]
    pose = max(apart(relative, ROTATION), apart(r[1].T @ t, SHIFT))
    note("ROS camera_info", "ours read by ROS", model, px, pose)
    check(p[1][0, 3] < 0 and p[1][1, 3] == 0 and apart(p[0][:, :3], p[1][:, :3]) == 0, "ROS: P of the pair as its stereo nodes expect")
    if model == "brown5":
        rewritten = os.path.join(folder, "theirs")
        os.makedirs(rewritten, exist_ok=True)
        if not shutil.which("c++") or not os.path.exists("/usr/include/camera_calibration_parsers/parse.h"):
            skip("writing by ROS' own library: libcamera-calibration-parsers-dev is not installed")
            return
        copy = compiled(folder, "ros_copy", '#include <camera_calibration_parsers/parse.h>\nint main(int, char **v) { std::string n; '
                        'sensor_msgs::CameraInfo i; return !(camera_calibration_parsers::readCalibration(v[1], n, i) && '
                        'camera_calibration_parsers::writeCalibration(v[2], n, i)); }', "-lcamera_calibration_parsers")
        if not copy:
            return
        paths = []
        for camera in source["cameras"]:
            paths.append(os.path.join(rewritten, camera["name"] + ".yaml"))
            subprocess.run([copy, os.path.join(base, camera["name"] + ".yaml"), paths[-1]], check=True)
        out = os.path.join(folder, "back.yaml")
        convert(*paths, "-o", out, "--to", "teledimos")
        cameras = read_rig(out)["cameras"]
        px = max(apart(project(a, points()), project(b, points())) for a, b in zip(cameras, source["cameras"]))
        note("ROS camera_info", "theirs read by us", model, px, apart(pose_of(cameras[1]), pose_of(source["cameras"][1])))


def compiled(folder, name, code, *flags):
    source, program = os.path.join(folder, name + ".cpp"), os.path.join(folder, name)
    with open(source, "w") as file:
        file.write(code)
    done = subprocess.run(["c++", "-std=c++17", "-o", program, source, *flags], capture_output=True, text=True)
    if done.returncode:
        check(False, f"{name} does not compile: {next((line for line in done.stderr.splitlines() if 'error' in line), '')}")
        return None
    return program


# ---- mrcal ----

def mrcal_both_ways(folder, model):
    source = rig(model)
    convert(write_rig(folder, source), "-o", os.path.join(folder, "m-%s.cameramodel"))
    paths = [os.path.join(folder, f"m-{c['name']}.cameramodel") for c in source["cameras"]]
    models = [mrcal.cameramodel(path) for path in paths]
    px = max(apart(mrcal.project(points(), *m.intrinsics()), project(c, points())) for m, c in zip(models, source["cameras"]))
    pose = max(apart(m.extrinsics_Rt_fromref()[:3], pose_of(c)[:3, :3]) for m, c in zip(models, source["cameras"]))
    pose = max([pose] + [apart(m.extrinsics_Rt_fromref()[3], pose_of(c)[:3, 3]) for m, c in zip(models, source["cameras"])])
    note("mrcal cameramodel", "ours read by mrcal", model, px, pose)
    check(all(list(m.imagersize()) == [640, 480] for m in models), "mrcal: sizes")
    lens = {"pinhole": "LENSMODEL_PINHOLE", "brown5": "LENSMODEL_OPENCV5", "brown8": "LENSMODEL_OPENCV8"}[model]
    rt = [np.array([0.1, 0.2, -0.3, 0.5, -0.25, 1.0]), np.array([0.1, 0.25, -0.3, 0.4, -0.25, 1.0])]
    theirs = []
    for i, side in enumerate(["left", "right"]):
        m = mrcal.cameramodel(intrinsics=(lens, np.array(K[side] + D[model])), imagersize=(640, 480), extrinsics_rt_fromref=rt[i])
        theirs.append(os.path.join(folder, f"t-{side}.cameramodel"))
        m.write(theirs[-1])
    out = os.path.join(folder, "back.yaml")
    convert(*theirs, "-o", out, "--to", "teledimos")
    cameras = read_rig(out)["cameras"]
    read = [mrcal.cameramodel(path) for path in theirs]  # as they came through the file
    px = max(apart(project(c, points()), mrcal.project(points(), *m.intrinsics())) for c, m in zip(cameras, read))
    relative = mrcal.compose_Rt(read[1].extrinsics_Rt_fromref(), read[0].extrinsics_Rt_toref())
    note("mrcal cameramodel", "theirs read by us", model, px,
         max(apart(pose_of(cameras[1])[:3, :3], relative[:3]), apart(pose_of(cameras[1])[:3, 3], relative[3])))


def mrcal_files_as_shipped(folder):
    paths = [os.path.join(DATA, f"mrcal-cameramodels/opencv8-{i}.cameramodel") for i in range(2)]
    if not os.path.exists(paths[0]):
        skip("mrcal-cameramodels are not in TELEDIMOS_DATA")
        return
    out = os.path.join(folder, "shipped.yaml")
    convert(*paths, "-o", out, "--to", "teledimos")
    cameras = read_rig(out)["cameras"]
    models = [mrcal.cameramodel(path) for path in paths]
    px = max(apart(project(c, points()), mrcal.project(points(), *m.intrinsics())) for c, m in zip(cameras, models))
    relative = mrcal.compose_Rt(models[1].extrinsics_Rt_fromref(), models[0].extrinsics_Rt_toref())
    note("opencv8-*.cameramodel", "shipped, read by us", "brown8", px,
         max(apart(pose_of(cameras[1])[:3, :3], relative[:3]), apart(pose_of(cameras[1])[:3, 3], relative[3])))


# ---- Kalibr ----

def kalibr(folder, model):
    source = rig(model, distortion=D["brown5"][:4] + [0.0] if model == "brown5" else None)
    path, out = os.path.join(folder, "camchain.yaml"), os.path.join(folder, "back.yaml")
    convert(write_rig(folder, source), "-o", path)
    chain = read_rig(path)
    px = 0
    for i, camera in enumerate(source["cameras"]):
        c = chain[f"cam{i}"]
        check(c["camera_model"] == "pinhole" and c["resolution"] == [640, 480], f"Kalibr: cam{i} {c['distortion_model']}")
        d = c["distortion_coeffs"] or [0.0] * 4
        px = max(px, apart(project_opencv(matrix(c["intrinsics"]), d, points(), c["distortion_model"] == "equidistant"),
                           project(camera, points())))
    note("Kalibr camchain", "ours by its definition", model, px, apart(chain["cam1"]["T_cn_cnm1"], pose_of(source["cameras"][1])))
    convert(path, "-o", out, "--to", "teledimos")
    back = read_rig(out)["cameras"]
    note("Kalibr camchain", "there and back", model, max(apart(project(a, points()), project(b, points())) for a, b in zip(back, source["cameras"])),
         apart(pose_of(back[1]), pose_of(source["cameras"][1])))


# ---- ViSP ----

VISP = r'''
#include <visp3/core/vpXmlParserCamera.h>
#include <visp3/core/vpMeterPixelConversion.h>
#include <visp3/core/vpPixelMeterConversion.h>
#include <cstdio>
#include <cstdlib>
#include <cstring>
/* read FILE NAME MODEL: prints the pixels of points from standard input, and those that come back from them;
   write FILE NAME MODEL px py u0 v0 k…: writes. */
int main(int n, char **v) {
    vpXmlParserCamera parser; vpCameraParameters c; std::vector<double> k;
    for (int i = 9; i < n; i++) k.push_back(atof(v[i]));
    const vpCameraParameters::vpCameraParametersProjType type = v[4][0] == 'K' ? vpCameraParameters::ProjWithKannalaBrandtDistortion
        : v[4][0] == 'D' ? vpCameraParameters::perspectiveProjWithDistortion : vpCameraParameters::perspectiveProjWithoutDistortion;
    if (!strcmp(v[1], "write")) {
        const double px = atof(v[5]), py = atof(v[6]), u0 = atof(v[7]), v0 = atof(v[8]);
        if (v[4][0] == 'K') c.initProjWithKannalaBrandtDistortion(px, py, u0, v0, k);
        else if (v[4][0] == 'D') c.initPersProjWithDistortion(px, py, u0, v0, k[0], k[1]);
        else c.initPersProjWithoutDistortion(px, py, u0, v0);
        return parser.save(c, v[2], v[3], 640, 480) != vpXmlParserCamera::SEQUENCE_OK;
    }
    if (parser.parse(c, v[2], v[3], type, 640, 480) != vpXmlParserCamera::SEQUENCE_OK) return 1;
    double x, y, z, u, w, bx, by;
    while (scanf("%lf %lf %lf", &x, &y, &z) == 3) {
        vpMeterPixelConversion::convertPoint(c, x / z, y / z, u, w);
        vpPixelMeterConversion::convertPoint(c, u, w, bx, by);
        printf("%.17g %.17g %.17g\n", u, w, hypot((bx - x / z) * c.get_px(), (by - y / z) * c.get_py()));
    }
}
'''


def visp_both_ways(folder):
    if not os.path.exists("/usr/include/x86_64-linux-gnu/visp3/core/vpXmlParserCamera.h") or not shutil.which("c++"):
        skip("ViSP's own reader: libvisp-dev is not installed")
        return
    flags = subprocess.run(["pkg-config", "--cflags", "visp"], capture_output=True, text=True).stdout.split()
    program = compiled(folder, "visp", VISP, *[flag for flag in flags if flag[:2] in ("-I", "-D")], "-lvisp_core")
    if not program:
        return
    for model, letter, d in [("pinhole", "N", []), ("brown5", "D", [-0.2, 0.0, 0.0, 0.0, 0.0]), ("fisheye", "K", D["fisheye"])]:
        source = rig(model, ["left"], d)
        p = image_rays(d) if model == "brown5" else points()
        text = "\n".join(" ".join(repr(float(x)) for x in point) for point in p)
        path, out, theirs = [os.path.join(folder, f) for f in ("v.xml", "back.yaml", "t.xml")]
        told = convert(write_rig(folder, source), "-o", path)
        done = subprocess.run([program, "read", path, "left", letter], input=text, capture_output=True, text=True)
        rows = np.array([[float(x) for x in line.split()] for line in done.stdout.splitlines() if line[:1].isdigit() or line[:1] == "-"])
        if done.returncode or len(rows) != len(p):
            check(False, f"ViSP does not read ours: {done.stdout[:200]} {done.stderr[:200]}")
            continue
        expected = project(source["cameras"][0], p)
        note("ViSP XML", "ours read by ViSP", model, apart(rows[:, :2], expected))
        if model == "brown5":
            worst, said = rows[:, 2].max(), float(told.split("off by up to ")[1].split(" px")[0])
            check(0.95 * said < worst <= 1.02 * said, f"ViSP: its way back (kdu) is off by {worst:.3f} px, told {said} px")
        if os.path.exists(theirs):
            os.remove(theirs)
        k = [*d, 0.0] if model == "fisheye" else [-0.2, 0.21] if model == "brown5" else []
        subprocess.run([program, "write", theirs, "left", letter, *map(repr, K["left"] + k)], check=True, capture_output=True)
        convert(theirs, "-o", out, "--to", "teledimos")
        note("ViSP XML", "theirs read by us", model, apart(project(read_rig(out)["cameras"][0], p), expected))


def visp_files_as_shipped(folder):
    path = os.path.join(DATA, "visp-eye-in-hand/franka_camera.xml")
    if not os.path.exists(path):
        skip("visp-eye-in-hand is not in TELEDIMOS_DATA")
        return
    out = os.path.join(folder, "shipped.yaml")
    convert(path, "-o", out, "--to", "teledimos")
    camera = read_rig(out)["cameras"][0]
    wanted = [607.5931396484375, 607.574951171875, 323.46282958984375, 243.25529479980469]
    note("franka_camera.xml", "shipped, read by us", "pinhole", apart(list(camera["intrinsics"].values()), wanted))


# ---- poses alone ----

def pose_lines(folder):
    source = rig("pinhole")
    source["vehicle_from_rig"] = {"q": quaternion(cv2.Rodrigues(np.array([-1.2, 0.4, -1.3]))[0]), "t_m": [1.5, -0.25, 2.0]}
    path = write_rig(folder, source)
    wanted = {"left_optical_frame": np.linalg.inv(pose_of(source["cameras"][0])), "right_optical_frame": np.linalg.inv(pose_of(source["cameras"][1])),
              "rig": pose_of({"camera_from_rig": source["vehicle_from_rig"]})}
    lines = convert(path, "--to", "ros-tf").splitlines()
    check(len(lines) == 3 and lines[0].split()[7:] == ["vehicle", "rig"], "ros-tf: a line for each frame, parent and child last")
    for line in lines:
        words = line.split()
        x, y, z, qx, qy, qz, qw = map(float, words[:7])
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = rotation([qw, qx, qy, qz]), [x, y, z]
        check(apart(m, wanted[words[8]]) < 1e-14, f"ros-tf: {words[7]} from {words[8]} to {apart(m, wanted[words[8]]):.1e}")
    import xml.etree.ElementTree as ElementTree
    urdf = os.path.join(folder, "rig.urdf")
    convert(path, "-o", urdf)
    with open(urdf) as file:
        robot = ElementTree.fromstring(f"<robot name='r'>{file.read()}</robot>")
    check([link.get("name") for link in robot.findall("link")] == ["vehicle", "rig", "left_optical_frame", "right_optical_frame"], "urdf: links")
    for joint in robot.findall("joint"):
        origin, child = joint.find("origin"), joint.find("child").get("link")
        roll, pitch, yaw = map(float, origin.get("rpy").split())
        rx, ry, rz = [cv2.Rodrigues(a * np.eye(3)[i])[0] for i, a in enumerate((roll, pitch, yaw))]
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = rz @ ry @ rx, list(map(float, origin.get("xyz").split()))
        check(apart(m, wanted[child]) < 1e-14, f"urdf: {joint.find('parent').get('link')} from {child} to {apart(m, wanted[child]):.1e}")


# ---- approximations, refusals, usage ----

def approximations(folder):
    source = rig("brown5", ["left"])
    path = write_rig(folder, source)
    for name in ("camchain.yaml", "v.xml"):
        out = os.path.join(folder, "approximate-" + name)
        to = "kalibr" if "camchain" in name else "visp"
        common.refused(f"brown5 with k3 to {to}", 1, ["camera left", "off by up to", "px"], path, "--to", to, command="convert", out=out)
        check(not os.path.exists(out), f"{to}: nothing is written when it is refused")
        result = json.loads(convert(path, "--to", to, "-o", out, "--approximate", "--json"))
        convert(out, "-o", os.path.join(folder, "back.yaml"), "--to", "teledimos")
        camera = read_rig(os.path.join(folder, "back.yaml"))["cameras"][0]
        p = image_rays(D["brown5"])
        seen = np.max(np.linalg.norm(project(camera, p) - project(source["cameras"][0], p), axis=1))
        told = result["largest_error_px"]
        check(0.95 * told < seen < 1.02 * told and not result["exact"], f"{to}: brown5 approximated, off by {seen:.4f} px, told {told:.4f}")
        TABLE.append((to, "approximated", "brown5", seen, None))


def bad_use(folder):
    path = write_rig(folder, rig("brown5"))
    pinhole = write_rig(folder, rig("pinhole"), "p.yaml")
    common.refused("no such file", 1, ["gone.yml"], os.path.join(folder, "gone.yml"), "--to", "kalibr", command="convert")
    common.refused("no TO format", 2, ["--to FORMAT is missing"], path, command="convert")
    common.refused("unknown format", 2, ["colmap"], path, "--to", "colmap", command="convert")
    common.refused("one name for two files", 2, ["a file for each of the 2 cameras"], path, "--to", "ros", command="convert",
                   out=os.path.join(folder, "one.yaml"))
    common.refused("unknown camera", 1, ["has no camera middle", "left, right"], path, "--to", "opencv", "--camera", "middle", command="convert")
    empty, text = os.path.join(folder, "empty.yml"), os.path.join(folder, "text.yml")
    open(empty, "w").close()
    with open(text, "w") as file:
        file.write("not a rig\n")
    common.refused("empty file", 1, ["empty.yml", "is empty"], empty, "--to", "ros", command="convert")
    common.refused("no known format", 1, ["text.yml", "looks like no format"], text, "--to", "ros", command="convert")
    common.refused("no size", 1, ["does not tell the size"], os.path.join(DOCS, "data/intrinsics.yml"), "--to", "teledimos", "--camera", "left",
                   command="convert")
    visp = os.path.join(folder, "both.xml")
    convert(pinhole, "-o", visp)
    common.refused("poses not held", 1, ["poses of left, right"], visp, "--to", "opencv", command="convert")
    common.refused("two formats", 1, ["both.xml", "one format"], path, visp, "--to", "opencv", command="convert")
    status, output, _ = run("convert", "--schema")
    check(status == 0 and "largest_error_px" in output, "--schema lists the keys")


def main():
    with tempfile.TemporaryDirectory() as top:
        for model in D:
            storage = opencv_reads_ours(top, model)
            if model == "brown5":
                rectification_of_opencv(storage)
            for ending in ("yml", "xml", "json"):
                we_read_opencv(top, model, ending)
            if ros:
                ros_both_ways(top, model)
            if mrcal and model != "fisheye":
                mrcal_both_ways(top, model)
            if model != "brown8":
                kalibr(top, model)
        ros or skip("python3-camera-calibration-parsers is not installed")
        mrcal or skip("mrcal is not installed")
        opencv_files_as_shipped(top)
        many_cameras(top)
        if mrcal:
            mrcal_files_as_shipped(top)
        visp_both_ways(top)
        visp_files_as_shipped(top)
        pose_lines(top)
        approximations(top)
        bad_use(top)



main()
print(f"\n{'file':24} {'direction':28} {'model':8} {'largest error':>14} {'pose':>9}")
for file, direction, model, px, pose in TABLE:
    print(f"{file:24} {direction:28} {model:8} {px:11.1e} px {'' if pose is None else f'{pose:9.1e}'}")
common.finish()
