"""Made-up runs of a city."""

from __future__ import annotations

import msgspec

from ground_tools.city.cells import Row


def row(seed=1, losses=0, hours=25.0, **changes):
    """A made-up run."""
    made = Row(
        seed=seed, flights=10, arrived=5, in_the_air=5, waiting=0, not_due=0, slots=10, flight_h=hours,
        losses=losses, cruise_losses=losses // 2, collisions=0, least_m=9.0, deviation_m=4.0,
        largest_deviation_m=9.0, extra_energy=0.05, late_s=0.0, waited_s=0.0, infeasible=0.0,
        conflict=0.1, asked=3.0, age_s=1.0, old=0.1, unheard=0.2, wifi_load=0.5, ble4=10.0, ble5=0.0,
        wifi=10.0, refused=0.0, given_up=0, turned_away=0, not_measured=0,
    )  # fmt: skip
    return msgspec.structs.replace(made, **changes)


def three(losses, **changes):
    return [row(seed, losses, **changes) for seed in (1, 2, 3)]


SILENT = {"age_s": None, "old": None, "unheard": None, "wifi_load": None}
