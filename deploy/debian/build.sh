#!/bin/sh
# Builds dmuca-companion_VERSION_ARCHITECTURE.deb from the wheel, for the Debian version and the architecture on which it
# runs. docs/packages.md says how to use it. It needs root, python3-venv and the network; /opt/dmuca must not exist.
#
#   deploy/debian/build.sh WHEEL FOLDER
set -eu

usage="usage: deploy/debian/build.sh WHEEL FOLDER"
here=$(cd "$(dirname "$0")" && pwd)
wheel=$(realpath "${1:?$usage}") folder=$(realpath "${2:?$usage}")
[ "$(id -u)" = 0 ] || { echo "build.sh: run it as root, because it writes the files of the package to /opt/dmuca"; exit 1; }
[ ! -e /opt/dmuca ] || { echo "build.sh: /opt/dmuca exists; run it on a system without an installation there"; exit 1; }

root=$(mktemp -d)
trap 'rm -rf "$root" /opt/dmuca' EXIT
# Build it in its final folder, because the scripts of a virtual environment contain the path of their interpreter.
python3 -m venv /opt/dmuca/.venv
/opt/dmuca/.venv/bin/pip install --quiet --no-cache-dir --only-binary=:all: "$wheel"
version=$(/opt/dmuca/.venv/bin/companion --version | cut -d ' ' -f 2)
python=$(python3 -c 'import sys; print(sys.version_info.minor)')

mkdir -p "$root/opt"
cp -a /opt/dmuca "$root/opt/dmuca"
install -D -m 644 "$here/../dmuca-companion.service" "$root/usr/lib/systemd/system/dmuca-companion.service"
install -D -m 644 "$here/../99-dmuca.rules" "$root/usr/lib/udev/rules.d/99-dmuca.rules"
install -d "$root/usr/bin" "$root/usr/share/doc/dmuca-companion" "$root/DEBIAN"
for command in companion ground-tools sitl-mocks; do
    ln -s "/opt/dmuca/.venv/bin/$command" "$root/usr/bin/$command"
done
cp "$here/copyright" "$root/usr/share/doc/dmuca-companion/copyright"
sed -e "s/@VERSION@/$version/" -e "s/@ARCHITECTURE@/$(dpkg --print-architecture)/" \
    -e "s/@PYTHON@/3.$python/" -e "s/@NEXT_PYTHON@/3.$((python + 1))/" \
    -e "s/@SIZE@/$(du -sk "$root" | cut -f 1)/" "$here/control" >"$root/DEBIAN/control"
for script in preinst postinst prerm postrm; do
    install -m 755 "$here/$script" "$root/DEBIAN/$script"
done
dpkg-deb --root-owner-group -Zgzip -z1 --build "$root" "$folder"
