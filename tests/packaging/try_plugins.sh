#!/bin/sh
# Installs the wheel and the four example projects of docs/examples in an empty environment away from the checkout,
# runs each project's own tests (the conformance kit of dmuca.testing) there, and flies the demo by the law.
#
#   tests/packaging/try_plugins.sh WHEEL
#
# It needs Python with venv and a package index. Without one of them it says so and exits with 77. ENVIRONMENT names a
# folder where the environment is kept; without it each run installs everything again.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=systems.sh
. "$here/systems.sh"
wheel=$(realpath "${1:?usage: try_plugins.sh WHEEL}")
examples=$(cd "$here/../../docs/examples" && pwd)
needs python3
python3 -c 'import ensurepip, venv' 2>/dev/null || skip "python3-venv is not installed"

WORK=$(mktemp -d "${TMPDIR:-/tmp}/dmuca-plugins-XXXXXX")
trap 'rm -rf --one-file-system "$WORK"' EXIT
unset PYTHONPATH
environment=${ENVIRONMENT:-$WORK/environment}
[ -x "$environment/bin/python" ] || python3 -m venv "$environment"
pip="$environment/bin/python -m pip --quiet --disable-pip-version-check"
$pip download --no-deps --dest "$WORK/reached" hatchling >/dev/null 2>&1 || skip "no package index is reached"
mkdir "$WORK/projects" "$WORK/away"
for project in law policy radio firmware; do
    cp -r "$examples/plugin-$project" "$WORK/projects/"
done
began=$(date +%s)
# The wheel by its path, so that no other distribution of that name is taken.
$pip install "$wheel" pytest "$WORK"/projects/*
$pip install --force-reinstall --no-deps "$wheel"
echo "installed in $(($(date +%s) - began)) s"

cd "$WORK/away"
case $("$environment/bin/python" -c 'import dmuca; print(dmuca.__file__)') in
    "$environment"/*) ;;
    *) echo "FAILED: dmuca is not the installed one"; exit 1 ;;
esac
"$environment/bin/python" -m pytest -q -p no:cacheprovider -c /dev/null --rootdir "$WORK" "$WORK"/projects/*/test_*.py
head_on='config/scenarios/head_on.toml'
"$environment/bin/sitl-mocks" demo --law sidestep --scenario $head_on --json >demo.json
"$environment/bin/python" - <<'END'
import json

found = json.load(open("demo.json"))
print(f"law sidestep: {found['unavoided_min_separation_m']:.1f} m without avoidance, {found['min_separation_m']:.1f} m with")
assert found["ok"] and found["unavoided_min_separation_m"] < 10.0 < found["min_separation_m"]
END
echo "ok: four plug-ins on $(basename "$wheel")"
