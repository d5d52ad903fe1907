#!/bin/sh
# Proves: the installed tree is enough for an outside C project, by CMake package and by pkg-config, and for running the
# commands from any folder; shared libraries export td_ names only.
set -eu
source=$1 build=$2 work=$3
rm -rf "$work"
mkdir -p "$work"
cmake --install "$build" --prefix "$work/prefix" >"$work/install.log"
cat >"$work/rig.yaml" <<'RIG'
teledimos: rig 1
cameras:
  - name: left
    model: pinhole
    width: 640
    height: 480
    intrinsics: {fx: 500, fy: 500, cx: 320, cy: 240}
    distortion: {}
    camera_from_rig: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}
  - name: right
    model: pinhole
    width: 640
    height: 480
    intrinsics: {fx: 500, fy: 500, cx: 320, cy: 240}
    distortion: {}
    camera_from_rig: {q: [1, 0, 0, 0], t_m: [-0.25, 0, 0]}
RIG
echo "== CMake package"
cmake -G Ninja -S "$source/tests/install" -B "$work/cmake" -DCMAKE_PREFIX_PATH="$work/prefix" -DCMAKE_BUILD_TYPE=Release >"$work/cmake.log"
cmake --build "$work/cmake" >>"$work/cmake.log"
"$work/cmake/outside" "$work/rig.yaml" | grep -x 'baseline 0.250000 m'
echo "== pkg-config"
export PKG_CONFIG_PATH="$(dirname "$(find "$work/prefix" -name teledimos_calib.pc)")"
cc -std=c17 "$source/tests/install/main.c" -o "$work/by_pkg_config" $(pkg-config --cflags --libs teledimos_calib) -lm
LD_LIBRARY_PATH="$(pkg-config --variable=libdir teledimos_calib)" "$work/by_pkg_config" "$work/rig.yaml" | grep -x 'baseline 0.250000 m'
echo "== exported names"
libraries=$(find "$work/prefix" -name 'libteledimos_*.so')
[ "$(echo "$libraries" | wc -l)" -ge 3 ] || { echo "libraries are missing: $libraries"; exit 1; }
for library in $libraries; do
    foreign=$(nm -D --defined-only "$library" | awk '{print $3}' | grep -vE '^td_' | grep -vE '^_Z(T[ISV]|N|ZN|St|G)|^_(init|fini|edata|end)$|^__' || true)
    [ -z "$foreign" ] || { echo "$library exports $foreign"; exit 1; }
done
echo "== commands"
cd /
"$work/prefix/bin/teledimos" --version
"$work/prefix/bin/teledimos" calibrate --help >/dev/null
test -s "$work/prefix/share/man/man1/teledimos-calibrate.1"
test -f "$work/prefix/share/teledimos/panel/index.html"
test -f "$work/prefix/share/teledimos/datasets/opencv-stereo/dataset.yaml"
echo "the installation works"
