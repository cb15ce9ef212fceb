#!/bin/sh
# Builds libdmuca_daidalus.so beside this file from a checkout of NASA's DAIDALUS (version 2), which is not part of this
# project: its licence is NASA's open source agreement. Needs a C++ compiler; takes some minutes on one core.
#
#   ./build.sh FOLDER        # the checkout; it holds the folder C++
set -eu

here=$(cd "$(dirname "$0")" && pwd)
source=${1:?usage: build.sh FOLDER of a checkout of DAIDALUS 2}/C++
[ -e "$source/include/Daidalus.h" ] || { echo "build.sh: $source/include/Daidalus.h is missing" >&2; exit 1; }
objects=$(mktemp -d)
trap 'rm -rf "$objects"' EXIT
for file in "$source"/src/*.cpp; do
    "${CXX:-g++}" -O2 -fPIC -w -I"$source/include" -c "$file" -o "$objects/$(basename "$file" .cpp).o"
done
"${CXX:-g++}" -O2 -fPIC -w -shared -I"$source/include" "$here/shim.cpp" "$objects"/*.o -o "$here/libdmuca_daidalus.so"
echo "$here/libdmuca_daidalus.so"
