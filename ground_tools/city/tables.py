"""The state of all aircraft in the air, in arrays that the compiled loop works on.

An aircraft in the air has a *slot*, a row of these tables. Each sender that it may hear has a *link*, and
each aircraft that it knows has a *track*. All of them are bounded and allocated before the flight.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.arrays import Float32s, Floats, Integers
from companion.avoidance import kernels as k
from ground_tools.campaign.vehicles import MESSAGE_COLUMNS, Fleet, on_the_ground
from ground_tools.campaign.world import Conditions
from sitl_mocks.channel.parameters import MODES

Numbers = NDArray[np.int32]
NOBODY = -1
NEAR_MOST = 32
"""Most near aircraft of one aircraft whose distances are measured at every step."""
HISTORY = 512
"""Length of the history of own velocities. At five decisions a second, half of it is 51 s, which is more than
the age of the oldest message."""
_LINE = 8
"""Numbers in double precision in a cache line."""
BURST = 10
"""Number of new tracks that are remembered to recognise those that appear together (`eviction.OPENED`)."""


class Air(NamedTuple):
    """State of the aircraft in M slots; NED, m and s."""

    flight: Integers
    """(M,): number of its flight, or NOBODY."""
    begun_s: Floats
    """(M,): when it departed."""
    command: Floats
    """(M, 3): last command of the law; this and the following are the fields of `kernels.State`."""
    decided_s: Floats
    """(M,)."""
    quiet: Floats
    """(M,)."""
    late_s: Floats
    """(M,)."""
    samples: Integers
    """(M,)."""
    times_s: Floats
    """(M, HISTORY)."""
    velocities: Floats
    """(M, HISTORY, 3)."""
    rates: Integers
    """(M, 3): Locations per second by transport, in the order of `MODES`."""
    gap_m: Floats
    """(M,): distance from its timed point."""
    conflict: Floats
    """(M,): 1 if the last decision saw a conflict."""
    change: Floats
    """(M,): `tracks.Scope.change` with which the next decision is tried first, m/s."""
    changed: Floats
    """(M, 3): sums of the changes of the own velocity, m/s, in the interval that began at the time in the
    third column (s), and in the interval before it."""


class Tracks(NamedTuple):
    """What each of M aircraft knows of up to K others."""

    who: Numbers
    """(M, K): number of the flight, or NOBODY."""
    used: Integers
    """(M,): number of rows in use; the rows from this one on are free."""
    heard: Floats
    """(M, K, MESSAGE_COLUMNS): the latest message, which is the first columns of `past`."""
    past: Floats
    """(M, K, columns of `kernels.Past`)."""
    got_s: Floats
    """(M, K): when the latest message was received."""
    messages: Floats
    """(M, K): number of messages."""
    threat_s: Floats
    """(M, K): when the other aircraft was last a threat."""
    together: Floats
    """(M, K): 1 if the track appeared in a burst of new tracks."""
    on_s: Floats
    """(M, K, 3): when the sender was last received on each transport, in single precision."""
    opened_s: Floats
    """(M, BURST): when the latest tracks appeared."""
    opened: Integers
    """(M,): how many tracks have appeared."""
    counts: Integers
    """(2,): tracks given up because a table was full, and newcomers that a full table refused."""
    beyond_m: Floats
    """(M, K): a track matters to no decision for which `tracks.needed_m` is at most this; -infinity: not
    known. It holds for the present message and until the time in `anchor`."""
    anchor: Floats
    """(M, 3): place, north and east, to which `beyond_m` refers, and the time until which it holds."""


class Links(NamedTuple):
    """Which aircraft may receive which: E links, sorted by receiver and sender."""

    start: Integers
    """(M + 1,): first link of each receiver."""
    other: Numbers
    """(E,): slot of the sender."""
    back: Numbers
    """(E,): the link in the opposite direction."""
    row: Numbers
    """(E,): track of the sender in the receiver's table; may be out of date (compare `Tracks.who`)."""
    modes: NDArray[np.uint8]
    """(E,): transports that carry the link, one bit each."""
    due_s: Floats
    """(E,): no message in transit arrives before this."""
    arrival: Floats
    """(E, slots): when each of the sender's latest messages arrives; infinite: never, or received."""
    by: Floats
    """(E, slots): transports on which that message arrives, one bit each."""
    chance: Float32s
    """(E, 3): log of the probability that one frame on a transport is not received, 0 or less. It is that of
    the opposite direction (`back`), so that a sender has those of all its receivers together."""


class Near(NamedTuple):
    """Pairs whose distance is measured at every step, each stored under the higher of its two slots."""

    number: Integers
    """(M,): number of pairs."""
    other: Numbers
    """(M, NEAR_MOST): the lower slot of each pair."""
    event: Numbers
    """(M, NEAR_MOST): number of the pair's present loss of separation, or NOBODY."""


def new_fleet(slots: int, world: Conditions) -> Fleet:
    """The campaign's fleet without its matrix of arrivals, which `Links` replace here."""
    few = on_the_ground(1, world)
    made: list[Any] = [np.zeros((slots, *array.shape[1:]), array.dtype) for array in few[:-1]]
    made.append(np.full((slots, 1, few.sent.shape[1]), math.inf))
    return Fleet._make(made)


def new_air(slots: int) -> Air:
    """Empty slots."""
    return Air(
        flight=np.full(slots, NOBODY, np.int64),
        begun_s=np.zeros(slots),
        command=np.zeros((slots, 3)),
        decided_s=np.full(slots, math.nan),
        quiet=np.zeros(slots),
        late_s=np.zeros(slots),
        samples=np.zeros(slots, np.int64),
        times_s=np.zeros((slots, HISTORY)),
        velocities=np.zeros((slots, HISTORY, 3)),
        rates=np.zeros((slots, len(MODES)), np.int64),
        gap_m=np.zeros(slots),
        conflict=np.zeros(slots),
        change=np.zeros(slots),
        changed=np.zeros((slots, 3)),
    )


def _aligned(shape: tuple[int, ...]) -> Floats:
    """Zeros that begin at a boundary of cache lines, so that rows of whole lines are not spread over more."""
    size = math.prod(shape)
    raw = np.zeros(size + _LINE)
    first = -raw.ctypes.data // raw.itemsize % _LINE
    return raw[first : first + size].reshape(shape)


def new_tracks(slots: int, most: int) -> Tracks:
    """Empty tables of up to `most` tracks for each slot."""
    # What is stored of a track is contiguous, beginning with what decisions need: with many aircraft, most
    # time goes to fetching it from memory.
    past = len(k.NO_PAST)
    rows = _aligned((slots, most, 1 + past + 3 + len(MODES)))
    return Tracks(
        who=np.full((slots, most), NOBODY, np.int32),
        used=np.zeros(slots, np.int64),
        heard=rows[:, :, 1 : 1 + MESSAGE_COLUMNS],
        past=rows[:, :, 1 : 1 + past],
        got_s=rows[:, :, 0],
        messages=rows[:, :, past + 1],
        threat_s=rows[:, :, past + 2],
        together=rows[:, :, past + 3],
        on_s=rows[:, :, past + 4 :],
        opened_s=np.full((slots, BURST), -math.inf),
        opened=np.zeros(slots, np.int64),
        counts=np.zeros(2, np.int64),
        beyond_m=np.full((slots, most), -math.inf),
        anchor=np.full((slots, 3), -math.inf),
    )


def new_links(slots: int, links: int, messages: int) -> Links:
    """Room for the given number of links, each with the given number of messages in transit."""
    transit = _aligned((links, 2 * messages))
    return Links(
        start=np.zeros(slots + 1, np.int64),
        other=np.zeros(links, np.int32),
        back=np.zeros(links, np.int32),
        row=np.zeros(links, np.int32),
        modes=np.zeros(links, np.uint8),
        due_s=np.full(links, math.inf),
        arrival=transit[:, :messages],
        by=transit[:, messages:],
        chance=np.zeros((links, len(MODES)), np.float32),
    )


def new_near(slots: int) -> Near:
    """No pairs."""
    return Near(
        np.zeros(slots, np.int64),
        np.zeros((slots, NEAR_MOST), np.int32),
        np.full((slots, NEAR_MOST), NOBODY, np.int32),
    )
