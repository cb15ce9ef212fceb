"""Ghost aircraft that fly with the own aircraft and push it, by Remote ID or ADS-B; and free mixtures of
attacks."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.events import AdsbVehicle
from companion.geometry import Vec3
from companion.radio.frames_io import radio_address
from companion.remote_id.transports import WIFI_BEACON
from ground_tools.campaign.attacks.attacker import (
    ADSB_PERIOD_S,
    PLACE,
    Aircraft,
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
from ground_tools.campaign.attacks.messages import SEPARATION_M, geodetic, report
from ground_tools.campaign.attacks.scene import Scene, herd_of

_GHOST: Final = (
    Parameter("begin_s", 15.0, 60.0),
    Parameter("ahead", -1.0, 1.0),
    Parameter("aside", -1.0, 1.0),
    Parameter("below", -1.0, 1.0),
    Parameter("closing_mps", 0.0, 8.0),
)
HERD: Final = (
    *PLACE,
    *_GHOST,
    Parameter("away_m", 8.0, 40.0),
    Parameter("rate", 1.0, 10.0),
    Parameter("renamed_s", 5.0, 300.0),
)
ADSB: Final = (
    *_GHOST,
    Parameter("away_m", 20.0, 400.0),
    Parameter("renamed_s", 15.0, 300.0),
    Parameter("geometric", 0.0, 1.0),
)
_FREE_GHOSTS: Final = 3
_LAST_BEGIN_S: Final = 60.0
FREE: Final = (
    *PLACE,
    *(
        Parameter(f"{name}{number}", low, high)
        for number in range(_FREE_GHOSTS)
        for name, low, high in (
            ("begin_s", 5.0, _LAST_BEGIN_S),
            ("lasts_s", 1.0, 60.0),
            ("who", 0.0, 1.0),
            ("rate", 0.2, 60.0),
            ("away_m", 0.0, 80.0),
            ("bearing_turn", 0.0, 1.0),
            ("above_m", -30.0, 30.0),
            ("towards_mps", -10.0, 10.0),
            ("across_mps", -10.0, 10.0),
            ("lead_s", -4.8, 4.8),
        )
    ),
)
_BASES: Final = {"up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0), "aside": (0.0, -1.0, 0.0)}
"""Direction from the own aircraft to the ghost for each push: forward, right, down."""
_LIGHT: Final = 1
"""ADSB_EMITTER_TYPE of a light aircraft."""


class Herd(Silent):
    """A ghost that stays beside the own aircraft and always seems to fly into it."""

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__(values, scene, rng)
        self._clock = Clock(values["begin_s"])
        self._side = 1.0 if rng.random() < 0.5 else -1.0

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`."""
        found = []
        for _ in range(self._clock.due(now_s, self.values["rate"])):
            ghost = self._ghost(view)
            name = f"G{int(now_s / self.values['renamed_s'])}"
            messages = report(name, now_s, ghost.position, ghost.velocity)
            found.append(Sent(WIFI_BEACON, radio_address(name), messages))
        return found

    def _ghost(self, view: View) -> Aircraft:
        """The ghost's state: at a fixed offset from the own aircraft, with its velocity and a closing one."""
        values, heading = self.values, self.scene.heading_rad
        herd = herd_of(self.scene.seed)
        forward, right, down = _BASES.get(herd, (0.0, -self._side, 0.0))
        if herd == "aircraft" and view.honest:
            # On the side opposite to the honest aircraft, so that it pushes towards that aircraft.
            gap = turned(plus(view.honest[0].position, view.own.position, -1.0), -heading)
            right = -1.0 if gap[1] > 0.0 else 1.0
        offset = (
            forward + 0.7 * values["ahead"],
            right + 0.7 * values["aside"],
            down + 0.7 * values["below"],
        )
        direction = unit(turned(offset, heading))
        position = plus(view.own.position, direction, values["away_m"])
        velocity = plus(view.own.velocity, direction, -values["closing_mps"])
        return Aircraft((position[0], position[1], min(position[2], 0.0)), velocity)


class Adsb(Herd):
    """The same ghost, as a crewed aircraft that the autopilot's ADS-B receiver hears."""

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__({**values, "rate": 1.0 / ADSB_PERIOD_S}, scene, rng)

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`: nothing is sent as Remote ID."""
        return []

    def reports(self, now_s: float, view: View) -> list[AdsbVehicle]:
        """See `Attacker.reports`."""
        found = []
        for _ in range(self._clock.due(now_s, 1.0 / ADSB_PERIOD_S)):
            ghost, geometric = self._ghost(view), self.values["geometric"] >= 0.5
            lat, lon, alt = geodetic(ghost.position)
            found.append(
                AdsbVehicle(
                    icao=0x3C0000 + int(now_s / self.values["renamed_s"]),
                    lat_deg=lat,
                    lon_deg=lon,
                    alt_m=alt + (SEPARATION_M if geometric else 0.0),
                    alt_geometric=geometric,
                    velocity_ned_mps=ghost.velocity,
                    emitter=_LIGHT,
                )
            )
        return found


class Free(Silent):
    """Several senders, each of which copies the first honest aircraft, the own one, or nobody.

    `who` selects what a sender sends. Below 0.4: a new identity, beside the own aircraft. Up to 0.8: identity
    and address of the first honest aircraft, beside that aircraft. Up to 0.9: that identity from another
    address. Above: the own aircraft's identity.
    """

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__(values, scene, rng)
        self._clocks = [Clock(values[f"begin_s{n}"]) for n in range(_FREE_GHOSTS)]

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`."""
        found = []
        for number, clock in enumerate(self._clocks):
            mine = {p.name[:-1]: self.values[p.name] for p in FREE if p.name.endswith(str(number))}
            due = clock.due(now_s, mine["rate"])
            if now_s <= mine["begin_s"] + mine["lasts_s"]:
                found += [self._frame(number, mine, now_s, view)] * due
        return found

    def _frame(self, number: int, mine: Values, now_s: float, view: View) -> Sent:
        who, target = mine["who"], view.own
        name = f"X{number}"
        address = radio_address(name)
        if 0.4 <= who < 0.9 and view.honest:
            target, name = view.honest[0], view.names[0]
            address = view.addresses[0] if who < 0.8 else address
        elif who >= 0.9:
            name = "OWN"
        turn = 2.0 * math.pi * mine["bearing_turn"]
        out: Vec3 = (math.cos(turn), math.sin(turn), 0.0)
        place = plus(plus(target.position, out, mine["away_m"]), (0.0, 0.0, -mine["above_m"]))
        velocity = plus(target.velocity, out, -mine["towards_mps"])
        velocity = plus(velocity, turned(out, math.pi / 2.0), mine["across_mps"])
        return Sent(WIFI_BEACON, address, report(name, now_s, place, velocity, lead_s=mine["lead_s"]))
