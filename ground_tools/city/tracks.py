"""What an aircraft knows of the others: received messages become tracks, and tracks become the law's
neighbours.

As aboard (`companion.traffic`), a table holds a bounded number of tracks, learns from each message how far an
aircraft deviates from its predictions, and gives up tracks in the order of `companion.traffic.eviction`. Here
there are no signal strengths and no false positions, so no sender is doubted or has a second position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import GROWTH_AHEAD_S, Volume, volume_of
from ground_tools.campaign.vehicles import M_POSITION, M_TIME, M_VELOCITY, MESSAGE_COLUMNS, Fleet
from ground_tools.campaign.world import Conditions
from ground_tools.city.compiled import compiled, fetch
from ground_tools.city.judging import Judge, give_up, loss_s, threatens
from ground_tools.city.tables import BURST, NOBODY, Air, Links, Tracks

_OPENED_S = 2.0
_FASTER = 1.1
"""Bound of an aircraft's speed, as a multiple of its law's greatest speed."""
_SLACK_M = 1e-3
"""Allowance for rounding."""
_SHARE = 0.5
"""`kernels.Other.share` of every track."""
SURE_S = 2.0
"""Time for which `Tracks.beyond_m` is computed."""
TURNS = 16
"""Number of own velocities in `Desk.turns`: three seconds, more than the age of most messages."""
_NO_PAST = tuple(k.NO_PAST)
_compiled = compiled()
_inlined = compiled(forceinline=True)


class Desk(NamedTuple):
    """Tables for one decision, shared by all aircraft."""

    neighbours: Floats
    """(K, columns of `kernels.Other`)."""
    order: Integers
    """(K,): tracks in the order of their flights."""
    names: Integers
    """(K,): their flights."""
    due: Integers
    """(slots,): links on which messages may have arrived."""
    turns: Floats
    """(2, TURNS): times of the latest own velocities, latest first, and the square of the greatest difference
    of these and all later ones from the present velocity, m^2/s^2."""
    standings: Integers
    """(K + 1, `judging.COLUMNS`)."""
    crowds: Integers
    """(`judging.PLACES`,)."""


@_inlined
def receive(
    now: float, world: Conditions, i: int, craft: Fleet, air: Air, tracks: Tracks, links: Links,
    judge: Judge, desk: Desk,
) -> None:  # fmt: skip
    """Take the messages that aircraft i has received into its tracks."""
    due, count = desk.due, 0
    for e in range(links.start[i], links.start[i + 1]):
        due[count] = e
        count += 1 if links.due_s[e] <= now else 0
    for at in range(count):
        e = due[at]
        fetch(links.arrival, (e, 0))
        fetch(craft.sent, (links.other[e], 0, 0))
        if links.row[e] != NOBODY:
            _fetch_first(i, links.row[e], tracks)
            fetch(tracks.on_s, (i, links.row[e], 0))
    for at in range(count):
        e = due[at]
        links.due_s[e] = math.inf
        for s in range(links.arrival.shape[1]):
            if links.arrival[e, s] <= now:
                links.arrival[e, s] = math.inf
                _take(now, world, i, e, s, craft, air, tracks, links, judge, desk)
            links.due_s[e] = min(links.due_s[e], links.arrival[e, s])


@_inlined
def _fetch_first(i: int, row: int, tracks: Tracks) -> None:
    """Ask for what decisions read of a track."""
    fetch(tracks.got_s, (i, row))
    fetch(tracks.past, (i, row, MESSAGE_COLUMNS))


@_compiled
def _take(
    now: float, world: Conditions, i: int, e: int, s: int, craft: Fleet, air: Air, tracks: Tracks,
    links: Links, judge: Judge, desk: Desk,
) -> None:  # fmt: skip
    """Take one message into the track of its sender."""
    j, row = links.other[e], links.row[e]
    who = air.flight[j]
    if who == NOBODY:
        return
    if row == NOBODY or tracks.who[i, row] != who:
        row = _find(i, who, tracks)
        if row == NOBODY:
            row = _open(now, world, i, craft.sent[j, s], who, craft, tracks, judge, desk)
        links.row[e] = row
        if row == NOBODY:
            return
    by = int(links.by[e, s])
    for m in range(tracks.on_s.shape[2]):
        if by & (1 << m):
            tracks.on_s[i, row, m] = np.float32(now)
    sent = craft.sent[j, s]
    if sent[M_TIME] > tracks.heard[i, row, M_TIME]:
        tracks.beyond_m[i, row] = -math.inf
        tracks.got_s[i, row] = now
        tracks.messages[i, row] += 1.0
        p, v = sent[M_POSITION:M_VELOCITY], sent[M_VELOCITY:MESSAGE_COLUMNS]
        past = k.note_track(
            k.past_at(tracks.past[i], row), sent[M_TIME], (p[0], p[1], p[2]), (v[0], v[1], v[2]),
            world.declared_m,
        )  # fmt: skip
        k.put_past(tracks.past[i], row, past)
        if 2 * tracks.used[i] >= tracks.who.shape[1] and threatens(now, world, i, row, craft, tracks, judge):
            tracks.threat_s[i, row] = now


@_compiled
def _find(i: int, who: int, tracks: Tracks) -> int:
    """The track of a flight, or NOBODY."""
    for row in range(tracks.used[i]):
        if tracks.who[i, row] == who:
            return row
    return NOBODY


@_compiled
def _open(
    now: float, world: Conditions, i: int, sent: Floats, who: int, craft: Fleet, tracks: Tracks,
    judge: Judge, desk: Desk,
) -> int:  # fmt: skip
    """Open a track. Returns its row, or NOBODY if the table is full of more important tracks."""
    oldest = tracks.opened_s[i, tracks.opened[i] % BURST]
    together = now - oldest <= _OPENED_S
    tracks.opened_s[i, tracks.opened[i] % BURST] = now
    tracks.opened[i] += 1
    row = NOBODY
    for r in range(tracks.used[i]):
        if tracks.who[i, r] == NOBODY:
            row = r
            break
    if row == NOBODY and tracks.used[i] < tracks.who.shape[1]:
        row = tracks.used[i]
        tracks.used[i] += 1
    if row == NOBODY:
        row = give_up(now, world, i, sent, who, craft, tracks, judge, desk.standings, desk.crowds)
        tracks.counts[0 if row != NOBODY else 1] += 1
        if row == NOBODY:
            return NOBODY
    tracks.who[i, row] = who
    tracks.messages[i, row] = 0.0
    tracks.beyond_m[i, row] = -math.inf
    tracks.together[i, row] = 1.0 if together else 0.0
    for m in range(tracks.on_s.shape[2]):
        tracks.on_s[i, row, m] = -math.inf
    k.put_past(tracks.past[i], row, _NO_PAST)
    away = loss_s(world, i, sent, max(now - sent[M_TIME], 0.0), 0.0, craft, judge)
    tracks.threat_s[i, row] = now if away <= judge.ahead_s else -math.inf
    return int(row)


class Scope(NamedTuple):
    """Largest assumed differences (m/s) between an aircraft's present velocity and others of its own."""

    change: float
    """Difference from the velocities that a decision considers."""
    turned: float
    """Difference from the own velocities at the times of the received messages."""


@_compiled
def everything(own: k.Own, law: k.Settings) -> float:
    """`Scope.change` that covers all velocities that an aircraft can fly, also if it is faster than the law
    allows: in gusts, or because it began so."""
    v = own.velocity
    ours = math.sqrt(v.n * v.n + v.e * v.e + v.d * v.d)
    return max(2.0 * _FASTER * law.speed_mps, law.speed_mps + ours)


@_compiled
def certain(own: k.Own, law: k.Settings, decision: k.Decision, change: float) -> bool:
    """Whether a decision is the same with all neighbours that do not matter for this `Scope.change`.

    The linear program adds one plane after the other, and each one moves the result farther away from the
    wanted velocity. So no velocity that it considers is farther from it than the final result.
    """
    w, s, v = decision.wanted, decision.solved, own.velocity
    aside = math.sqrt((w.n - v.n) ** 2 + (w.e - v.e) ** 2 + (w.d - v.d) ** 2)
    aside += math.sqrt((w.n - s.n) ** 2 + (w.e - s.e) ** 2 + (w.d - s.d) ** 2)
    if decision.conflict:  # the wanted velocity may have been turned
        aside += 2.0 * law.right_rad * math.sqrt(w.n * w.n + w.e * w.e + w.d * w.d)
    return decision.feasible and aside <= change


@_compiled
def matters(own: k.Own, other: k.Other, volume: Volume, law: k.Settings, scope: Scope) -> bool:
    """Whether a neighbour can make any difference to a decision.

    If not, every velocity v within the scope satisfies its plane, and none enters its volume within the time
    of the conflict test. The plane asks for n . (v - v_then) >= share s, where -s is the distance from the
    relative velocity to the truncated cone of the velocity obstacle. That lies beyond (p - R) / tau, seen
    from the origin towards p.
    """
    stretch = max(volume.scale, 1.0)
    n = other.n + other.age_s * other.vn - own.position.n
    e = other.e + other.age_s * other.ve - own.position.e
    d = volume.scale * (other.d + other.age_s * other.vd - own.position.d)
    away = math.sqrt(n * n + e * e + d * d)
    gap = away - volume.radius
    if gap <= 0.0:
        return True
    v = own.velocity
    closing = (n * (v.n - other.vn) + e * (v.e - other.ve) + d * volume.scale * (v.d - other.vd)) / away
    if other.silent != 0.0:
        speed = math.sqrt(other.vn * other.vn + other.ve * other.ve + other.vd * other.vd)
        ours = math.sqrt(v.n * v.n + v.e * v.e + v.d * v.d)
        gap -= other.age_s * speed * stretch
        closing = stretch * (speed + ours)
    turned, change = stretch * scope.turned, stretch * scope.change
    plane = volume.horizon_s * (closing + turned + (change + turned) / other.share)
    look = max(law.look_s, volume.horizon_s)
    return gap < max(plane, look * (closing + change)) + _SLACK_M


@_inlined
def needed_m(now: float, i: int, own: k.Own, law: k.Settings, scope: Scope, tracks: Tracks) -> float:
    """The part of the distance at which a neighbour can matter that depends on the aircraft itself, m.

    It includes the distance from `Tracks.anchor`. When its time is over, the anchor becomes the present
    place, and nothing is known of any track.
    """
    anchor = tracks.anchor[i]
    if now > anchor[2]:
        anchor[0], anchor[1], anchor[2] = own.position.n, own.position.e, now + SURE_S
        for row in range(tracks.used[i]):
            tracks.beyond_m[i, row] = -math.inf
    n, e, v = own.position.n - anchor[0], own.position.e - anchor[1], own.velocity
    ours = math.sqrt(v.n * v.n + v.e * v.e + v.d * v.d)
    plane = law.horizon_s * (ours + scope.turned + (scope.change + scope.turned) / _SHARE)
    return math.sqrt(n * n + e * e) + max(plane, max(law.look_s, law.horizon_s) * (ours + scope.change))


@_compiled
def _beyond(
    now: float, i: int, row: int, known: k.Other, later: k.Other, own: k.Own, law: k.Settings, tracks: Tracks
) -> float:
    """`Tracks.beyond_m` of a track.

    It follows from `matters`. Let L be the longer of `horizon_s` and `look_s`, and q the stretch. No two
    aircraft close faster than the sum of their speeds, scaled by at most q. So a neighbour, silent or not,
    cannot matter while

        distance - radius >= q (speed (L + age) + `needed_m` without the way from the anchor).

    Horizontal distances are not scaled and are never more than those that `matters` takes. Radius and age are
    largest at the end of the time. The neighbour's predicted place comes nearer to the anchor by at most its
    speed, and its distance from the aircraft differs from that from the anchor by at most the aircraft's way
    from there. With a = age + GROWTH_AHEAD_S, `kernels.neighbours.volume_of` scales by

        vertical (r + max(x, a growth)) / (r + max(x, a growth_down)),

    which is at most vertical (1 + a (growth - growth_down) / r) where growth is the larger one, and else at
    most `vertical`. The radius r without growth is least for a message without age. A track that may be
    removed within the time is never left out.
    """
    anchor, left, age = tracks.anchor[i], tracks.anchor[i, 2] - now, later.age_s
    if age > k.KEPT_S and age > k.kept_for(k.past_at(tracks.past[i], row).gap_s, k.KEPT_S):
        return -1.0
    least = law.radius_m + max(
        law.least_margin_m, law.sigmas * math.sqrt(own.sigma_m * own.sigma_m + known.sigma_m * known.sigma_m)
    )
    ahead = law.growth * (age + GROWTH_AHEAD_S)
    more = ahead * max(known.growth_mps - known.growth_down_mps, 0.0) / least
    stretch = max(law.vertical * (1.0 + more), 1.0)
    n = known.n + known.age_s * known.vn - anchor[0]
    e = known.e + known.age_s * known.ve - anchor[1]
    speed = math.sqrt(known.vn * known.vn + known.ve * known.ve + known.vd * known.vd)
    gap = math.sqrt(n * n + e * e) - speed * left - volume_of(later, own, law).radius - 2.0 * _SLACK_M
    return float(gap / stretch - speed * (max(law.look_s, law.horizon_s) + age))


@_inlined
def note_turns(own: k.Own, history: k.History, samples: int, turns: Floats) -> None:
    """Write `Desk.turns`."""
    v, most2 = own.velocity, 0.0
    for at in range(turns.shape[1]):
        if at >= samples:
            turns[0, at], turns[1, at] = -math.inf, math.inf
            continue
        u = history.velocities[samples - 1 - at]
        most2 = max(most2, (v.n - u[0]) ** 2 + (v.e - u[1]) ** 2 + (v.d - u[2]) ** 2)
        turns[0, at], turns[1, at] = history.times_s[samples - 1 - at], most2


@_compiled
def turned_since(own: k.Own, age_s: float, law: k.Settings, scope: Scope, turns: Floats) -> float:
    """Upper bound of the difference (m/s) between the present velocity and that of the time of a message.

    The law interpolates between the last velocity before that time and the next one, which is the present one
    or is in the history. Decisions are too far apart for one to take the place of another in it.
    """
    at = int(age_s / law.period_s)
    while at < turns.shape[1] and turns[0, at] > own.now_s - age_s:
        at += 1
    return min(math.sqrt(turns[1, at]), scope.turned) if at < turns.shape[1] else scope.turned


@_inlined
def look(
    now: float, world: Conditions, i: int, own: k.Own, law: k.Settings, scope: Scope, craft: Fleet,
    tracks: Tracks, desk: Desk,
) -> tuple[int, int]:  # fmt: skip
    """Write the aircraft that aircraft i knows, and that matter, to `desk`. Old tracks are removed.

    They are sorted by flight number, so that the order of reception is irrelevant.

    Args:
        desk: with `turns`.

    Returns:
        The number of tracks that matter for this scope, and the number of neighbours that were written: those
        that matter for the own velocity at the time of their own messages.
    """
    needed, order, names = needed_m(now, i, own, law, scope, tracks), desk.order, desk.names
    candidates = asked = count = 0
    for row in range(tracks.used[i]):
        order[candidates] = row
        candidates += 1 if tracks.beyond_m[i, row] < needed else 0
    for at in range(candidates):
        _fetch_first(i, order[at], tracks)
    for candidate in range(candidates):
        row = order[candidate]
        who = tracks.who[i, row]
        if who == NOBODY:
            continue
        age = now + craft.clock[i] - tracks.heard[i, row, M_TIME]
        if age > k.KEPT_S and age > k.kept_for(k.past_at(tracks.past[i], row).gap_s, k.KEPT_S):
            tracks.who[i, row] = NOBODY
            continue
        known = _known(now, world, i, row, craft, tracks)
        volume = volume_of(known, own, law)
        if not matters(own, known, volume, law, scope):
            if tracks.beyond_m[i, row] == -math.inf:
                later = _known(tracks.anchor[i, 2], world, i, row, craft, tracks)
                tracks.beyond_m[i, row] = _beyond(now, i, row, known, later, own, law, tracks)
            continue
        asked += 1
        turned = turned_since(own, known.age_s, law, scope, desk.turns)
        if not matters(own, known, volume, law, Scope(scope.change, turned)):
            continue
        at = count
        while at > 0 and names[at - 1] > who:
            order[at], names[at] = order[at - 1], names[at - 1]
            at -= 1
        order[at], names[at] = row, who
        count += 1
    for at in range(count):
        k.put_other(desk.neighbours, at, _known(now, world, i, order[at], craft, tracks))
    return asked, count


@_compiled
def _known(now: float, world: Conditions, i: int, row: int, craft: Fleet, tracks: Tracks) -> k.Other:
    m = tracks.heard[i, row]
    past = k.past_at(tracks.past[i], row)
    silent = now - tracks.got_s[i, row] > k.silent_after(past.gap_s)
    return k.Other(
        m[M_POSITION], m[M_POSITION + 1], m[M_POSITION + 2],
        m[M_VELOCITY], m[M_VELOCITY + 1], m[M_VELOCITY + 2],
        max(now + craft.clock[i] - m[M_TIME], 0.0), world.declared_m, world.sigma_mps, past.growth_mps,
        1.0 if silent else 0.0, _SHARE, 1.0, 0.0, past.growth_down_mps, 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


@_inlined
def look_perfectly(
    i: int, own: k.Own, law: k.Settings, scope: Scope, craft: Fleet, links: Links, desk: Desk
) -> int:
    """Write the true states of the aircraft within reach that matter. Returns their number. Those that do not
    fit into the table are left out."""
    count, p, v = 0, craft.position, craft.velocity
    for e in range(links.start[i], links.start[i + 1]):
        j = links.other[e]
        known = k.Other(
            p[j, 0], p[j, 1], p[j, 2], v[j, 0], v[j, 1], v[j, 2],
            0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        if count < len(desk.neighbours) and matters(own, known, volume_of(known, own, law), law, scope):
            k.put_other(desk.neighbours, count, known)
            count += 1
    return count
