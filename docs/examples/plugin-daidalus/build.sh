#!/bin/sh
# Builds libdmuca_daidalus.so beside this file from a checkout of NASA's DAIDALUS (version 2), which is not part of this
# project: its licence is NASA's open source agreement. Needs a C++ compiler; takes some minutes on one core.
# Contractions stay off, so that the library decides the same on every machine.
#
#   ./build.sh FOLDER        # the checkout; it holds the folder C++
set -eu

here=$(cd "$(dirname "$0")" && pwd)
source=${1:?usage: build.sh FOLDER of a checkout of DAIDALUS 2}/C++
[ -e "$source/include/Daidalus.h" ] || { echo "build.sh: $source/include/Daidalus.h is missing" >&2; exit 1; }
"${CXX:-g++}" -O3 -flto=auto -ffp-contract=off -fPIC -fvisibility=hidden -static-libstdc++ -static-libgcc -Wl,--exclude-libs,ALL -w -shared \
    -I"$source/include" "$here/shim.cpp" "$source"/src/*.cpp -o "$here/libdmuca_daidalus.so"
echo "$here/libdmuca_daidalus.so"
