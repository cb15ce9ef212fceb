#!/bin/sh
# Builds the Debian package in one empty Debian system, installs it in another, starts the companion there with the
# command line, user and environment of its systemd unit against the mock vehicle, asks for its status and removes
# the package again.
#
#   tests/packaging/try_deb.sh WHEEL [SYSTEM]            system: bookworm-amd64 (default), trixie-amd64
#
# It needs root and mmdebstrap, and exits with 77 without them. DEB names a folder where the package is kept.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=systems.sh
. "$here/systems.sh"
wheel=$(realpath "${1:?usage: try_deb.sh WHEEL [SYSTEM]}")
system=${2:-bookworm-amd64}
[ "$(id -u)" = 0 ] || skip "a system in a folder of its own needs root"
needs mmdebstrap unshare ip chroot

WORK=$(mktemp -d "${TMPDIR:-/tmp}/dmuca-deb-XXXXXX")
trap 'rm -rf --one-file-system "$WORK"' EXIT

builds=$WORK/builds
fresh_system "$system" "$builds" python3-venv ca-certificates
mkdir "$builds/source" "$builds/out"
cp "$wheel" "$builds/source/"
cp -r "$here/../../deploy" "$builds/source/deploy"
within "$builds" 0 sh -c '/source/deploy/debian/build.sh /source/*.whl /out'
package=$(ls "$builds"/out/*.deb)
ls -l "$package"
[ -z "${DEB:-}" ] || cp "$package" "$DEB/"

takes=$WORK/takes
fresh_system "$system" "$takes" python3
mkdir -p "$takes/tmp"
cp "$package" "$here/first_flight.sh" "$takes/tmp/"
ALONE=yes within "$takes" 0 sh -ec 'dpkg --install /tmp/*.deb; sh /tmp/first_flight.sh
    dpkg --remove dmuca-companion
    [ ! -e /opt/dmuca ] || { find /opt/dmuca | head; echo "FAILED: files are left"; exit 1; }
    [ -e /etc/dmuca/companion.toml ]
    dpkg --purge dmuca-companion
    [ ! -e /etc/dmuca ] && [ ! -e /var/lib/dmuca ]'
echo "ok: $(basename "$package") on $system"
