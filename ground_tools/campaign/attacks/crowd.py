"""Crowds of invented aircraft that fill the table of tracks."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.geometry import Vec3
from companion.radio.frames_io import radio_address
from companion.remote_id.transports import WIFI_BEACON
from ground_tools.campaign.attacks.attacker import (
    PLACE,
    Aircraft,
    Clock,
    Parameter,
    Sent,
    Silent,
    Values,
    View,
    plus,
)
from ground_tools.campaign.attacks.messages import report
from ground_tools.campaign.attacks.scene import Scene

PARAMETERS: Final = (
    *PLACE,
    Parameter("fakes", 150.0, 240.0),
    Parameter("rate", 30.0, 200.0),
    Parameter("begin_s", 1.0, 20.0),
    Parameter("near_m", 5.0, 60.0),
    Parameter("spread_m", 0.0, 30.0),
    Parameter("above_m", -40.0, 40.0),
    Parameter("closing_mps", -6.0, 4.0),
    Parameter("sector_turn", 0.05, 1.0),
    Parameter("bearing_turn", 0.0, 1.0),
    Parameter("renamed_s", 5.0, 60.0),
    Parameter("quieter_db", 0.0, 15.0),
)
_BACK_S: Final = 20.0
"""Time after which a fake that approaches starts again at its first distance."""


class Crowd(Silent):
    """Fake aircraft that fly along with the own aircraft, in a ring or a sector around it.

    `begin_s` decides whether they appear before or after the honest aircraft is heard, `closing_mps` whether
    they are in conflict (below 0: they fly along), `renamed_s` how often all of them take new identities, and
    `quieter_db` by how much their signal strengths differ. The sector's middle lies at `bearing_turn`,
    clockwise from the own path's direction.
    """

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__(values, scene, rng)
        count = round(values["fakes"])
        turns = values["bearing_turn"] + values["sector_turn"] * ((np.arange(count) + 0.5) / count - 0.5)
        self._bearings = (scene.heading_rad + 2.0 * math.pi * turns).tolist()
        self._away_m = (values["near_m"] + values["spread_m"] * rng.random(count)).tolist()
        self._quieter_db = (values["quieter_db"] * rng.random(count)).tolist()
        self._clock = Clock(values["begin_s"])
        self._next = 0

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`."""
        found = []
        for _ in range(self._clock.due(now_s, self.values["rate"])):
            number, self._next = self._next, (self._next + 1) % len(self._bearings)
            fake = self._fake(number, now_s, view)
            name = f"F{number}-{int(now_s / self.values['renamed_s'])}"
            messages = report(name, now_s, fake.position, fake.velocity)
            found.append(
                Sent(WIFI_BEACON, radio_address(name), messages, quieter_db=self._quieter_db[number])
            )
        return found

    def _fake(self, number: int, now_s: float, view: View) -> Aircraft:
        closing = max(self.values["closing_mps"], 0.0)
        bearing, away = self._bearings[number], self._away_m[number]
        towards: Vec3 = (-math.cos(bearing), -math.sin(bearing), 0.0)
        away = max(away - closing * (now_s % _BACK_S), 5.0)
        position = plus(plus(view.own.position, towards, -away), (0.0, 0.0, -self.values["above_m"]))
        return Aircraft(position, plus(view.own.velocity, towards, closing))
