#!/bin/sh
# Installs the wheel with the oldest versions that it allows of what it needs, runs the first commands of the docs
# there, and the checkout's tests of the companion and of the mocks.
#
#   tests/packaging/try_lowest.sh WHEEL
#
# It needs Python with venv and a package index. Without one of them it says so and exits with 77.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=systems.sh
. "$here/systems.sh"
wheel=$(realpath "${1:?usage: try_lowest.sh WHEEL}")
needs python3
python3 -c 'import ensurepip, venv' 2>/dev/null || skip "python3-venv is not installed"

WORK=$(mktemp -d "${TMPDIR:-/tmp}/dmuca-lowest-XXXXXX")
trap 'rm -rf --one-file-system "$WORK"' EXIT
unset PYTHONPATH
python3 -m venv "$WORK/uv"
"$WORK/uv/bin/python" -m pip --quiet --disable-pip-version-check install uv >/dev/null 2>&1 || skip "no package index is reached"
# Only uv can choose the oldest versions. It is told to trust what this computer trusts, as pip does.
UV_SYSTEM_CERTS=1 SSL_CERT_FILE=${SSL_CERT_FILE:-/etc/ssl/certs/ca-certificates.crt}
export UV_SYSTEM_CERTS SSL_CERT_FILE
uv="$WORK/uv/bin/uv --quiet"
$uv venv --python "$(command -v python3)" "$WORK/dmuca"
# uv chooses the oldest version only of what it is asked for itself, so it is given the list of the project file and not
# the wheel.
$uv pip install --python "$WORK/dmuca" --resolution lowest-direct --requirements "$here/../../pyproject.toml"
$uv pip install --python "$WORK/dmuca" --no-deps "$wheel"
"$WORK/uv/bin/uv" pip list --python "$WORK/dmuca" 2>/dev/null
HOME=$WORK sh "$here/first_commands.sh"

$uv pip install --python "$WORK/dmuca" dpkt hypothesis jsonschema pytest pytest-timeout pytest-xdist pyulog scipy z3-solver
cd "$here/../.."
"$WORK/dmuca/bin/python" -m pytest -q -p no:cacheprovider -n auto --dist loadfile tests/companion tests/sitl_mocks
echo "ok: the oldest versions that $(basename "$wheel") allows"
