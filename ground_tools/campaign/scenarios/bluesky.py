"""Reads scenario files of the BlueSky simulator (`.scn`) as planned paths.

A line is `HH:MM:SS.hh>COMMAND arguments`, with commas or blanks between the arguments. `#` begins a comment,
and a backslash at the end continues a line (`readscn` in `bluesky/stack/simstack.py`, version 22fdf9e).
Speeds are calibrated airspeeds in knots or Mach numbers, altitudes are feet or flight levels, and vertical
rates are ft/min.

Commands that move an aircraft are understood: CRE, ADDWPT, DEST, HDG, SPD, ALT, VS and DEL, and DEFWPT for
named places. All other commands are counted by name. The motion is simpler than in BlueSky: an aircraft flies
straight from point to point and turns and changes its speed at once. It reaches a waypoint at the waypoint's
height, and flies at the waypoint's speed from there on. There is no wind.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from ground_tools.campaign.encounters.sampling import FOOT_M, KNOT_MPS

CLIMB_MPS: Final = 1500.0 * FOOT_M / 60.0
"""Vertical rate of a change of altitude for which the file gives none."""
_HIGHEST_M, _LOWEST_M = 50_000.0, -1_000.0
_FASTEST: Final = 10_000.0
"""Greatest calibrated airspeed (kt), Mach number and vertical rate (100 ft/min) that are understood."""
_RADIUS_M: Final = 6_371_000.0
_TIME: Final = re.compile(r"\s*(\d{1,4}):(\d{1,2}):(\d{1,2}(?:\.\d*)?)\s*>(.*)")
_FEWEST: Final = {
    "CRE": 7,
    "ADDWPT": 2,
    "DEST": 2,
    "HDG": 2,
    "SPD": 2,
    "ALT": 2,
    "VS": 2,
    "DEL": 1,
    "DEFWPT": 3,
}
"""Commands that are understood, with the least number of arguments of each."""

Place = tuple[float, float]
"""Latitude and longitude, deg."""
State = tuple[float, float, float, float]
"""Time (s) and position: north, east, up (m)."""


@dataclass(slots=True)
class Plan:
    """The planned path of one aircraft."""

    name: str
    corners: list[State]
    """Positions with their times, connected by straight lines. The first one is where the aircraft is
    created."""
    goes_on: bool = True
    """Whether the aircraft flies straight on after the last corner; otherwise it disappears there."""
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity after the last corner: north, east, up, m/s."""


@dataclass(slots=True)
class Scenario:
    """Content of a scenario file."""

    plans: list[Plan]
    """Planned paths. North and east are relative to the mean of the places where aircraft are created."""
    skipped: Counter[str] = field(default_factory=Counter)
    """Number of occurrences of each input that is not understood, by its name."""

    def not_understood(self) -> str:
        """The most frequent inputs that are not understood, for a message."""
        return ", ".join(f"{name} ({count})" for name, count in self.skipped.most_common(5)) or "nothing"


@dataclass(slots=True)
class _Order:
    time_s: float
    command: str
    words: list[str]


@dataclass(slots=True)
class _Fix:
    """A waypoint."""

    place: Place
    up_m: float | None
    speed: str | None
    last: bool


@dataclass(slots=True)
class _Craft:
    """State of an aircraft while its orders are processed."""

    plan: Plan
    at: State
    heading: float
    """Heading, rad."""
    speed: float
    """True airspeed, m/s."""
    climb: float = 0.0
    """Vertical rate now, m/s."""
    rate: float = CLIMB_MPS
    """Magnitude of the vertical rate of the next change of altitude, m/s."""
    level: float | None = None
    """Altitude at which the present climb or descent ends, m."""
    route: list[_Fix] = field(default_factory=list)


def parse(text: str) -> Scenario:
    """The scenario in the text of a file. Never raises: what is not understood is counted."""
    skipped: Counter[str] = Counter()
    orders = _orders(text, skipped)
    created = [order for order in orders if order.command == "CRE"]
    places = [place for order in created if (place := place_of(order.words[2:4])) is not None]
    if not places:
        return Scenario([], skipped)
    middle = sum(p[0] for p in places) / len(places), sum(p[1] for p in places) / len(places)
    fleet = _Fleet(middle, skipped)
    for order in orders:
        fleet.follow(order)
    for craft in fleet.crafts.values():
        _finish(craft, fleet)
    return Scenario(fleet.plans, skipped)


class _Fleet:
    """All aircraft of a file, while its orders are processed in the order of their times."""

    def __init__(self, middle: Place, skipped: Counter[str]) -> None:
        self._middle = middle
        self._skipped = skipped
        self._named: dict[str, Place] = {}
        self.crafts: dict[str, _Craft] = {}
        self.plans: list[Plan] = []
        self._steer: dict[str, Callable[[_Craft, list[str]], str | None]] = {
            "ADDWPT": self._add,
            "DEST": self._add_last,
            "HDG": self._turn,
            "SPD": self._speed,
            "ALT": self._climb_to,
            "VS": self._climb,
        }

    def follow(self, order: _Order) -> None:
        """Process one order, or count it if this is not possible."""
        if order.command == "CRE":
            wrong = self._create(order)
        elif order.command == "DEFWPT":
            place = place_of(order.words[1:3])
            wrong = None if place is not None else "place"
            if place is not None:
                self._named[order.words[0].upper()] = place
        else:
            craft = self.crafts.get(order.words[0].upper())
            if craft is None:
                wrong = "an aircraft that does not fly"
            else:
                advance(craft, order.time_s, self.flat)
                wrong = self._one(craft, order)
        if wrong is not None:
            self._skipped[f"{order.command}: {wrong}"] += 1

    def _one(self, craft: _Craft, order: _Order) -> str | None:
        if order.command == "DEL":
            craft.plan.goes_on = False
            _corner(craft)
            del self.crafts[order.words[0].upper()]
            return None
        _corner(craft)
        return self._steer[order.command](craft, order.words[1:])

    def _create(self, order: _Order) -> str | None:
        name, _, lat, lon, heading, altitude, speed = order.words[:7]
        place, up, way = place_of([lat, lon]), _altitude(altitude), _number(heading)
        if place is None:
            return "place"
        if way is None:
            return f"heading {heading[:20]}"
        if up is None:
            return f"altitude {altitude[:20]}"
        fast = true_airspeed(speed, up)
        if fast is None:
            return f"speed {speed[:20]}"
        if name.upper() in self.crafts:
            return "an aircraft that flies already"
        at = (order.time_s, *self.flat(place), up)
        plan = Plan(name, [at])
        self.crafts[name.upper()] = _Craft(plan, at, math.radians(way), fast)
        self.plans.append(plan)
        return None

    def flat(self, place: Place) -> tuple[float, float]:
        """North and east (m) of a place."""
        return flat(place, self._middle)

    def _where(self, words: list[str]) -> tuple[Place, int] | None:
        """The place at the beginning of some words, and the number of words that it takes."""
        if (place := place_of(words[:2])) is not None:
            return place, 2
        named = self._named.get(words[0].upper()) if words else None
        return None if named is None else (named, 1)

    def _add(self, craft: _Craft, words: list[str], last: bool = False) -> str | None:
        found = self._where(words)
        if found is None:
            return f"place {' '.join(words[:1])[:20]}"
        place, used = found
        rest = [*words[used:], "", ""]
        up = _altitude(rest[0])
        fix = _Fix(place, up, rest[1] or None, last)
        at = len(craft.route) - 1 if craft.route and craft.route[-1].last else len(craft.route)
        if last and at < len(craft.route):
            craft.route.pop()
        craft.route.insert(at, fix)
        return None

    def _add_last(self, craft: _Craft, words: list[str]) -> str | None:
        return self._add(craft, words[:2], last=True)

    def _turn(self, craft: _Craft, words: list[str]) -> str | None:
        way = _number(words[0])
        if way is None:
            return f"heading {words[0][:20]}"
        craft.heading, craft.route = math.radians(way), []
        return None

    def _speed(self, craft: _Craft, words: list[str]) -> str | None:
        fast = true_airspeed(words[0], craft.at[3])
        if fast is None:
            return f"speed {words[0][:20]}"
        craft.speed = fast
        return None

    def _climb_to(self, craft: _Craft, words: list[str]) -> str | None:
        up = _altitude(words[0])
        if up is None:
            return f"altitude {words[0][:20]}"
        if len(words) > 1 and (rate := _rate(words[1])):
            craft.rate = abs(rate)
        craft.level = up
        craft.climb = math.copysign(craft.rate, up - craft.at[3]) if up != craft.at[3] else 0.0
        return None

    def _climb(self, craft: _Craft, words: list[str]) -> str | None:
        rate = _rate(words[0])
        if rate is None:
            return f"vertical rate {words[0][:20]}"
        craft.climb = rate
        craft.rate = abs(craft.climb) or craft.rate
        if craft.level is not None and (craft.level - craft.at[3]) * craft.climb <= 0.0:
            craft.level = None
        return None


def advance(craft: _Craft, until_s: float, flat: Callable[[Place], tuple[float, float]]) -> None:
    """Fly an aircraft until a time, along its route while there is any."""
    while craft.route and craft.speed > 0.0 and craft.plan.goes_on:
        fix, (t, n, e, up) = craft.route[0], craft.at
        north, east = flat(fix.place)
        takes_s = math.hypot(north - n, east - e) / craft.speed
        if takes_s > 0.0:
            craft.heading = math.atan2(east - e, north - n)
            if fix.up_m is not None:
                craft.climb, craft.level = (fix.up_m - up) / takes_s, fix.up_m
        if t + takes_s > until_s:
            break
        craft.at = (t + takes_s, north, east, fix.up_m if fix.up_m is not None else _up(craft, takes_s))
        if fix.up_m is not None:
            craft.climb, craft.level = 0.0, None
        _corner(craft)
        if fix.speed is not None and (fast := true_airspeed(fix.speed, craft.at[3])):
            craft.speed = fast
        craft.route.pop(0)
        craft.plan.goes_on = not fix.last
    t, n, e, up = craft.at
    if not craft.plan.goes_on or until_s <= t:
        return
    level_s = (craft.level - up) / craft.climb if craft.level is not None and craft.climb != 0.0 else -1.0
    if 0.0 < level_s < until_s - t:
        craft.at = _moved(craft, level_s)
        craft.climb, craft.level = 0.0, None
        _corner(craft)
    craft.at = _moved(craft, until_s - craft.at[0])


def _moved(craft: _Craft, takes_s: float) -> State:
    t, n, e, _ = craft.at
    way = craft.speed * takes_s
    up = _up(craft, takes_s)
    return t + takes_s, n + way * math.cos(craft.heading), e + way * math.sin(craft.heading), up


def _up(craft: _Craft, takes_s: float) -> float:
    """Height (m) after some time."""
    up = craft.at[3] + craft.climb * takes_s
    if craft.level is not None and (craft.level - craft.at[3]) * (craft.level - up) <= 0.0:
        return craft.level
    return up


def _corner(craft: _Craft) -> None:
    """Append the aircraft's present position to the corners of its path."""
    if craft.at[0] > craft.plan.corners[-1][0]:
        craft.plan.corners.append(craft.at)


def _finish(craft: _Craft, fleet: _Fleet) -> None:
    """Fly the rest of an aircraft's route."""
    while craft.route and craft.plan.goes_on and craft.speed > 0.0:
        north, east = fleet.flat(craft.route[0].place)
        far = math.hypot(north - craft.at[1], east - craft.at[2])
        advance(craft, craft.at[0] + far / craft.speed + 1e-6, fleet.flat)
    if craft.level is not None and craft.climb != 0.0 and craft.plan.goes_on:
        advance(craft, craft.at[0] + max((craft.level - craft.at[3]) / craft.climb, 0.0) + 1e-6, fleet.flat)
    _corner(craft)
    level = craft.speed * math.cos(craft.heading), craft.speed * math.sin(craft.heading)
    craft.plan.velocity = (*level, craft.climb)


def _orders(text: str, skipped: Counter[str]) -> list[_Order]:
    """The understood orders of a file, sorted by time."""
    lines = list(_lines(text, skipped))
    names = {words[1].upper() for _, words in lines if len(words) > 1 and words[0].upper() == "CRE"}
    found = (_named(time_s, words, names, skipped) for time_s, words in lines)
    return sorted((order for order in found if order is not None), key=lambda order: order.time_s)


def _lines(text: str, skipped: Counter[str]) -> Iterator[tuple[float, list[str]]]:
    """Time (s) and words of each line."""
    before = ""
    for raw in text.splitlines():
        line = before + raw.split("#")[0].strip()
        before = ""
        if line.endswith("\\"):
            before = f"{line[:-1].strip()} "
            continue
        if not line:
            continue
        match = _TIME.match(line)
        if match is None:
            skipped["a line without a time"] += 1
            continue
        words = re.sub(r",(?=\s*,)", ",@", match[4]).replace(",", " ").split()
        if words:
            yield 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3]), words
        else:
            skipped["a line without a command"] += 1


def _named(time_s: float, words: Sequence[str], names: set[str], skipped: Counter[str]) -> _Order | None:
    """The order in a line; None if it is not understood, which is counted."""
    command, rest = words[0].upper(), list(words[1:])
    if command in names and rest:  # the aircraft's name may come first
        command, rest = rest[0].upper(), [words[0], *rest[1:]]
    if command not in _FEWEST:
        skipped[command[:20]] += 1
        return None
    if len(rest) < _FEWEST[command]:
        skipped[f"{command}: too few arguments"] += 1
        return None
    return _Order(time_s, command, rest)


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def flat(place: Place, middle: Place) -> tuple[float, float]:
    """North and east (m) of a place, on a map whose distances are true along the axes through its middle."""
    east = (place[1] - middle[1] + 180.0) % 360.0 - 180.0
    across = math.cos(math.radians(middle[0]))
    return _RADIUS_M * math.radians(place[0] - middle[0]), _RADIUS_M * math.radians(east) * across


def place_of(words: Sequence[str]) -> Place | None:
    """The place that two words give as latitude and longitude in degrees; None if they do not."""
    if len(words) < 2:
        return None
    lat, lon = _number(words[0]), _number(words[1])
    if lat is None or lon is None or not (-90.0 <= lat <= 90.0 and -360.0 <= lon <= 360.0):
        return None
    return lat, lon


def _rate(word: str) -> float | None:
    """Convert a vertical rate from ft/min to m/s."""
    value = _number(word)
    return None if value is None or abs(value) > 100.0 * _FASTEST else value * FOOT_M / 60.0


def _altitude(word: str) -> float | None:
    """Convert an altitude in feet, or a flight level, to m."""
    flight_level = word[:2].upper() == "FL"
    value = _number(word[2:] if flight_level else word)
    up_m = math.nan if value is None else value * FOOT_M * (100.0 if flight_level else 1.0)
    return up_m if _LOWEST_M <= up_m <= _HIGHEST_M else None


def true_airspeed(word: str, up_m: float) -> float | None:
    """True airspeed (m/s) of a calibrated airspeed in knots or a Mach number, in the standard atmosphere.

    Args:
        word: as in a scenario file: `250`, `M.8`, `0.8`.
    """
    text = word.upper()
    value = _number(text.replace("M0.", ".").replace("M", ".").replace("..", "."))
    if value is None or not 0.0 <= value <= _FASTEST:
        return None
    up_m = min(max(up_m, _LOWEST_M), _HIGHEST_M)  # an endless climb leads out of the atmosphere
    temperature = max(288.15 - 0.0065 * up_m, 216.65)
    density = 1.225 * (temperature / 288.15) ** 4.256848 * math.exp(-max(up_m - 11_000.0, 0.0) / 6341.552)
    if "M" in text or 0.1 < value < 1.0:
        return value * math.sqrt(1.4 * 287.05287 * temperature)
    pressure = density * 287.05287 * temperature
    impact = 101_325.0 * ((1.0 + 1.225 * (value * KNOT_MPS) ** 2 / (7.0 * 101_325.0)) ** 3.5 - 1.0)
    return math.sqrt(7.0 * pressure / density * ((1.0 + impact / pressure) ** (2.0 / 7.0) - 1.0))
