"""`companion check`: the preflight list.

It validates the configuration, probes radios, disk and link, measures what the vehicle sends, and reports in
plain words what is missing and what to do about it.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adjustable_parameters import differences
from companion.autopilot.advice import after_silence, no_receiver, remarks
from companion.autopilot.dialect import impossible_rearm
from companion.autopilot.link import AutopilotLink
from companion.autopilot.polled.streams import ENOUGH, STREAM_RATES_HZ
from companion.avoidance.path import check_path
from companion.commands.check_containment import judge_containment, judge_law, judge_mission
from companion.commands.check_places import judge_heights, judge_places
from companion.commands.check_radios import find_policy, find_radios
from companion.commands.drip_keys import find_signing
from companion.commands.preflight import Preflight
from companion.config import EXAMPLE_ID, Config, check_identity
from companion.errors import ConfigError
from companion.events import (
    DownloadMission,
    Event,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    LandedState,
    LocalPosition,
    MissionCurrent,
    MissionDownloaded,
    MissionRefused,
    Settings,
    VehicleParameters,
    VehicleTime,
)
from companion.ownship import Ownship
from companion.runtime import clock
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.links.no_vehicle import no_vehicle
from companion.runtime.record.disk import finished_runs, free_mb, not_mounted
from companion.runtime.signing_key import KeptSigning
from companion.runtime.stored_parameters import read_settings
from companion.runtime.warm import warm_up, was_compiled

_SETTLE_S = 2.0
"""Time after the vehicle was found, in which its telemetry streams are requested and begin."""
_MEASURE_S = 4.0
_PARAMETERS_S = 8.0
"""Longest wait until the parameters that exist have arrived and the others were requested often enough."""
_MISSION_S = 65.0
"""Longest wait for the mission: longer than a download may take."""
_STALL_S = 0.5
"""During a turn of a probe that takes longer, this computer stood still. The turn does not count, and reading
goes on for at least as long, because nothing is known of the link meanwhile."""
_MOST_STALLED_S = 60.0
"""How much longer a probe may take for that reason."""
_CLOCK_OFF_S = 2.0
_TIGHT_MB = 500.0
"""Free space above record.keep_free_mb below which the disk is yellow: some hours of recording."""
_MESSAGES: Final[dict[type[Event], tuple[str, float]]] = {
    Heartbeat: ("HEARTBEAT", 1.0),
    GlobalPosition: ("GLOBAL_POSITION_INT", STREAM_RATES_HZ[mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT]),
    GnssFix: ("GPS_RAW_INT", STREAM_RATES_HZ[mavlink.MAVLINK_MSG_ID_GPS_RAW_INT]),
    LandedState: ("EXTENDED_SYS_STATE", STREAM_RATES_HZ[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE]),
    VehicleTime: ("SYSTEM_TIME", STREAM_RATES_HZ[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME]),
    LocalPosition: ("LOCAL_POSITION_NED", STREAM_RATES_HZ[mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED]),
    MissionCurrent: ("MISSION_CURRENT", STREAM_RATES_HZ[mavlink.MAVLINK_MSG_ID_MISSION_CURRENT]),
}
"""Messages whose rate is measured: the name and the requested rate in Hz."""
_USEFUL: Final = ("LOCAL_POSITION_NED", "MISSION_CURRENT")
"""Messages without which a flight is still possible."""


def check(config: Config, say: Callable[[str], None], *, as_json: bool = False) -> int:
    """Probe everything that the configuration names.

    Args:
        say: receives each line as soon as it is known; with `as_json`, one JSON object at the end.

    Returns:
        0 if no finding is red, otherwise 1.
    """
    found = findings(config, None if as_json else say)
    if as_json:
        say(msgspec.json.encode({"ready": found.ready, "findings": found.findings}).decode())
    else:
        say("check: ready" if found.ready else "check: NOT ready")
    return 0 if found.ready else 1


def findings(config: Config, say: Callable[[str], None] | None = None) -> Preflight:
    """Probe everything, and pass each line to `say` as soon as it is known."""
    found = Preflight()
    for probe in (
        _configuration, judge_containment, find_signing, _settings, _kernels, judge_law, _disk, find_policy,
        find_radios, _vehicle,
    ):  # fmt: skip
        before = len(found.findings)
        probe(config, found)
        if say is not None:
            for finding in found.findings[before:]:
                say(finding.line())
    return found


def _configuration(config: Config, found: Preflight) -> None:
    found.green("configuration", "valid")
    for note in check_identity(config.identity, config.remote_id, config.region):
        found.yellow("configuration", note, "set it as your registration document shows it")
    for number, entry in enumerate(config.radio):
        unfit = entry.unfit_for(config.identity.uas_id)
        if unfit is not None:
            found.red("identity", f"radio[{number}]: {unfit}", "leave it out, or set another identity")
    if config.identity.uas_id == EXAMPLE_ID:
        # Messages with our own number are ignored: two aircraft that both have it would not avoid each other.
        tell = found.yellow if config.flight.use == "watch" else found.red
        tell(
            "identity",
            f"identity.uas_id: {EXAMPLE_ID} is the example of the documentation; aircraft of the same number "
            "do not avoid each other",
            "set the serial number of this aircraft",
        )
    if config.region.transport_sets:
        found.green("region", config.region.name)
    else:
        found.yellow(
            "region",
            f"{config.region.name}: no Remote ID law applies",
            'set remote_id.region to a profile, such as "us"',
        )
    try:
        check_path(config, "configuration")
    except ConfigError as error:
        found.red("path", str(error), "change the trajectory or [limits]")


def _settings(config: Config, found: Preflight) -> None:
    """Check the stored settings. A flight would ignore unusable ones; before flight they are an error."""
    try:
        settings = read_settings(config)
    except ConfigError as error:
        found.red(
            "settings",
            f"{error}; the file is not used",
            "delete the file, or correct it or the configuration",
        )
        return
    told = differences(config, Settings(), settings)
    for text in told:
        found.yellow("settings", text, "nothing, if a ground station set it on purpose")
    if not told:
        found.green("settings", "as configured")


def _kernels(_config: Config, found: Preflight) -> None:
    took_s = warm_up()
    if was_compiled():
        found.yellow(
            "kernels",
            f"not in the cache, so they were compiled in {took_s:.0f} s",
            "nothing, if the next check is green; otherwise set NUMBA_CACHE_DIR to a writable folder",
        )
    else:
        found.green("kernels", f"loaded from the cache in {took_s:.1f} s")


def _disk(config: Config, found: Preflight) -> None:
    record = config.record
    folder = Path(record.folder).absolute()
    absent = not_mounted(folder)
    if absent is not None:
        found.red("disk", f"{folder}: {absent}", "mount the disk, make the folder, or set record.folder")
        return
    there = next(parent for parent in (folder, *folder.parents) if parent.exists())
    if not (there.is_dir() and os.access(there, os.W_OK)):
        found.red(
            "disk", f"{folder}: cannot be written", "give this user write permission, or set record.folder"
        )
        return
    try:
        free = free_mb(folder)
    except OSError as error:
        found.red("disk", f"{folder}: {error.strerror}", "repair the disk, or set record.folder")
        return
    text = f"{free:.0f} MB free in {folder}; record.keep_free_mb is {record.keep_free_mb:g} MB"
    runs = len(finished_runs(folder))
    room = f"move or delete some of the {runs} runs in it, or use a larger disk"
    if free >= record.keep_free_mb + _TIGHT_MB:
        found.green("disk", text)
    elif record.delete_oldest and runs:
        found.yellow("disk", text, f"nothing: below that, the oldest of the {runs} runs are deleted")
    elif free >= record.keep_free_mb:
        found.yellow("disk", text, room)
    else:
        found.red("disk", f"{text}: no flight would be recorded", room)


# ---------------------------------------------------------------- vehicle


def _vehicle(config: Config, found: Preflight) -> None:
    try:
        kept = KeptSigning(config)
    except ConfigError as error:
        found.red("signing", str(error), "correct the key file or vehicle.signing_key")
        return
    for trouble in (kept.unread, kept.error):
        if trouble is not None:
            found.red("signing", trouble, "repair the disk, or set record.folder")
    if kept.wrong_clock is not None:
        found.red("signing", kept.wrong_clock, "set the clock")
    try:
        link = KeptLink(
            config.vehicle.link,
            lambda text: found.red("link", text, "check the cable, or the program at the other end"),
        )
    except ConfigError as error:
        found.red("link", str(error), "check the device or address, and vehicle.link")
        kept.close()
        return
    probe = _Probe(link, AutopilotLink(config.vehicle, signing=kept.signing))
    try:
        probe.run(config.vehicle.wait_s, lambda: probe.protocol.vehicle is not None)
        if probe.protocol.vehicle is not None:
            probe.run(_SETTLE_S)
            probe.measure(_MEASURE_S)
            probe.run(_PARAMETERS_S, lambda: not probe.protocol.asking)
        if config.flight.use == "guard" and probe.protocol.parameters is not None:
            probe.protocol.send(DownloadMission(), clock.now_s())
            probe.run(_MISSION_S, lambda: probe.mission is not None)
    finally:
        link.close()
        kept.close()
    _judge_vehicle(config, probe, found)


class _Probe:
    """Uses the link like a flight: requests telemetry, and counts what arrives."""

    def __init__(self, link: KeptLink, protocol: AutopilotLink) -> None:
        self.link, self.protocol = link, protocol
        self.own = Ownship()
        self.counts: Counter[type[Event]] = Counter()
        self.mission: MissionDownloaded | MissionRefused | None = None
        self.measured_s = 0.0
        self.now_s = clock.now_s()

    def measure(self, seconds: float) -> None:
        """Reset the counts, then count for `seconds`."""
        self.counts.clear()
        began_s = clock.now_s()
        self.run(seconds)
        self.measured_s = clock.now_s() - began_s

    def run(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Exchange bytes for `seconds`, without stalls of this computer, or until `done` returns True."""
        before = clock.now_s()
        give_up = before + seconds + _MOST_STALLED_S
        while seconds > 0.0 and before < give_up and not done():
            self.link.wait(0.05)
            # What came meanwhile may be as new as this moment. An earlier date would make it seem old later.
            self.now_s = now = clock.now_s()
            took, before = now - before, now
            seconds = max(seconds, _STALL_S) if took > _STALL_S else seconds - took
            data = self.link.receive(now).data
            for event in [*self.protocol.receive(data, now), *self.protocol.advance(now)]:
                self.counts[type(event)] += 1
                self.own.observe(event, now)
                if isinstance(event, MissionDownloaded | MissionRefused):
                    self.mission = event
            self.link.send(self.protocol.drain())


def _judge_vehicle(config: Config, probe: _Probe, found: Preflight) -> None:
    where, vehicle = config.vehicle.link, probe.protocol.vehicle
    if vehicle is None:
        found.red(*no_vehicle(config.vehicle, probe.link, probe.protocol, probe.now_s))
        return
    bad = probe.protocol.counts.wire.corrupt
    if bad:
        found.yellow(
            "link", f"{where}: {bad} damaged frames", "check the wires, their ground and the baud rate"
        )
    else:
        found.green("link", f"{where}: up, no damaged frames")
    if probe.link.trouble.left_out:
        text = f"{where}: another sender uses this port; {probe.link.trouble.left_out} datagrams were ignored"
        found.yellow(
            "link", text, "let only one program send to this port: only the first sender heard is accepted"
        )
    if vehicle.refusal is None:
        found.green("vehicle", str(vehicle))
    else:
        found.red("vehicle", str(vehicle), "use a supported vehicle; this one is never commanded")
    if probe.protocol.unclear is not None:
        found.red(
            "vehicle", probe.protocol.unclear, "set it to the right one, or stop what forwards the other"
        )
    for text in _radio_remarks(config, vehicle.system_id):
        what, _, text = text.partition(": ")
        found.yellow(what, text, f"set system_id = {vehicle.system_id} and power-cycle the module")
    rearm = impossible_rearm(vehicle.firmware, config.flight)
    if rearm is not None:
        found.red("authority", rearm, 'set flight.rearm to "disarm" or "never"')
    _judge_parameters(config, probe.protocol.parameters, found)
    if config.flight.use == "guard" and probe.protocol.parameters is not None:
        home_m = probe.own.home_alt_msl_m
        judge_mission(config, probe.protocol.parameters, probe.mission, found, home_m)
    _judge_rates(probe, found)
    _judge_own(config, probe, found)
    judge_heights(config, probe.own.home_alt_msl_m, found)
    if probe.own.position is not None:
        judge_places(config, probe.own.position.lat_deg, probe.own.position.lon_deg, found)


def _judge_parameters(config: Config, told: VehicleParameters | None, found: Preflight) -> None:
    """Report what the vehicle's own limits and failsafes mean for this configuration."""
    if told is None:
        return
    watching = config.flight.use == "watch"
    if not watching:
        found.green("vehicle", after_silence(told))
    deaf = no_receiver(told)
    if deaf is not None:
        found.green("vehicle", deaf)
    for text in remarks(config, told, final=True):
        found.yellow("vehicle", text, "change the parameter or the configuration")
    if watching:
        return
    if told.speed_mps is None:
        text = "it does not report its speed limits, so only [limits] apply"
        found.yellow("vehicle", text, "make sure that [limits] suits this vehicle")
    try:
        check_path(config, "configuration", told)
    except ConfigError as error:
        found.red("path", str(error), "change the trajectory or the vehicle's limits")


def _judge_rates(probe: _Probe, found: Preflight) -> None:
    rates = {name: probe.counts[kind] / probe.measured_s for kind, (name, _) in _MESSAGES.items()}
    short = {name: want for name, want in _MESSAGES.values() if rates[name] < ENOUGH * want}
    well = [f"{name} {rate:.1f}" for name, rate in rates.items() if name not in short]
    if well:
        found.green("rates", f"{', '.join(well)} a second")
    for name, want in short.items():
        text = f"{name} {rates[name]:.1f} a second; {want:g} were requested"
        do = "check whether the port is too slow for its traffic, or another program sets the rates"
        if name == "GLOBAL_POSITION_INT" and probe.protocol.counts.no_position:
            do = "wait until the autopilot knows its position (it sends 0, 0 until then)"
        (found.yellow if name in _USEFUL else found.red)("rates", text, do)


def _judge_own(config: Config, probe: _Probe, found: Preflight) -> None:
    own, now_s = probe.own, probe.now_s
    fix = own.gnss_now(now_s)
    if fix is None or fix.fix_type < 3:
        kind = "no GPS_RAW_INT received" if fix is None else f"no 3D fix (fix type {fix.fix_type})"
        found.red("GNSS", kind, "move to open sky and wait; check the antenna")
    else:
        satellites = "unknown" if fix.satellites is None else fix.satellites
        found.green("GNSS", f"fix type {fix.fix_type}, satellites {satellites}, accuracy {own.sigma_m:.1f} m")
    if own.position is not None and own.age_s(now_s) > config.vehicle.stale_after_s:
        found.red(
            "link",
            f"own position is {own.age_s(now_s):.1f} s old; allowed: {config.vehicle.stale_after_s:g} s",
            "the link is overloaded: raise its baud rate, or reduce what is sent on it",
        )
    if own.utc_offset_s is None:
        found.red(
            "clock",
            "the vehicle does not know UTC",
            "wait for its GNSS receiver; this usually takes a minute",
        )
        return
    off_s = time.time() - (clock.now_s() + own.utc_offset_s)
    text = f"UTC known; this computer's clock differs from the vehicle's by {off_s:+.1f} s"
    if abs(off_s) <= _CLOCK_OFF_S:
        found.green("clock", text)
    else:
        found.yellow(
            "clock",
            text,
            "give this computer a network or an RTC: run folders are named by its clock",
        )


def _radio_remarks(config: Config, system_id: int) -> list[str]:
    """Report warnings of the radios' sections about the vehicle."""
    found = [entry.remark(system_id) for entry in config.radio]
    return [f"radio[{number}]{text}" for number, text in enumerate(found) if text is not None]
