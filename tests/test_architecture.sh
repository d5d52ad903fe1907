#!/bin/sh
# Proves: a wing includes core/ and itself only, core/ no wing; C++ stands only behind walls; libraries neither print nor
# exit; public headers hold no foreign C++ type and compile alone, as C and as C++.
# Blind to: what is reached without an #include.
set -eu
cd "$1"
fail=0
complain() {
    echo "FAILED: $1"
    echo "$2"
    fail=1
}
wings="calib recon servo sim"
for wing in $wings; do
    [ -d "$wing" ] || continue
    others=$(for other in $wings apps; do [ "$other" = "$wing" ] || printf '%s|' "$other"; done)
    found=$(grep -rnE "#include *[\"<](\.\./)?(teledimos/)?(${others%|})/" "$wing" --include='*.[ch]' --include='*.cpp' || true)
    [ -z "$found" ] || complain "$wing/ includes another wing" "$found"
done
found=$(grep -rnE '#include *["<](\.\./)?(teledimos/)?(calib|recon|servo|sim|apps)/' core --include='*.[ch]' --include='*.cpp' || true)
[ -z "$found" ] || complain "core/ includes a wing" "$found"
found=$(grep -rnE '#include "core/[a-z_]+_internal\.h"' $(ls -d $wings apps 2>/dev/null) --include='*.[ch]' --include='*.cpp' || true)
[ -z "$found" ] || complain "what is internal to core/ is used outside" "$found"
found=$(find core $wings apps -name '*.cpp' 2>/dev/null | grep -vE '_(visp|opencv|ceres|urdfdom|cgal)\.cpp$' || true)
[ -z "$found" ] || complain "C++ outside the walls" "$found"
found=$(grep -nE '\b(printf|puts|putchar|perror|exit|abort) *\(' $(find core $wings -name "*.c" -o -name "*.cpp" 2>/dev/null) | grep -vE 'snprintf' || true)
[ -z "$found" ] || complain "a library that prints or exits" "$found"
for header in $(find core $wings -name "*.h" 2>/dev/null | sort); do
    case "$header" in *_internal.h) continue ;; esac
    echo "#include \"$header\"" >"$2/header.c"
    cp "$2/header.c" "$2/header.cpp"
    cc -std=c17 -D_POSIX_C_SOURCE=200809L -Wall -Wextra -Werror -I. -fsyntax-only "$2/header.c" || complain "$header does not compile alone as C" ""
    c++ -std=c++17 -Wall -Wextra -Werror -I. -fsyntax-only "$2/header.cpp" || complain "$header does not compile alone as C++" ""
done
[ "$fail" -eq 0 ] && echo "the rules hold"
exit "$fail"
