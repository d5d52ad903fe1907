#!/bin/sh
# Installs what is missing, builds, calibrates OpenCV's stereo pairs, reconstructs a real pair,
# predicts a motion, and rehearses a trench in the closed loop. On Debian 12; can be run again and again.
set -eu
cd "$(dirname "$0")/.."
. apps/install.sh
td_install "$TD_BUILD_PACKAGES"
td_install_data

echo "== building (build/release)"
cmake --preset release -DTELEDIMOS_TESTS=OFF >build-demo.log 2>&1 || { cat build-demo.log; rm -f build-demo.log; exit 1; }
rm -f build-demo.log
cmake --build --preset release
PATH="$PWD/build/release/bin:$PATH"
export PATH

echo "== teledimos calibrate datasets/opencv-stereo -o out/opencv-stereo"
teledimos calibrate datasets/opencv-stereo -o out/opencv-stereo
echo
echo "== teledimos calibrate datasets/visp-marks -o out/visp-marks"
teledimos calibrate datasets/visp-marks -o out/visp-marks
echo
echo "== teledimos rectify datasets/opencv-stereo --rig out/opencv-stereo/rig.yaml -o out/rectified"
teledimos rectify datasets/opencv-stereo --rig out/opencv-stereo/rig.yaml -o out/rectified
echo
echo "== teledimos convert out/opencv-stereo/rig.yaml --to ros-tf"
teledimos convert out/opencv-stereo/rig.yaml --to ros-tf
echo
echo "== teledimos hand-eye datasets/hand-eye-stereo -o out/hand-eye"
teledimos hand-eye datasets/hand-eye-stereo -o out/hand-eye
echo
echo "== teledimos vehicle datasets/zx200-stick -o out/vehicle"
teledimos vehicle datasets/zx200-stick -o out/vehicle
echo
echo "== teledimos reconstruct datasets/aloe --near 0.55 --far 2.2 --cell 0.002 -o out/aloe"
teledimos reconstruct datasets/aloe --near 0.55 --far 2.2 --cell 0.002 -o out/aloe
echo
echo "== teledimos simulate datasets/zx200-motion -o out/motion"
teledimos simulate datasets/zx200-motion -o out/motion
echo
echo "== teledimos rehearse datasets/zx200/trench.yaml -o out/trench"
teledimos rehearse datasets/zx200/trench.yaml -o out/trench
echo
echo "Done. Open the reports: $PWD/out/opencv-stereo/report.html, $PWD/out/aloe/report.html, $PWD/out/trench/report.html"
