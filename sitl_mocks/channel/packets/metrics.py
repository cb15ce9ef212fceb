"""Delay, age of information, loss and coverage from the results of a packet simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import Floats, Integers
from companion.errors import ConfigError
from sitl_mocks.channel.packets.simulation import Result

_BATCHES = 20


@dataclass(frozen=True, slots=True)
class SampleDelay:
    """Delay of GNSS samples, from each transmitter (row) to each receiver (column) in each mode."""

    mean_s: Floats
    """Shape (nodes, nodes, 3). NaN where the mode is not carried, inf where no counted sample arrived."""
    standard_error_s: Floats
    """Shape (nodes, nodes, 3); NaN where there is no finite mean."""
    open_samples: Integers
    """Shape (nodes, nodes, 3): counted samples without an arrival by the end of the run. They enter with the
    time for which they have waited, so the mean is a lower bound if there are any.
    """
    pooled_s: Floats
    """Shape (3,): mean over the pairs with a finite mean; NaN where a mode has none."""
    pooled_error_s: Floats
    """Standard error of `pooled_s`, shape (3,)."""


def sample_delay_s(result: Result, tail_s: float | None = None) -> SampleDelay:
    """The paper's delay: from a GNSS sample until a message with it, or with a later one, has arrived.

    Samples taken from 0 s until `tail_s` before the end of the run are counted. This choice does not depend
    on the outcome, so leaving out the last samples favours neither long nor short delays. The tail must be
    long enough for `open_samples` to be 0. Standard errors come from the means of 20 successive pieces of the
    run, because one arrival may serve many samples. They hold for the phases and clocks of this run. The
    variation between drawings of phases and clocks shows only in runs with other seeds. It is the larger part
    where schedules keep step: with the "paper" advertiser, for Wi-Fi, which has no random delay, and for some
    minutes even for Bluetooth, whose random delay is short compared with its interval.

    Args:
        result: result of `simulate`.
        tail_s: default is a fifth of the run.

    Raises:
        ConfigError: no sample is left to count.
    """
    tail_s = result.duration_s / 5.0 if tail_s is None else tail_s
    nodes = len(result.first_sample_s)
    mean, error = np.full((2, nodes, nodes, 3), np.nan)
    open_samples = np.zeros((nodes, nodes, 3), np.int64)
    pooled: list[list[Floats]] = [[], [], []]
    for node, mode in zip(*np.nonzero(result.carried.any(axis=1)), strict=True):
        delay = _delays_s(result, int(node), int(mode), tail_s)
        to = result.carried[node, :, mode]
        waiting = np.isinf(delay)
        heard = to & ~waiting.all(axis=0)
        waited = (result.duration_s - _sample_times_s(result, int(node), tail_s))[:, None]
        delay = np.where(waiting, waited, delay)
        pieces = np.array([piece.mean(axis=0) for piece in np.array_split(delay, min(_BATCHES, len(delay)))])
        mean[node, to, mode] = np.where(heard, delay.mean(axis=0), np.inf)[to]
        open_samples[node, to, mode] = waiting.sum(axis=0)[to]
        error[node, heard, mode] = _standard_error(pieces)[heard]
        if len(pieces) == _BATCHES:
            pooled[mode].append(pieces[:, heard])
    finite = np.isfinite(mean)
    pairs = finite.sum(axis=(0, 1))
    with np.errstate(invalid="ignore"):
        pooled_mean = np.where(finite, mean, 0.0).sum(axis=(0, 1)) / pairs
    together = [np.concatenate(p, axis=1) if p else np.zeros((_BATCHES, 0)) for p in pooled]
    pooled_error = [_standard_error(p.mean(axis=1)) if p.shape[1] else np.nan for p in together]
    return SampleDelay(mean, error, open_samples, pooled_mean, np.array(pooled_error, float))


def loss(result: Result) -> Floats:
    """Share of hearable packets (BLE 5: messages) lost to others, shape (nodes, nodes, 3). NaN without
    any.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(result.lost / result.hearable, float)


def never_heard(result: Result) -> float:
    """Share of the pairs in reach in any mode that exchanged nothing in the whole run. NaN without pairs."""
    in_reach = result.carried.any(axis=2)
    heard = np.zeros_like(in_reach)
    heard[result.transmitter[result.heard_event], result.heard_by] = True
    pairs = int(in_reach.sum())
    return float((in_reach & ~heard).sum() / pairs) if pairs else math.nan


def _sample_times_s(result: Result, node: int, tail_s: float) -> Floats:
    """Times of a transmitter's counted samples. Sample 0 lies before 0 s and is not counted."""
    first, period = result.first_sample_s[node], result.gnss_period_s
    count = math.floor((result.duration_s - tail_s - first) / period)
    if count < 1:
        raise ConfigError(f"tail_s: {tail_s:g} leaves no sample in a run of {result.duration_s:g} s")
    return np.asarray(first + np.arange(1, count + 1) * period, float)


def _delays_s(result: Result, node: int, mode: int, tail_s: float) -> Floats:
    """Delay of each counted sample to each receiver (s), shape (samples, nodes); inf if it did not arrive."""
    taken_s = _sample_times_s(result, node, tail_s)
    event = result.heard_event
    own = np.nonzero((result.transmitter[event] == node) & (result.mode[event] == mode))[0]
    sample = result.sample[event[own]]
    samples = max(len(taken_s) + 1, int(sample.max(initial=0)) + 1)
    arrival = np.full((samples, len(result.first_sample_s)), np.inf)
    np.minimum.at(arrival, (sample, result.heard_by[own]), result.heard_s[own])
    # A message with a later sample serves all earlier ones.
    arrival = np.minimum.accumulate(arrival[::-1], axis=0)[::-1]
    return np.asarray(arrival[1 : len(taken_s) + 1] - taken_s[:, None], float)


def _standard_error(pieces: Floats) -> Floats:
    """Standard error of the mean of successive pieces, along the first axis; NaN for fewer than two."""
    if len(pieces) < 2:
        return np.full(pieces.shape[1:], np.nan)
    return np.asarray(pieces.std(axis=0, ddof=1) / math.sqrt(len(pieces)), float)
