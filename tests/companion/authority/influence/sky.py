"""Neighbours and their allowances over time, in place of a law that finds all of them in conflict."""

from __future__ import annotations

import msgspec

from companion.authority.influence.allowance import Allowances
from companion.avoidance.law import LawResult, Neighbour
from companion.config import Config, ContainmentConfig, IdentityConfig
from companion.events import AllowanceSpent, TrackView

SHORT = ContainmentConfig(
    track_s=40.0, inside_s=20.0, group_s=60.0, total_s=100.0, refill_s=1000.0, crewed_total_s=50.0
)

ZERO = (0.0, 0.0, 0.0)


def other(name, *, at=(20.0, 0.0, 0.0), velocity=(1.0, 0.0, 0.0), **fields):
    return Neighbour(name, at, velocity, 0.0, 3.0, **fields)


class Sky:
    """What is heard, how far it moves, and what the law would say of it: all of it is in conflict."""

    def __init__(self, config=SHORT, use="fly"):
        made = Config(identity=IdentityConfig(uas_id="OWN"), containment=config)
        flight = msgspec.structs.replace(made.flight, use=use)
        self.all = Allowances(msgspec.structs.replace(made, flight=flight))
        self.now_s = 0.0
        self.told = []
        self.hold = None
        self.quiet = set()
        """Tracks that are in no conflict."""

    def run(self, seconds, *others, radius_m=10.0, height_m=0.0, held=True, back=False):
        """Names of the tracks that were avoided at the end."""
        admitted = []
        for _ in range(round(seconds / 0.2)):
            self.now_s += 0.2
            others = [
                msgspec.structs.replace(
                    o,
                    position_ned_m=tuple(
                        p + 0.2 * v for p, v in zip(o.position_ned_m, o.velocity_ned_mps, strict=True)
                    ),
                )
                for o in others
            ]
            admitted = self.all.admitted(self.now_s, ZERO, ZERO, others)
            views = tuple(
                TrackView(
                    track_id=o.track_id, position_ned_m=o.position_ned_m, velocity_ned_mps=o.velocity_ned_mps,
                    age_s=0.0, radius_m=radius_m, conflict=o.track_id not in self.quiet,
                    time_to_closest_s=5.0, closest_m=0.0, active=o.track_id not in self.quiet, adsb=o.adsb,
                    height_m=height_m, yields=o.yields,
                )
                for o in admitted
            )  # fmt: skip
            result = LawResult(ZERO, ZERO, True, bool(views), False, (), views)
            self.all.charge(self.now_s, ZERO, ZERO, result, held=held, back=back)
            self.told += self.all.told()
            self.hold = self.hold or self.all.hold
        self.yielding = {o.track_id for o in admitted if o.yields}
        self.pressing = {o.track_id for o in admitted if o.presses}
        return [o.track_id for o in admitted]

    def scopes(self):
        return [(c.scope, c.spent) for c in self.told if isinstance(c, AllowanceSpent)]
