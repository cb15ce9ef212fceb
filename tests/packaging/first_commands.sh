#!/bin/sh
# The first commands of docs/install.md, in an installed copy without a checkout, against the mock vehicle. Each must
# print the words that are given with it.
set -eu

cd "$(mktemp -d)"
PATH=$HOME/dmuca/bin:$PATH
unset PYTHONPATH

# tried WORDS COMMAND...: runs the command, tells how long it took, and fails where the words are not printed.
tried() {
    words=$1
    shift
    began=$(date +%s)
    code=0
    "$@" >output.txt 2>&1 || code=$?
    if [ $code = 0 ] && grep -q -e "$words" output.txt && ! grep -q Traceback output.txt; then
        echo "ok $(($(date +%s) - began)) s: $*"
    else
        tail -n 30 output.txt
        echo "FAILED with exit code $code, without '$words': $*"
        exit 1
    fi
}

tried '^dmuca ' companion --version
tried 'kernels ready' python -m companion.runtime.warm
tried 'next: companion check' companion init --px4 --radio ether=127.0.0.1:14640 --region us --uas-id 1596B0000DMUCA77
sitl-mocks serve --firmware px4 --link udpout:127.0.0.1:14540 >vehicle.txt 2>&1 &
vehicle=$!
sitl-mocks ether --listen 127.0.0.1:14640 >air.txt 2>&1 &
air=$!
trap 'kill $vehicle $air 2>/dev/null || true' EXIT
until grep -q ready vehicle.txt && grep -q 'ether on' air.txt; do sleep 1; done
tried '^check: ready' companion check --config companion.toml
kill $vehicle $air
wait $vehicle $air || true
tried 'separation' sitl-mocks demo
tried '"figure": "system-delay"' ground-tools paper system-delay --samples "${SAMPLES:-100}" --json
