"""The ArduRemoteID radio against the stand-in module, in virtual time."""

from __future__ import annotations

from typing import Any

from companion.radio.arduremoteid.module_radio import ArduRemoteIdTransport
from companion.radio.radio import Health
from companion.remote_id.messages import (
    BasicId,
    IdType,
    Location,
    Message,
    Status,
    System,
    UaType,
)
from sitl_mocks.remote_id_module.module import ModuleOptions, RemoteIdModule

STORED = {"UAS_TYPE": 2.0, "UAS_ID_TYPE": 1.0}
OURS = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="ABCD123456789")
UTC_S = 1_767_225_600.0


class Wire:
    """A link and a clock of its own: waiting lets the module live."""

    def __init__(self, options: ModuleOptions | None) -> None:
        self.now_s = 0.0
        self.module = None if options is None else RemoteIdModule(options)
        self.extra = b""
        self.closed = False
        self.cut = False

    def clock(self) -> float:
        return self.now_s

    def wait(self, timeout_s: float) -> None:
        self.now_s += timeout_s

    def receive(self, now_s: float) -> bytes:
        data, self.extra = self.extra, b""
        if self.module is not None:
            self.module.advance(now_s)
            answer = self.module.drain()
            data += b"" if self.cut else answer
        return data

    def send(self, data: bytes) -> None:
        if self.module is not None and not self.cut:
            self.module.receive(data, self.now_s)

    def close(self) -> None:
        self.closed = True


class Bench:
    """The backend, opened."""

    def __init__(self, **options: Any) -> None:
        params = {**STORED, **options.pop("params", {})}
        self.wire = Wire(ModuleOptions(params=params, **options))
        self.radio = ArduRemoteIdTransport(self.wire, 7, self.wire.clock, "serial:/dev/ttyACM0:57600")
        self.on_air: set[tuple[str, type[Message]]] = set()

    @property
    def module(self) -> RemoteIdModule:
        assert self.wire.module is not None
        return self.wire.module

    def health(self) -> Health:
        return self.radio.health(self.wire.now_s)

    def air(self) -> dict[str, Any]:
        return {entry.transport: entry for entry in self.module.on_air(self.wire.now_s)}

    def wait(self, seconds: float) -> None:
        """The loop runs; nothing is broadcast."""
        for _ in range(round(seconds / 0.05)):
            self.wire.now_s += 0.05
            assert self.radio.heard(self.wire.now_s) == []

    def fly(
        self, seconds: float, *transports: str, more: tuple[Message, ...] = (), dated: bool = True
    ) -> None:
        """The loop at 20 Hz, and a broadcast a second on each transport."""
        for tick in range(round(seconds / 0.05)):
            self.wait(0.05)
            if tick % 20 == 0:
                for transport in transports:
                    self.radio.broadcast(
                        transport, (*messages(self.wire.now_s, dated), *more), self.wire.now_s
                    )
            self.on_air |= {(t, type(m)) for t, entry in self.air().items() for m in entry.messages}


def messages(now_s: float, dated: bool = True) -> tuple[Message, ...]:
    return (
        OURS,
        Location(
            status=Status.AIRBORNE,
            lat_deg=47.3,
            lon_deg=8.5,
            timestamp_s=round(now_s % 3600, 1) if dated else None,
        ),
        System(
            operator_lat_deg=47.3,
            operator_lon_deg=8.5,
            timestamp_utc_s=UTC_S + int(now_s) if dated else None,
        ),
    )


def kinds(bench: Bench, transport: str) -> set[type[Message]]:
    return {kind for on, kind in bench.on_air if on == transport}


TRAPS: dict[str, dict[str, Any]] = {
    "plain": {},
    "noise": {"noise": True},
    "slow start": {"boot_s": 5.0},
    "lossy": {"lose_every": 3},
    "own system id": {"params": {"MAVLINK_SYSID": 99.0}},
    "locked": {"params": {"LOCK_LEVEL": 1.0}},
    "nothing stored": {"params": {"UAS_TYPE": 0.0, "UAS_ID_TYPE": 0.0}},
    "loud": {"params": {"OPTIONS": 4.0}},
    "shy": {"params": {"BCAST_POWERUP": 0.0}},
    "old": {"without": frozenset(("OPTIONS", "MAVLINK_SYSID"))},
    "all": {
        "noise": True,
        "boot_s": 5.0,
        "lose_every": 3,
        "without": frozenset(("MAVLINK_SYSID",)),
        "params": {
            "MAVLINK_SYSID": 99.0, "LOCK_LEVEL": 1.0, "UAS_TYPE": 0.0, "UAS_ID_TYPE": 0.0,
            "OPTIONS": 4.0, "BCAST_POWERUP": 0.0,
        },
    },
}  # fmt: skip
