"""Attacks with an honest aircraft's identity or messages: clones, shifted clocks, replays, and false
positions."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from companion.geometry import Vec3
from companion.remote_id.transports import WIFI_BEACON
from ground_tools.campaign.attacks.attacker import (
    PLACE,
    Clock,
    Parameter,
    Sent,
    Silent,
    Values,
    View,
    plus,
    turned,
    unit,
)
from ground_tools.campaign.attacks.messages import report
from ground_tools.campaign.attacks.scene import Scene

_COPY: Final = (
    *PLACE,
    Parameter("begin_s", 5.0, 38.0),
    Parameter("rate", 0.5, 20.0),
    Parameter("bearing_turn", 0.0, 1.0),
    Parameter("above_m", -10.0, 10.0),
    Parameter("drift_mps", -5.0, 5.0),
)
CLONE: Final = (*_COPY, Parameter("away_m", 15.0, 120.0))
SHADOW: Final = (*_COPY, Parameter("away_m", 0.0, 60.0), Parameter("lead_s", -4.8, 4.8))
LIAR: Final = (
    Parameter("away_m", 10.0, 100.0),
    Parameter("bearing_turn", 0.0, 1.0),
    Parameter("above_m", -5.0, 5.0),
)
REPLAY: Final = (
    *PLACE,
    Parameter("begin_s", 5.0, 38.0),
    Parameter("delay_s", 0.3, 30.0),
    Parameter("copies", 1.0, 20.0),
    Parameter("whose", 0.0, 1.0),
)
_MOST_RECORDED: Final = 2000


class Clone(Silent):
    """Sends the identity and the radio address of the first honest aircraft, from a place beside it.

    Its timestamps are `lead_s` ahead of the true time, or behind it if `lead_s` is negative.
    """

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__(values, scene, rng)
        self._clock = Clock(values["begin_s"])

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`."""
        values, copied, found = self.values, view.honest[0], []
        aside = turned(
            unit(plus(view.own.position, copied.position, -1.0)), 2.0 * math.pi * values["bearing_turn"]
        )
        place = plus(copied.position, (aside[0], aside[1], 0.0), values["away_m"])
        place = plus(place, (0.0, 0.0, -values["above_m"]))
        velocity = plus(copied.velocity, (aside[0], aside[1], 0.0), values["drift_mps"])
        for _ in range(self._clock.due(now_s, values["rate"])):
            messages = report(view.names[0], now_s, place, velocity, lead_s=values.get("lead_s", 0.0))
            found.append(Sent(WIFI_BEACON, view.addresses[0], messages))
        return found


class Liar(Silent):
    """The first honest aircraft itself sends a wrong position, with its true velocity."""

    def lie(self) -> Vec3:
        """See `Attacker.lie`."""
        turn, away = 2.0 * math.pi * self.values["bearing_turn"], self.values["away_m"]
        return away * math.cos(turn), away * math.sin(turn), -self.values["above_m"]


class Replay(Silent):
    """Records frames and sends them again, unchanged, after `delay_s`.

    `whose` selects the frames of the first honest aircraft, of the own aircraft, or of everybody.
    """

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__(values, scene, rng)
        self._recorded: deque[tuple[float, str, str, bytes]] = deque(maxlen=_MOST_RECORDED)

    def overhear(self, now_s: float, sender: str, transport: str, address: str, frame: bytes) -> None:
        """See `Attacker.overhear`."""
        whose = self.values["whose"]
        wanted = sender == "PEER0" if whose < 0.5 else sender == "OWN" if whose < 0.75 else True
        if wanted:
            self._recorded.append((now_s + self.values["delay_s"], transport, address, frame))

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`."""
        found = []
        while self._recorded and self._recorded[0][0] <= now_s:
            _, transport, address, frame = self._recorded.popleft()
            if now_s >= self.values["begin_s"]:
                found += [Sent(transport, address, frame=frame)] * round(self.values["copies"])
        return found
