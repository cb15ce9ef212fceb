"""Mean delay from a GNSS sample to the first message received: section "Average Transmission Delay Model".

The paper sums over GNSS periods that all begin at the same phase t0 of the receiver's scan. A phase without a
match then never receives anything, and its sum is empty. Here the phase is therefore redrawn for every
period, unless the parameters' `phases` is "same". With F the probability that a period delivers nothing,

    mean delay = (E[delay; something heard] + F T_GNSS) / (1 - F).

Both E and F are sums over the phases of products of the packets' probabilities. Phases with the same pattern
give the same product, so few terms remain (`Terms`), and a mean delay is a polynomial in the loss of one
packet.

With the parameters' `schedule` "random" the same sum is taken over events that each have a scan phase of
their own.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.arrays import Floats, Integers
from companion.remote_id.transports import BLE4, BLE5
from sitl_mocks.channel.equations.reception import event_period, matching_packets, meeting_chances, scan_of
from sitl_mocks.channel.parameters import ChannelParameters, Slots, check_rate

Hits = dict[tuple[int, ...], list[float]]
"""Weight and weighted delay (s), by the number of failed tries of each kind and the successful kind."""
Misses = dict[tuple[int, ...], float]
"""Weight by the number of failed tries of each kind."""

TRIES = 3
"""Number of kinds of tries. A try is one packet of BLE 4 or Wi-Fi, or one auxiliary packet of BLE 5, which 1
to 3 pointers announce.
"""


@dataclass(frozen=True, slots=True)
class Terms:
    """Terms of a mode and rate within one GNSS period, averaged over the phases.

    A term stands for all cases in which a try succeeds after `failed` earlier tries without success. Tries
    are distinguished by their number of pointers, 1 to `TRIES`; BLE 4 and Wi-Fi have only the first kind.
    """

    failed: Integers
    """Shape (terms, TRIES): number of earlier tries of each kind."""
    kind: Integers
    """Shape (terms,): kind of the successful try, from 0."""
    weight: Floats
    """Shape (terms,): share of the phases."""
    delay_s: Floats
    """Shape (terms,): weight times the delay (s)."""
    missed: Integers
    """Shape (cases, TRIES): number of tries of each kind in a whole period, all without success."""
    missed_weight: Floats
    """Shape (cases,): share of the phases."""
    period_s: float
    """T_GNSS in seconds."""


@lru_cache(maxsize=1024)
def terms_of(mode: str, rate: int, parameters: ChannelParameters) -> Terms:
    """Compute the terms of a mode and rate.

    Raises:
        ConfigError: the rate is less than 1 or more than the mode's largest.
    """
    check_rate(mode, rate, parameters)
    hits: Hits = defaultdict(lambda: [0.0, 0.0])
    misses: Misses = defaultdict(float)
    ble = {BLE4: parameters.ble4, BLE5: parameters.ble5}.get(mode)
    if ble is not None and ble.schedule == "random":
        _add_draws(mode, rate, parameters, hits, misses)
    else:
        _add_phases(mode, rate, parameters, hits, misses)
    keys = np.array(sorted(hits), np.int64).reshape(-1, TRIES + 1)
    values = np.array([hits[key] for key in sorted(hits)]).reshape(-1, 2)
    cases = sorted(misses)
    return Terms(
        failed=keys[:, :TRIES],
        kind=keys[:, TRIES],
        weight=values[:, 0],
        delay_s=values[:, 1],
        missed=np.array(cases, np.int64),
        missed_weight=np.array([misses[case] for case in cases]),
        period_s=parameters.gnss_period_ms / 1000.0,
    )


@lru_cache(maxsize=1024)
def _terms_by_phase(mode: str, rate: int, parameters: ChannelParameters) -> tuple[tuple[float, Terms], ...]:
    """Share of the phases with the same tries, and their terms. Phases without a try are left out."""
    slots, period_s = Slots(parameters), parameters.gnss_period_ms / 1000.0
    by_phase = _tries(mode, rate, parameters)
    found = []
    for tries, count in sorted(Counter(tuple(tries) for tries in by_phase if tries).items()):
        failed = np.zeros((len(tries) + 1, TRIES), np.int64)
        for number, (pointers, _) in enumerate(tries):
            failed[number + 1] = failed[number]
            failed[number + 1, pointers - 1] += 1
        terms = Terms(
            failed=failed[:-1],
            kind=np.array([pointers - 1 for pointers, _ in tries]),
            weight=np.ones(len(tries)),
            delay_s=np.array([slots.seconds(delay) for _, delay in tries]),
            missed=failed[-1:],
            missed_weight=np.ones(1),
            period_s=period_s,
        )
        found.append((count / len(by_phase), terms))
    return tuple(found)


def _add_phases(mode: str, rate: int, parameters: ChannelParameters, hits: Hits, misses: Misses) -> None:
    """The paper's schedule: every phase of the scan cycle has a fixed sequence of tries."""
    slots, cycle = Slots(parameters), scan_of(mode, parameters).cycle
    for tries in _tries(mode, rate, parameters):
        failed = [0] * TRIES
        for pointers, delay_slots in tries:
            term = hits[*failed, pointers - 1]
            term[0] += 1.0 / cycle
            term[1] += slots.seconds(delay_slots) / cycle
            failed[pointers - 1] += 1
        misses[tuple(failed)] += 1.0 / cycle


def _add_draws(mode: str, rate: int, parameters: ChannelParameters, hits: Hits, misses: Misses) -> None:
    """The random schedule: the sample falls anywhere between two events, and scan phases are random.

    If several packets of one BLE 4 event fall into windows, they count like several pointers: one of them is
    enough.
    """
    chance, delay_ms = meeting_chances(mode, parameters)
    before: Misses = {(0,) * TRIES: 1.0}
    for event in range(rate):
        waited_s = ((event + 0.5) * parameters.gnss_period_ms / rate + delay_ms) / 1000.0
        after: Misses = defaultdict(float)
        for failed, weight in before.items():
            after[failed] += weight * (1.0 - sum(chance))
            for kind in np.flatnonzero(chance).tolist():
                share = weight * chance[kind]
                term = hits[*failed, kind]
                term[0] += share
                term[1] += share * waited_s
                one_more = tuple(n + (k == kind) for k, n in enumerate(failed))
                after[one_more] += share
        before = after
    misses.update(before)


def _tries(mode: str, rate: int, parameters: ChannelParameters) -> list[list[tuple[int, int]]]:
    """By phase: the tries of one GNSS period in order, as number of pointers and delay in slots."""
    scan, slots = scan_of(mode, parameters), Slots(parameters)
    matches = matching_packets(mode, rate, parameters)
    tries: list[list[tuple[int, int]]] = [[] for _ in range(scan.cycle)]
    if mode != BLE5:
        for phase, slot in zip(matches.phase.tolist(), matches.slot.tolist(), strict=True):
            tries[phase].append((1, slot + scan.duration))  # D(delta) = delta - t0 + A_P or B_D
        return tries
    # D(xi) = (xi - 1) A_I + A_Offset + O_U + T_AUX, where xi is the event whose pointers were received. A_I
    # is used as in that formula, although the pointers keep the approximated interval.
    period, ble5 = event_period(mode, rate, parameters), parameters.ble5
    interval = slots.gnss_period // rate
    behind = sum(
        slots.of(x) for x in (ble5.auxiliary_offset_ms, ble5.auxiliary_uncertainty_ms, ble5.auxiliary_ms)
    )
    offsets = np.array(scan.packet_offsets)[matches.channel]
    pointers: dict[tuple[int, int], int] = defaultdict(int)
    events = matches.slot // interval if ble5.pointers == "interval" else (matches.slot - offsets) // period
    for phase, event in zip(matches.phase.tolist(), events.tolist(), strict=True):
        if event < rate:
            pointers[phase, event] += 1
    for (phase, event), count in sorted(pointers.items()):
        tries[phase].append((count, event * interval + behind))
    return tries


def link_delay_s(
    mode: str, rate: int, parameters: ChannelParameters, first: Floats, second: Floats
) -> Floats:
    """Mean delay (s) of links of a mode and rate. Arguments and result are those of `mean_delay_s`.

    Raises:
        ConfigError: the rate is less than 1 or more than the mode's largest.
    """
    ble = {BLE4: parameters.ble4, BLE5: parameters.ble5}.get(mode)
    if parameters.phases == "redrawn" or (ble is not None and ble.schedule == "random"):
        return mean_delay_s(terms_of(mode, rate, parameters), first, second)
    check_rate(mode, rate, parameters)
    delay = np.zeros_like(first)
    for share, terms in _terms_by_phase(mode, rate, parameters):
        delay += share * mean_delay_s(terms, first, second)
    return delay


def mean_delay_s(terms: Terms, first: Floats, second: Floats) -> Floats:
    """Mean delay (s) from a GNSS sample to the first message received that carries it or a later one.

    Args:
        first: probability that one packet survives (BLE 5: one pointer); any shape.
        second: probability that the auxiliary packet survives; 1 for BLE 4 and Wi-Fi. Same shape.

    Returns:
        Same shape; infinite where no message can ever arrive.
    """
    kinds = range(1 + int(terms.kind.max(initial=0)))
    # P_succ of each kind of try, and the powers of its complement.
    success = [(1.0 - (1.0 - first) ** (kind + 1)) * second for kind in kinds]
    powers = [_powers(1.0 - success[kind], int(terms.missed[:, kind].max())) for kind in kinds]

    def failing(counts: Integers) -> Floats:
        result: Floats = powers[0][counts[0]]
        for kind in kinds[1:]:
            result = result * powers[kind][counts[kind]]
        return result

    delivered, delay = np.zeros_like(first), np.zeros_like(first)
    for counts, kind, weight, weighted in zip(
        terms.failed, terms.kind, terms.weight, terms.delay_s, strict=True
    ):
        chance = failing(counts) * success[kind]
        delivered += weight * chance
        delay += weighted * chance
    nothing = np.zeros_like(first)
    for counts, weight in zip(terms.missed, terms.missed_weight, strict=True):
        nothing += weight * failing(counts)
    with np.errstate(divide="ignore"):
        return np.asarray((delay + nothing * terms.period_s) / delivered, float)


def _powers(base: Floats, largest: int) -> list[Floats]:
    powers = [np.ones_like(base)]
    for _ in range(largest):
        powers += [powers[-1] * base]
    return powers


def single_link_s(mode: str, rate: int, parameters: ChannelParameters) -> float:
    """Mean delay (s) of one sender and one receiver alone.

    Raises:
        ConfigError: the rate is less than 1 or more than the mode's largest.
    """
    one = np.ones(1)
    return float(link_delay_s(mode, rate, parameters, one, one)[0])
