"""CPU time of a step, and reception of honest frames, in a flood of 5,000 Remote ID frames a second.

The own aircraft holds 64 established tracks. One of these aircraft, the honest one, is in conflict and sends
five frames a second; at least 95 % of its frames must be heard. The frames of the flood are decoded from
bytes, as in the radios. Each flood is flown several times, and the least CPU time of each step counts.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from bench.bench_core import FRAME, companion, own_events
from bench.measuring.figures import least_of_each, target
from bench.measuring.memory import memory_mb
from companion.avoidance import kernels
from companion.events import Event, RadioState
from companion.geometry import Vec3
from companion.radio.frames_io import FrameReceiver, FrameSender, radio_address
from companion.remote_id.messages import BasicId, IdType, Location, Message, SelfId, Status, UaType
from companion.remote_id.transports import BLE4, WIFI_BEACON

STEPS_A_SECOND = 20
RATE = 5000
"""Frames of the flood per second."""
QUIET_S, FLOOD_S, FLIGHTS = 4, 6, 3
ESTABLISHED = 64
MOST_MS, LEAST_HEARD, MOST_MB = 20.0, 95.0, 10.0
"""Targets: time of the slowest step, share of honest frames heard, and growth of memory in three floods."""
OWN_MPS = 3.0

Raw = tuple[str, str, bytes]
"""Transport, radio address and bytes of a frame."""
Place = Callable[[int, float], tuple[Vec3, Vec3]]


def location(now_s: float, position: Vec3, velocity: Vec3) -> Location:
    """The Location of an aircraft at a place (NED of `FRAME`)."""
    lat, lon, _ = FRAME.to_geodetic(position[0], position[1], 0.0)
    return Location(
        status=Status.AIRBORNE,
        lat_deg=lat,
        lon_deg=lon,
        alt_geodetic_m=497.0 - position[2],
        direction_deg=math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0,
        speed_mps=math.hypot(velocity[0], velocity[1]),
        vertical_speed_mps=0.0,
        horizontal_accuracy_m=3.0,
        timestamp_s=round(now_s % 3600.0, 1),
    )


def named(uas_id: str) -> BasicId:
    """The Basic ID of an aircraft."""
    return BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=uas_id)


def honest_at(now_s: float) -> tuple[Vec3, Vec3]:
    """State of the honest aircraft, which comes from ahead and is in conflict throughout."""
    return (OWN_MPS * now_s + 230.0 - 10.0 * now_s, 4.0, 0.0), (OWN_MPS - 10.0, 0.0, 0.0)


def beside(number: int, now_s: float) -> tuple[Vec3, Vec3]:
    """State of a flooding sender without conflict: it flies along with us, each one nearer than the last."""
    away, turn = 900.0 - 0.02 * (number % 40_000), 2.399963 * number
    place = OWN_MPS * now_s + away * math.cos(turn), away * math.sin(turn), 0.0
    return place, (OWN_MPS, 0.0, 0.0)


def closing(number: int, now_s: float) -> tuple[Vec3, Vec3]:
    """State of a flooding sender in conflict: it flies towards us, each one from nearer than the last."""
    away, turn = 300.0 - 0.006 * (number % 40_000), 2.399963 * number
    place = OWN_MPS * now_s + away * math.cos(turn), away * math.sin(turn), 0.0
    return place, (OWN_MPS - 12.0 * math.cos(turn), -12.0 * math.sin(turn), 0.0)


@dataclass(frozen=True)
class Flood:
    """One kind of flood.

    Args:
        names, addresses: number of identities and radio addresses that take turns; 0: a new one for each
            frame.
    """

    text: str
    place: Place
    names: int = 0
    addresses: int = 0
    parts: str = "whole"
    """`whole`: Basic ID and Location in one Wi-Fi beacon. `names`, `places`, `texts`: BLE 4 frames with only
    a Basic ID, only a Location, or only a Self ID."""

    def frame(self, number: int, now_s: float) -> Raw:
        """The frame with this number."""
        name = f"F{number % self.names if self.names else number}"
        address = radio_address(f"a{number % self.addresses if self.addresses else number}")
        where = location(now_s, *self.place(number % self.names if self.names else number, now_s))
        messages: tuple[Message, ...] = {
            "whole": (named(name), where),
            "names": (named(name),),
            "places": (where,),
            "texts": (SelfId(description_type=0, text=name),),
        }[self.parts]
        transport = WIFI_BEACON if self.parts == "whole" else BLE4
        return transport, address, FrameSender(address).frames(transport, messages)[0]


FLOODS = (
    Flood("no flood", beside, names=1, addresses=1),
    Flood("new name and address, no conflict", beside),
    Flood("new name and address, conflict", closing),
    Flood("new name, one address, no conflict", beside, addresses=1),
    Flood("new name, one address, conflict", closing, addresses=1),
    Flood("one name and address, no conflict", beside, names=1, addresses=1),
    Flood("one name and address, conflict", closing, names=1, addresses=1),
    Flood("one name, new address, conflict", closing, names=1),
    Flood("300 names and addresses, conflict", closing, names=300, addresses=300),
    Flood("BLE 4, Basic IDs alone", beside, parts="names"),
    Flood("BLE 4, Locations alone, no conflict", beside, parts="places"),
    Flood("BLE 4, Locations alone, conflict", closing, parts="places"),
    Flood("BLE 4, Self IDs alone", beside, parts="texts"),
)

Steps = list[tuple[float, list[Event], list[Raw], bool]]
"""For each step: its time, the vehicle's events, the received frames, and whether the honest aircraft sent
one of them."""


def flight(flood: Flood) -> Steps:
    """Everything that is received in a flight with this flood."""
    senders = {f"N{n}": FrameSender(radio_address(f"N{n}")) for n in range(ESTABLISHED)}
    steps: Steps = []
    number = 0
    quiet = flood.text == "no flood"
    for tick in range(STEPS_A_SECOND * (QUIET_S + FLOOD_S)):
        now_s = tick / STEPS_A_SECOND
        raw: list[Raw] = []
        if tick >= STEPS_A_SECOND * QUIET_S and not quiet:
            raw = [flood.frame(number + k, now_s) for k in range(RATE // STEPS_A_SECOND)]
            number += len(raw)
        honest = tick % 4 == 0
        for n in range(ESTABLISHED):
            if n == 0 and honest:
                where = honest_at(now_s)
            elif n and tick % STEPS_A_SECOND == n % STEPS_A_SECOND:
                turn = 0.1 * n
                north, east = (200.0 + 5.0 * n) * math.cos(turn), (200.0 + 5.0 * n) * math.sin(turn)
                where = (OWN_MPS * now_s + north, east, 0.0), (OWN_MPS, 0.0, 0.0)
            else:
                continue
            sender = senders[f"N{n}"]
            frames = sender.frames(WIFI_BEACON, (named(f"N{n}"), location(now_s, *where)))
            # The honest frame comes in the middle of the flood's frames.
            raw.insert(len(raw) // 2, (WIFI_BEACON, sender.address, frames[0]))
        events = own_events(now_s, slow=tick % 20 == 0) if tick % 2 == 0 else []
        if tick == 0:
            events.append(RadioState(can_send=(WIFI_BEACON,)))
        steps.append((now_s, events, raw, honest))
    return steps


def fly(steps: Steps) -> Iterator[tuple[float, float, bool | None]]:
    """For each step in the flood: CPU time (s) of decoding and of the core, and whether the honest aircraft
    was heard (None if it did not send)."""
    core, receiver = companion(), FrameReceiver()
    for now_s, events, raw, honest in steps:
        began = time.thread_time()
        heard = [receiver.receive(*frame) for frame in raw]
        decoded = time.thread_time()
        core.step(now_s, [*events, *(event for event in heard if event is not None)])
        took = time.thread_time()
        if now_s >= QUIET_S:
            track = core.traffic.tracks.get("N0")
            known = track is not None and track.received_s == now_s
            yield decoded - began, took - decoded, known if honest else None


def main() -> None:
    """Print the table."""
    kernels.warm_up()
    gc.disable()
    print(f"{'flood':38}{'decode ms':>10}{'median ms':>11}{'p99 ms':>9}{'most ms':>9}{'heard':>8}{'MB':>6}")
    slowest, least, grown = 0.0, 100.0, 0.0
    for flood in FLOODS:
        steps = flight(flood)
        flown = []
        gc.collect()
        before = memory_mb("VmRSS")
        for _ in range(FLIGHTS):
            flown.append(list(fly(steps)))
            gc.collect()
        grew = memory_mb("VmRSS") - before
        decode = least_of_each([[d for d, _, _ in f] for f in flown])
        whole = least_of_each([[d + c for d, c, _ in f] for f in flown])
        heard = [known for _, _, known in flown[0] if known is not None]
        share = 100.0 * sum(heard) / len(heard)
        median, p99, most = np.percentile(whole, [50, 99, 100]) * 1e3
        print(
            f"{flood.text:38}{1e3 * float(np.median(decode)):10.2f}{median:11.2f}{p99:9.2f}{most:9.2f}"
            f"{share:7.1f}%{grew:6.1f}",
            flush=True,
        )
        slowest, least, grown = max(slowest, most), min(least, share), max(grown, grew)
    gc.enable()
    target("slowest step in a flood", slowest, "ms", most=MOST_MS)
    target("honest frames heard in a flood", least, "%", least=LEAST_HEARD)
    target("growth of memory in three floods", grown, "MB", most=MOST_MB)


if __name__ == "__main__":
    main()
