"""System delay and loss when every aircraft uses one mode at one rate, over sizes and rates, by Monte Carlo.

This reproduces the paper's section "Performance of Remote ID Modes". New positions are drawn for every
environment. All modes, rates and sigmas use the same environments of a side, so that their differences do not
come from the draw.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np

from companion.arrays import Floats
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from sitl_mocks.channel.equations.analytic import Analytic, Fleet, fixed_rates, system_delay_s, wifi_channels
from sitl_mocks.channel.link_budget import Links, all_links, draw_positions
from sitl_mocks.channel.parameters import MODES, ChannelParameters

Reading = Literal["shared", "random"]
READINGS: Final[tuple[Reading, ...]] = ("shared", "random")

_LINKS_AT_ONCE = 90_000
"""Approximate number of links that are evaluated in one batch. It bounds the memory."""
NAMES: Final = {BLE4: "BLE 4", BLE5: "BLE 5", WIFI_BEACON: "Wi-Fi"}


@dataclass(frozen=True, slots=True)
class Settings:
    """Selection of what is evaluated."""

    parameters: ChannelParameters
    sides_m: tuple[float, ...]
    rates: dict[str, tuple[int, ...]]
    """Message rates (messages in a GNSS period) of each mode that is evaluated."""
    sigmas_db: tuple[float, ...]
    uavs: int
    samples: int
    """Number of environments of each side, at least 2."""
    seed: int


@dataclass(frozen=True, slots=True)
class Row:
    """Result for one mode at one rate in squares of one side."""

    mode: str
    rate: int
    side_m: float
    sigma_db: float
    wifi_channels: Reading
    """How beacons are distributed over the Wi-Fi channels. "shared" for BLE, for which it has no effect."""
    system_delay_ms: float | None
    """System delay (P0): the sum over the aircraft of each one's mean delay to those it reaches (0 if it
    reaches none), averaged over the environments. None if some message never arrives."""
    system_delay_se_ms: float | None
    """Monte Carlo standard error of the system delay."""
    loss: float | None
    """Mean loss over all links that carry the mode; None if no environment has such a link."""
    loss_se: float | None
    uavs: int
    samples: int


@dataclass(frozen=True, slots=True)
class Case:
    """The conditions of one row, within one side and sigma."""

    mode: str
    reading: Reading
    rate: int


def name_of(mode: str, reading: Reading) -> str:
    """Display name of a mode. For Wi-Fi it includes how the channels are assigned."""
    return f"{NAMES[mode]} {reading}" if mode == WIFI_BEACON else NAMES[mode]


def cases_of(settings: Settings) -> tuple[Case, ...]:
    """The cases of one side and sigma."""
    return tuple(
        Case(mode, reading, rate)
        for mode in MODES
        for reading in (READINGS if mode == WIFI_BEACON else READINGS[:1])
        for rate in settings.rates.get(mode, ())
    )


def batches_of(settings: Settings) -> tuple[int, ...]:
    """Number of environments in each batch."""
    largest = max(1, _LINKS_AT_ONCE // (settings.uavs * (settings.uavs - 1)))
    whole, rest = divmod(settings.samples, largest)
    return (largest,) * whole + ((rest,) if rest else ())


def evaluate(settings: Settings, advance: Callable[[], None] = lambda: None) -> Iterator[list[Row]]:
    """Evaluate all rows, by sigma and then by side; `advance` is called after each batch."""
    for sigma_db in settings.sigmas_db:
        for side_m in settings.sides_m:
            yield evaluate_side(settings, side_m, sigma_db, advance)


def evaluate_side(
    settings: Settings, side_m: float, sigma_db: float, advance: Callable[[], None] = lambda: None
) -> list[Row]:
    """Evaluate the rows of one side and sigma; `advance` is called after each batch."""
    propagation = msgspec.structs.replace(settings.parameters.propagation, shadowing_sigma_db=sigma_db)
    parameters = msgspec.structs.replace(settings.parameters, propagation=propagation)
    model, uavs = Analytic(parameters), settings.uavs
    # The side is part of the seed, so that a row does not depend on which other rows are evaluated.
    bits = int.from_bytes(struct.pack("<d", side_m), "little")
    place, shadow, channel = map(
        np.random.default_rng, np.random.SeedSequence([settings.seed, bits]).spawn(3)
    )
    found: dict[Case, list[_Batch]] = {case: [] for case in cases_of(settings)}
    for environments in batches_of(settings):
        positions = draw_positions(environments, uavs, side_m, place)
        links = all_links(positions, parameters.propagation, shadow)
        # Drawn once and not for each case, so that a row does not depend on the other rows.
        channels = {
            reading: wifi_channels(
                links.nodes, msgspec.structs.replace(parameters, wifi_channels=reading), channel
            )
            for reading in READINGS
        }
        for case, batches in found.items():
            fleet = Fleet(fixed_rates(links.nodes, case.mode, case.rate), channels[case.reading])
            batches.append(_batch(model, links, fleet, MODES.index(case.mode), environments))
        advance()
    return [_row(case, side_m, sigma_db, batches, settings) for case, batches in found.items()]


@dataclass(frozen=True, slots=True)
class _Batch:
    """Results of one batch, each of shape (environments,)."""

    system_delay_s: Floats
    lost: Floats
    """Sum of the losses of the links that carry the mode."""
    carrying: Floats
    """Number of links that carry the mode."""


def _batch(model: Analytic, links: Links, fleet: Fleet, mode: int, environments: int) -> _Batch:
    evaluation = model.evaluate(links, fleet)
    carrying = np.flatnonzero(evaluation.carried[:, mode])
    environment = links.transmitter[carrying] // (links.nodes // environments)
    return _Batch(
        system_delay_s(evaluation, environments),
        np.bincount(environment, evaluation.loss[carrying, mode], environments).astype(float),
        np.bincount(environment, minlength=environments).astype(float),
    )


def _row(case: Case, side_m: float, sigma_db: float, batches: list[_Batch], settings: Settings) -> Row:
    delay_ms, delay_se_ms = mean_and_error(1000.0 * np.concatenate([b.system_delay_s for b in batches]))
    loss, loss_se = ratio_and_error(
        np.concatenate([b.lost for b in batches]), np.concatenate([b.carrying for b in batches])
    )
    return Row(
        mode=case.mode,
        rate=case.rate,
        side_m=side_m,
        sigma_db=sigma_db,
        wifi_channels=case.reading,
        system_delay_ms=delay_ms,
        system_delay_se_ms=delay_se_ms,
        loss=loss,
        loss_se=loss_se,
        uavs=settings.uavs,
        samples=settings.samples,
    )


def mean_and_error(values: Floats) -> tuple[float, float] | tuple[None, None]:
    """Mean and its standard error; None for both if a value is not finite."""
    if not np.isfinite(values).all():
        return None, None
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values))


def ratio_and_error(parts: Floats, counts: Floats) -> tuple[float, float] | tuple[None, None]:
    """Sum of the parts divided by the sum of the counts, and its standard error by the delta method.

    The delta method applies because the environments are independent, while the links of one environment are
    not. None for both if the counts are all 0.
    """
    total = float(counts.sum())
    if total == 0.0:
        return None, None
    ratio = float(parts.sum()) / total
    samples = len(counts)
    spread = float(((parts - ratio * counts) ** 2).sum()) / (samples - 1)
    return ratio, math.sqrt(spread * samples) / total
