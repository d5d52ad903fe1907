"""Proves: our projected uncertainty is mrcal's on the same corners, noise and model, on OpenCV's stereo pairs: the left
camera alone, and the pair.

Reference: mrcal.projection_uncertainty on the model that mrcal's own program solves for from our corners (no outlier
rejection, warp or regularisation, as our --plain), with our noise as its observed_pixel_uncertainty. Both propagate the
noise by the same linear formula, so they differ only by where the two solvers stop (1e-5 of a sigma) and by our prior of
width 50 on the distortion: 0.1 % is allowed. mrcal's own estimate of the noise (the residuals' spread over all
coordinates, not over the degrees of freedom) and its default solve (warp, regularisation) are printed beside. Blind to:
whether the method itself is right, which the Monte Carlo test of the library shows. Skips when mrcal is missing.
"""

import json
import os
import shutil
import subprocess
import tempfile

import numpy

from common import SOURCE, check, finish, skip

HELPER = os.path.join(os.environ.get("TELEDIMOS_TESTS", ""), "print_uncertainty")
OPENCV_SET = os.path.join(SOURCE, "datasets/opencv-stereo")
PLAIN = ("--skip-regularization", "--skip-outlier-rejection", "--skip-calobject-warp-solve")


def ours(cameras, *how):
    done = subprocess.run([HELPER, OPENCV_SET, str(cameras), *how], capture_output=True, text=True)
    if done.returncode:
        check(False, f"print_uncertainty: {done.stderr.strip()}")
        return None
    return json.loads(done.stdout)


def mrcal_models(mrcal, points, cameras, how):
    """mrcal's program on the corners: a model for each camera, that knows its optimization."""
    with tempfile.TemporaryDirectory() as folder:
        vnl = os.path.join(folder, "corners.vnl")
        with open(vnl, "w") as file:
            file.write("# filename x y level\n")
            for name, x, y in sorted(points, key=lambda point: point[0]):  # sorted() keeps the order within an image
                file.write(f"{name}.jpg {x:.17g} {y:.17g} 0\n")
        subprocess.run(["mrcal-calibrate-cameras", "--corners-cache", vnl, "--lensmodel", "LENSMODEL_OPENCV5", "--focal",
                        "530", "--imagersize", "640", "480", "--object-spacing", "0.025", "--object-width-n", "9",
                        "--object-height-n", "6", *how, "--outdir", folder, *["left*.jpg", "right*.jpg"][:cameras]],
                       check=True, capture_output=True)
        return [mrcal.cameramodel(os.path.join(folder, f"camera-{k}.cameramodel")) for k in range(cameras)]


def mrcal_sigma(mrcal, model, query, noise_px):
    far = query["distance_m"] is None
    ray = mrcal.unproject(numpy.array(query["pixel"], float), *model.intrinsics(), normalize=True)
    return float(mrcal.projection_uncertainty(ray * (1 if far else query["distance_m"]), model=model, atinfinity=far,
                                              what="worstdirection-stdev", observed_pixel_uncertainty=noise_px))


def worst(covariance):
    return float(numpy.sqrt(numpy.linalg.eigvalsh(numpy.reshape(covariance, (2, 2)))[1]))


def compare(mrcal, cameras, what):
    plain, default = ours(cameras, "plain"), ours(cameras)
    if not plain or not default:
        return
    models = mrcal_models(mrcal, plain["points"], cameras, PLAIN)
    usual = mrcal_models(mrcal, plain["points"], cameras, ())
    noise = plain["noise_px"][0]
    print(f"{what}: noise {noise:.4f} px; sigma in the worst direction, px: ours and mrcal's by the same solve | ours and "
          "mrcal's by default")
    largest = 0
    for q, r in zip(plain["queries"], default["queries"]):
        k = q["camera"]
        a, b = worst(q["covariance"]), mrcal_sigma(mrcal, models[k], q, noise)
        c, d = worst(r["covariance"]), mrcal_sigma(mrcal, usual[k], r, None)
        largest = max(largest, abs(a / b - 1))
        distance = "infinity" if q["distance_m"] is None else f"{q['distance_m']:.1f} m"
        print(f"    camera {k} ({q['pixel'][0]:3.0f}, {q['pixel'][1]:3.0f}) {distance:>8}: {a:.4f} {b:.4f} | {c:.4f} {d:.4f}")
    check(largest <= 0.001, f"{what}: {len(plain['queries'])} sigmas within {100 * largest:.3f} % <= 0.1 % of mrcal's")


def main():
    try:
        import mrcal
    except ImportError:
        mrcal = None
    if mrcal is None or not shutil.which("mrcal-calibrate-cameras"):
        skip("mrcal is not installed")
    elif not os.path.exists(HELPER):
        skip(f"{HELPER} is not built")
    else:
        compare(mrcal, 1, "left camera")
        compare(mrcal, 2, "pair")
    finish()


main()
