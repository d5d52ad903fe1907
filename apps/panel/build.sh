#!/bin/sh
# Builds the operator's page: sh apps/panel/build.sh WORK OUT. Node's packages go into WORK, the page into OUT.
set -eu
source=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1" "$2"
work=$(cd "$1" && pwd)
out=$(cd "$2" && pwd)
rm -rf "$work/src" "$work/dist"
cp -R "$source/src" "$source/index.html" "$source/package.json" "$source/package-lock.json" "$source/.npmrc" \
    "$source/tsconfig.json" "$source/vite.config.ts" "$work"
cd "$work"
if ! cmp -s package-lock.json node_modules/.installed; then
    npm ci --ignore-scripts
    cp package-lock.json node_modules/.installed
fi
npm run --silent check
npm run --silent build
for package in three uplot; do # what is built in, under terms of its own
    echo "$package"
    echo
    cat "node_modules/$package/LICENSE"
    echo
done >dist/licences.txt
rm -f "$out"/*
cp dist/* "$out"
