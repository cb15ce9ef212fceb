#!/bin/sh
# Starts the installed service without systemd: the unit's command line, with its user and its environment, against
# the mock vehicle and the simulated air. Then asks for its status and stops it as systemd does.
set -eu

unit=/usr/lib/systemd/system/dmuca-companion.service
value() {
    sed -n "s/^$1=//p" "$unit"
}
install -d -o dmuca -g dmuca -m 750 /run/dmuca
# As systemd does it: after the unit's Environment=, the folders of StateDirectory= and RuntimeDirectory=.
# shellcheck disable=SC2046 # words are meant
set -- setpriv --reuid dmuca --regid dmuca --groups "dmuca,$(value SupplementaryGroups)" \
    env $(value Environment) "STATE_DIRECTORY=/var/lib/$(value StateDirectory)" RUNTIME_DIRECTORY=/run/dmuca HOME=/var/lib/dmuca

companion init --px4 --radio ether=127.0.0.1:14640 --region us --uas-id 1596B0000DMUCA77 --out /etc/dmuca/companion.toml
chown root:dmuca /etc/dmuca/companion.toml
chmod 640 /etc/dmuca/companion.toml
cd "$(value WorkingDirectory)"

before=$(value ExecStartPre)
# shellcheck disable=SC2086 # words are meant
"$@" ${before#-}
sitl-mocks serve --firmware px4 --link udpout:127.0.0.1:14540 --airborne 50 >/tmp/vehicle.txt 2>&1 &
vehicle=$!
sitl-mocks ether --listen 127.0.0.1:14640 >/tmp/air.txt 2>&1 &
air=$!
until grep -q ready /tmp/vehicle.txt && grep -q 'ether on' /tmp/air.txt; do sleep 1; done
# shellcheck disable=SC2046
"$@" $(value ExecStart) >/tmp/companion.txt 2>&1 &
companion=$!
tries=0
until "$@" companion status --json >/tmp/status.json 2>/tmp/status.txt; do
    tries=$((tries + 1))
    if [ $tries -gt 60 ] || ! kill -0 $companion; then
        cat /tmp/status.txt /tmp/companion.txt
        echo "FAILED: no status"
        exit 1
    fi
    sleep 2
done
"$@" companion status --once
kill $companion
code=0
wait $companion || code=$?
kill $vehicle $air
wait $vehicle $air || true
tail -n 3 /tmp/companion.txt
[ $code = 0 ] || { echo "FAILED: the companion ended with exit code $code"; exit 1; }
ls -d /var/lib/dmuca/runs/*
