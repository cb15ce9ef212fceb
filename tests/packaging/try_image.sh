#!/bin/sh
# Builds the container image and starts the companion in it against the mock vehicle: no root inside, healthy as its
# own health check sees it.
#
#   tests/packaging/try_image.sh WHEEL [ARCHITECTURE]    amd64 (default: this computer's) or arm64
#
# It needs docker with its daemon, or podman as root, and exits with 77 without them. BASE=trixie takes a base image
# made here from Debian's packages (mmdebstrap) instead of the one that the Dockerfile names, where no registry of
# images can be reached. CONTAINER_OPTIONS go before the command, BUILD_OPTIONS after `build`, RUN_OPTIONS after `run`.
# Podman in a container of its own, with both versions of cgroups and without systemd, needed:
#   CONTAINER_OPTIONS="--cgroup-manager=cgroupfs --runtime=runc" BUILD_OPTIONS=--isolation=chroot
#   RUN_OPTIONS="--ulimit nofile=1024:1024 --ulimit nproc=1000:1000"
set -eu

here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=systems.sh
. "$here/systems.sh"
wheel=$(realpath "${1:?usage: try_image.sh WHEEL [ARCHITECTURE]}")
architecture=${2:-$(dpkg --print-architecture)}
if docker info >/dev/null 2>&1; then
    tool=docker
elif command -v podman >/dev/null && [ "$(id -u)" = 0 ]; then
    tool="podman ${CONTAINER_OPTIONS:-}"
else
    skip "no docker daemon answers, and podman is not installed or not run by root"
fi

WORK=$(mktemp -d "${TMPDIR:-/tmp}/dmuca-image-XXXXXX")
name=dmuca-try-$$
# shellcheck disable=SC2086 # the tool may have options
ended() {
    $tool rm -f $name $name-vehicle $name-air >/dev/null 2>&1 || true
    $tool volume rm -f $name-config >/dev/null 2>&1 || true
    $tool rmi -f $name $name-base >/dev/null 2>&1 || true
    rm -rf --one-file-system "$WORK"
}
trap ended EXIT
set -- --file "$here/../../deploy/container/Dockerfile" --tag $name --platform "linux/$architecture"
[ "$tool" = docker ] || set -- "$@" --format docker # the other format has no health check
if [ -n "${BASE:-}" ]; then
    needs mmdebstrap
    fresh_system "$BASE-$architecture" "$WORK/base" python3-venv ca-certificates
    # shellcheck disable=SC2086
    tar -C "$WORK/base" -c . | $tool import -c "ENV PATH=/usr/bin:/bin:/usr/sbin" - $name-base
    set -- "$@" --from $name-base --network host
fi
mkdir "$WORK/dist"
cp "$wheel" "$WORK/dist/"
# shellcheck disable=SC2086
$tool build "$@" ${BUILD_OPTIONS:-} "$WORK/dist"

cat >"$WORK/start.sh" <<'END'
set -eu
tool=$1 name=$2
# shellcheck disable=SC2086
run() { $tool run ${RUN_OPTIONS:-} --network host --volume $name-config:/etc/dmuca "$@"; }
run --rm $name init --px4 --radio ether=127.0.0.1:14640 --region us --uas-id 1596B0000DMUCA77 --out /etc/dmuca/companion.toml
user=$(run --rm --entrypoint id $name -u)
[ "$user" != 0 ] || { echo "FAILED: it runs as root"; exit 1; }
run --detach --name $name-vehicle --entrypoint sitl-mocks $name serve --firmware px4 --link udpout:127.0.0.1:14540 --airborne 50
run --detach --name $name-air --entrypoint sitl-mocks $name ether --listen 127.0.0.1:14640
until $tool logs $name-vehicle 2>&1 | grep -q ready && $tool logs $name-air 2>&1 | grep -q 'ether on'; do sleep 1; done
run --detach --name $name $name
tries=0
until $tool exec $name companion status --once; do
    tries=$((tries + 1))
    if [ $tries -gt 300 ]; then
        $tool logs $name
        echo "FAILED: no status"
        exit 1
    fi
    sleep 2
done
case $tool in
    docker) $tool inspect --format '{{.State.Health.Status}}' $name ;;
    *) $tool healthcheck run $name ;;
esac
$tool stop --time 30 $name
[ "$($tool inspect --format '{{.State.ExitCode}}' $name)" = 0 ] || { $tool logs $name; echo "FAILED: no clean end"; exit 1; }
echo "ok: user $user, stopped with exit code 0"
END
# A daemon has a network of its own; podman's containers get the loopback device of a network made for them.
if [ "$tool" = docker ]; then
    sh "$WORK/start.sh" "$tool" $name
else
    unshare --net sh -ec 'ip link set lo up; exec sh "$@"' sh "$WORK/start.sh" "$tool" $name
fi
