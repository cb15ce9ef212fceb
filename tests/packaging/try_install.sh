#!/bin/sh
# Installs the wheel by pip in empty Debian systems and runs the first commands of the docs there, as a user without
# rights and without a network.
#
#   tests/packaging/try_install.sh WHEEL [SYSTEM...]     systems: bookworm-amd64 trixie-amd64 bookworm-arm64
#
# It needs root, mmdebstrap, and for arm64 on other computers qemu-user-static with binfmt-support. Without one of
# these it says so and exits with 77. `make packages` runs it for all systems.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=systems.sh
. "$here/systems.sh"
wheel=$(realpath "${1:?usage: try_install.sh WHEEL [SYSTEM...]}")
shift
[ "$(id -u)" = 0 ] || skip "a system in a folder of its own needs root"
needs mmdebstrap unshare ip chroot
[ $# -gt 0 ] || set -- bookworm-amd64 trixie-amd64 bookworm-arm64

WORK=$(mktemp -d "${TMPDIR:-/tmp}/dmuca-install-XXXXXX")
trap 'rm -rf --one-file-system "$WORK"' EXIT
skipped=
for system in "$@"; do
    if ! runs_here "${system#*-}"; then
        echo "SKIPPED: $system: no program for ${system#*-} runs here: install qemu-user-static and binfmt-support"
        skipped=yes
        continue
    fi
    root=$WORK/$system
    fresh_system "$system" "$root" python3-venv ca-certificates
    cp "$wheel" "$here/first_commands.sh" "$root/home/pilot/"
    began=$(date +%s)
    within "$root" 1000 sh -ec 'cd && python3 -m venv dmuca && dmuca/bin/pip install --quiet --no-cache-dir ./*.whl'
    echo "$system: $(within "$root" 1000 python3 --version), installed in $(($(date +%s) - began)) s," \
        "$(du -sm "$root/home/pilot/dmuca" | cut -f 1) MB"
    ALONE=yes within "$root" 1000 sh /home/pilot/first_commands.sh
    rm -rf --one-file-system "$root"
done
[ -z "$skipped" ] || exit $NOT_TRIED
