#!/bin/sh
# Installs what is missing, builds twice (optimised; with AddressSanitizer and UndefinedBehaviorSanitizer) and runs the
# tests. On Debian 12; can be run again and again.
#   sh tests/run.sh          everything that takes minutes (under 15 on 2 cores)
#   sh tests/run.sh --full   besides: full Monte Carlo counts, long fuzzing, benchmarks
# Real data that the tests can use besides Debian's packages is looked for in the folder named by TELEDIMOS_DATA.
set -eu
cd "$(dirname "$0")/.."
full=0
for argument in "$@"; do
    case "$argument" in
    --full) full=1 ;;
    *)
        echo "usage: sh tests/run.sh [--full]" >&2
        exit 2
        ;;
    esac
done
. apps/install.sh
td_install "$TD_BUILD_PACKAGES libcmocka-dev clang libclang-rt-14-dev python3 python3-opencv python3-numpy python3-yaml groff-base libxml2-utils mrpt-common python3-camera-calibration-parsers libcamera-calibration-parsers-dev liborocos-kdl-dev dart-doc gdal-bin python3-gdal assimp-utils spin openssl iproute2"
td_install_data
[ "$full" -eq 1 ] && td_install "mrcal chromium nodejs npm python3-scipy libdart-dev"
if [ -n "${TELEDIMOS_DATA:-}" ]; then
    TELEDIMOS_DATA=$(cd "$TELEDIMOS_DATA" && pwd)
    export TELEDIMOS_DATA
fi
export TELEDIMOS_FULL=$full OPENBLAS_NUM_THREADS=1

echo "== building (build/release)"
cmake --preset release -DTELEDIMOS_TESTS=ON
cmake --build --preset release
echo "== building with sanitizers (build/debug)"
cmake --preset debug
cmake --build --preset debug

echo "== tests, optimised"
ctest --preset release -j 2
echo "== tests, sanitized"
TELEDIMOS_FULL=0 ctest --preset debug -j 2 -LE slow
echo "== fuzzing"
sh tests/fuzz/run.sh "$([ "$full" -eq 1 ] && echo 120 || echo 5)"
if [ "$full" -eq 1 ]; then
    echo "== benchmarks"
    build/release/bin/teledimos-bench
fi
echo "== all tests passed"
