#!/bin/sh
# Fuzzes every parser with libFuzzer for SECONDS each, from the seeds in tests/fuzz/seeds and what earlier runs found.
#   sh tests/fuzz/run.sh SECONDS
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-5}
CC=clang CXX=clang++ cmake -G Ninja -S . -B build/fuzz -DCMAKE_BUILD_TYPE=RelWithDebInfo -DTELEDIMOS_SANITIZE=ON \
    -DTELEDIMOS_FUZZ=ON -DTELEDIMOS_WERROR=OFF -DCMAKE_C_FLAGS=-fsanitize=fuzzer-no-link >build/fuzz.log 2>&1 ||
    { cat build/fuzz.log; exit 1; }
targets=$(basename -a -s .c tests/fuzz/fuzz_*.c)
cmake --build build/fuzz --target $targets >>build/fuzz.log 2>&1 || { cat build/fuzz.log; exit 1; }
for target in $targets; do
    corpus=build/fuzz/corpus/$target
    seeds=tests/fuzz/seeds/${target#fuzz_}
    mkdir -p "$corpus"
    [ -d "$seeds" ] || seeds=
    dictionary=tests/fuzz/$target.dict
    [ -f "$dictionary" ] && dictionary=-dict=$dictionary || dictionary=
    ASAN_OPTIONS=allocator_may_return_null=1 "build/fuzz/tests/$target" -max_total_time="$seconds" -max_len=65536 -timeout=10 \
        -rss_limit_mb=2048 -artifact_prefix="build/fuzz/$target-" -verbosity=0 -print_final_stats=1 $dictionary "$corpus" $seeds \
        >"build/fuzz/$target.log" 2>&1 || { tail -40 "build/fuzz/$target.log"; echo "FAILED: $target"; exit 1; }
    echo "$target: $(sed -n 's/^stat::number_of_executed_units: *//p' "build/fuzz/$target.log") inputs in $seconds s, no finding"
done
