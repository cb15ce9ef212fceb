# shellcheck shell=sh
# Empty Debian systems in folders, for the scripts beside this file, which source it.
#
# A system is named SUITE-ARCHITECTURE, such as bookworm-amd64. KEEP_SYSTEMS may name a folder where fresh systems
# are kept as archives; without it each run downloads them again.

NOT_TRIED=77 # the exit code that means: skipped, because something is missing here

skip() {
    echo "SKIPPED: $*"
    exit $NOT_TRIED
}

needs() {
    for program in "$@"; do
        command -v "$program" >/dev/null || skip "$program is not installed"
    done
}

# Whether programs of an architecture run here, natively or by emulation.
runs_here() {
    [ "$(dpkg --print-architecture)" = "$1" ] && return
    [ "$1" = arm64 ] && grep -qs enabled /proc/sys/fs/binfmt_misc/qemu-aarch64
}

# fresh_system SYSTEM FOLDER PACKAGE...: puts a Debian with these packages and nothing else into the folder.
# A system of another architecture is only unpacked: under emulation its maintainer scripts take very long, and
# nothing that is tried here needs what they do.
fresh_system() {
    system=$1 folder=$2
    shift 2
    suite=${system%-*} architecture=${system#*-}
    runs_here "$architecture" || skip "no program for $architecture runs here: install qemu-user-static and binfmt-support"
    archive=${KEEP_SYSTEMS:-$WORK}/$system-$(echo "$*" | cksum | cut -d ' ' -f 1).tar
    if [ ! -s "$archive" ]; then
        variant=minbase more=
        if [ "$architecture" != "$(dpkg --print-architecture)" ]; then
            variant=extract more=,base-files,base-passwd,bash,coreutils,dash,grep,libc-bin,libstdc++6,login,passwd,sed
        fi
        # Named, because only a target that ends in .tar would be taken for an archive.
        mmdebstrap --quiet --format=tar --variant="$variant" --architectures="$architecture" --dpkgopt=force-unsafe-io \
            --include="$(echo "$*" | tr ' ' ,)$more" "$suite" "$archive.part"
        mv "$archive.part" "$archive"
    fi
    mkdir -p "$folder"
    tar -C "$folder" -xf "$archive"
    mkdir -p "$folder/etc" "$folder/proc" "$folder/dev"
    [ -e "$folder/etc/passwd" ] || cp "$folder/usr/share/base-passwd/passwd.master" "$folder/etc/passwd"
    [ -e "$folder/etc/group" ] || cp "$folder/usr/share/base-passwd/group.master" "$folder/etc/group"
    echo "pilot:x:1000:1000:Pilot:/home/pilot:/bin/bash" >>"$folder/etc/passwd"
    echo "pilot:x:1000:" >>"$folder/etc/group"
    install -d -o 1000 -g 1000 "$folder/home/pilot"
    cat /etc/resolv.conf >"$folder/etc/resolv.conf"
    # Certificates as on this computer, which may reach the network through a proxy of its own.
    mkdir -p "$folder/etc/ssl/certs"
    cat "${SSL_CERT_FILE:-/etc/ssl/certs/ca-certificates.crt}" >"$folder/etc/ssl/certs/ca-certificates.crt"
}

# within FOLDER UID COMMAND...: runs a command in the system, in process and mount namespaces of its own, so that
# nothing of it is left when it ends. ALONE=yes leaves it nothing of the network but a loopback device.
within() {
    folder=$1 user=$2
    shift 2
    home=/root
    [ "$user" = 0 ] || home=/home/pilot
    set -- chroot --userspec="$user:$user" "$folder" env -i PATH=/usr/bin:/bin:/usr/sbin:/sbin HOME="$home" \
        LANG=C.UTF-8 PIP_CERT=/etc/ssl/certs/ca-certificates.crt PIP_DISABLE_PIP_VERSION_CHECK=1 \
        ${PIP_INDEX_URL:+"PIP_INDEX_URL=$PIP_INDEX_URL"} ${https_proxy:+"https_proxy=$https_proxy"} "$@"
    # shellcheck disable=SC2016 # the inner shell expands them
    unshare --mount --pid --fork --kill-child ${ALONE:+--net} sh -ec '
        mount --rbind /dev "$1/dev"
        mount -t proc proc "$1/proc"
        [ -z "$2" ] || ip link set lo up
        shift 2
        exec "$@"' sh "$folder" "${ALONE:-}" "$@"
}
