"""Converts between SI values and the integers that represent them in a Remote ID message.

Scalings, limits and the integers that mean "unknown" are those of ASTM F3411-22a section 5.4 (the same in
ASD-STAN EN 4709-002), read off the public reference implementation opendroneid-core-c. All values are rounded
to nearest, as both standards require. The reference itself truncates altitude, vertical speed and radius.

When encoding, a value outside its range, NaN and infinity raise ValueError, which names field, value and
limits. When decoding, an integer that the standard does not allow (a latitude of 111 degrees, a timestamp of
90 minutes after the hour) becomes unknown, `None`. Peers do send such integers, and the rest of their message
is valid.

Rounding never turns a known value into the integer for "unknown". There are three exceptions, which receivers
treat as unknown anyway: an altitude of exactly -1000 m, a position of 0, 0 (a receiver without fix), and a
date of 2019-01-01 00:00.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Final, NoReturn

EPOCH_2019_UTC_S: Final = 1546300800.0
"""2019-01-01 00:00 UTC in Unix seconds: the epoch of System and Authentication timestamps."""

_ALTITUDE_MIN_M: Final = -1000.0
_ALTITUDE_MAX_M: Final = 31767.5
_LAT_MAX: Final = 900_000_000
_LON_MAX: Final = 1_800_000_000
_DIRECTION_UNKNOWN: Final = 361
CLIMB_MAX_MPS: Final = 62.0
_CLIMB_UNKNOWN: Final = 126
_SLOW_MAX_MPS: Final = 63.75
_SPEED_MAX_MPS: Final = 254.25
_TENTHS_IN_HOUR: Final = 36_000
_TENTHS_UNKNOWN: Final = 0xFFFF
_UINT32_MAX: Final = 0xFFFF_FFFF


def refuse(field: str, value: object, allowed: str) -> NoReturn:
    """Raise ValueError for a value that the wire format cannot hold."""
    raise ValueError(f"{field} is {value!r}; allowed: {allowed}")


def check_integer(field: str, value: int, highest: int) -> int:
    """Return `value` if it is an integer from 0 to `highest`; raise ValueError otherwise."""
    if not isinstance(value, int) or not 0 <= value <= highest:
        refuse(field, value, f"0 to {highest}")
    return value


# ---------------------------------------------------------------- altitude: 0.5 m steps from -1000 m


def altitude_to_wire(field: str, metres: float | None) -> int:
    """Encode an altitude or height (m) as u16; unknown is 0."""
    if metres is None:
        return 0
    if not _ALTITUDE_MIN_M <= metres <= _ALTITUDE_MAX_M:
        refuse(field, metres, "-1000 to 31767.5 m")
    # The lowest half step would round to 0, which means unknown.
    return round((metres + 1000.0) * 2.0) or int(metres > _ALTITUDE_MIN_M)


def altitude_from_wire(raw: int) -> float | None:
    """Decode a u16 as metres."""
    return raw * 0.5 - 1000.0 if raw else None


# ---------------------------------------------------------------- position: 1e-7 degrees


def position_to_wire(prefix: str, lat_deg: float | None, lon_deg: float | None) -> tuple[int, int]:
    """Encode latitude and longitude (degrees) as two i32; unknown is 0, 0.

    Raises ValueError if only one of the two is known. `prefix` precedes `lat_deg` and `lon_deg` in the field
    names of error texts.
    """
    if lat_deg is None or lon_deg is None:
        if lat_deg is not lon_deg:
            refuse(f"{prefix}lat_deg, {prefix}lon_deg", (lat_deg, lon_deg), "both known or both None")
        return 0, 0
    if not -90.0 <= lat_deg <= 90.0:
        refuse(f"{prefix}lat_deg", lat_deg, "-90 to 90 degrees")
    if not -180.0 <= lon_deg <= 180.0:
        refuse(f"{prefix}lon_deg", lon_deg, "-180 to 180 degrees")
    return round(lat_deg * 1e7), round(lon_deg * 1e7)


def position_from_wire(lat: int, lon: int) -> tuple[float, float] | tuple[None, None]:
    """Decode two i32 as degrees."""
    if (lat or lon) and -_LAT_MAX <= lat <= _LAT_MAX and -_LON_MAX <= lon <= _LON_MAX:
        return lat / 1e7, lon / 1e7
    return None, None


# ---------------------------------------------------------------- direction: whole degrees, in two halves


def direction_to_wire(field: str, degrees: float | None) -> tuple[int, int]:
    """Encode a course (0 to 360 degrees) as east/west bit and 0-179 within that half; unknown is 1, 181."""
    if degrees is None:
        return 1, _DIRECTION_UNKNOWN - 180
    if not 0.0 <= degrees <= 360.0:
        refuse(field, degrees, "0 to 360 degrees")
    whole = round(degrees) % 360
    return (1, whole - 180) if whole >= 180 else (0, whole)


def _direction(east_west: int, raw: int) -> float | None:
    # Some transmitters leave the bit clear and put 180-255 into the byte.
    degrees = raw + 180 * east_west
    if degrees > 360:
        return None
    return float(degrees % 360)


DIRECTIONS_DEG: Final = tuple(_direction(bit, raw) for bit in (0, 1) for raw in range(256))
"""Course in degrees [0, 360) or None, at index `east_west << 8 | byte`."""


# ---------------------------------------------------------------- speeds


def speed_to_wire(field: str, mps: float | None) -> tuple[int, int]:
    """Encode horizontal speed (m/s) as multiplier bit and u8.

    Steps are 0.25 m/s up to 63.75 m/s, then 0.75 m/s. Unknown is 1, 255.
    """
    if mps is None:
        return 1, 255
    if 0.0 <= mps <= _SLOW_MAX_MPS:
        return 0, round(mps * 4.0)
    if not _SLOW_MAX_MPS < mps <= _SPEED_MAX_MPS:
        refuse(field, mps, "0 to 254.25 m/s")
    return 1, round((mps - _SLOW_MAX_MPS) / 0.75)


SPEEDS_MPS: Final[tuple[float | None, ...]] = (
    *(raw * 0.25 for raw in range(256)),
    *(_SLOW_MAX_MPS + raw * 0.75 for raw in range(255)),
    None,
)
"""Horizontal speed (m/s) or None, at index `multiplier << 8 | byte`."""


def climb_to_wire(field: str, mps: float | None) -> int:
    """Encode vertical speed (m/s, positive up) as i8 in 0.5 m/s steps; unknown is 126."""
    if mps is None:
        return _CLIMB_UNKNOWN
    if not -CLIMB_MAX_MPS <= mps <= CLIMB_MAX_MPS:
        refuse(field, mps, "-62 to 62 m/s")
    return round(mps * 2.0)


def _climb(byte: int) -> float | None:
    mps = (byte - 256 if byte > 127 else byte) * 0.5
    return mps if -CLIMB_MAX_MPS <= mps <= CLIMB_MAX_MPS else None


CLIMBS_MPS: Final = tuple(_climb(byte) for byte in range(256))
"""Vertical speed (m/s) or None, at the index of the unsigned byte."""


# ---------------------------------------------------------------- time


def hour_time_to_wire(field: str, seconds: float | None) -> int:
    """Encode seconds after the UTC hour as tenths, u16; unknown is 0xFFFF."""
    if seconds is None:
        return _TENTHS_UNKNOWN
    if not 0.0 <= seconds <= 3600.0:
        refuse(field, seconds, "0 to 3600 s after the hour")
    return round(seconds * 10.0)


def hour_time_from_wire(raw: int) -> float | None:
    """Decode tenths of a second as seconds after the UTC hour."""
    return raw / 10.0 if raw <= _TENTHS_IN_HOUR else None


def utc_to_wire(field: str, utc_s: float | None) -> int:
    """Encode Unix time (s) as whole seconds since 2019, u32.

    Unknown is 0, which is what transmitters without time send.
    """
    if utc_s is None:
        return 0
    seconds = utc_s - EPOCH_2019_UTC_S
    if not 0.0 <= seconds <= _UINT32_MAX:
        refuse(field, utc_s, f"{EPOCH_2019_UTC_S:.0f} to {EPOCH_2019_UTC_S + _UINT32_MAX:.0f} Unix s")
    return round(seconds) or int(seconds > 0.0)


def utc_from_wire(raw: int) -> float | None:
    """Decode seconds since 2019 as Unix time."""
    return raw + EPOCH_2019_UTC_S if raw else None


# ---------------------------------------------------------------- area of a group flight


def radius_to_wire(field: str, metres: float) -> int:
    """Encode a radius (m) in tens of metres, u8."""
    if not 0.0 <= metres <= 2550.0:
        refuse(field, metres, "0 to 2550 m")
    return round(metres / 10.0)


# ---------------------------------------------------------------- accuracies: 4-bit categories


class AccuracyScale:
    """Categories of one kind of accuracy. Each category declares that the error (95 %) is below its bound.

    `bounds[category]` is the bound (m, m/s or s). It is None for category 0 (unknown, or worse than the
    widest bound) and for the categories that the standard reserves.
    """

    def __init__(self, *bounds: float) -> None:
        """`bounds` are those of categories 1, 2, ... in that order."""
        ascending = sorted((bound, 1 + at) for at, bound in enumerate(bounds))
        self.highest = len(bounds)
        self.bounds: Final[tuple[float | None, ...]] = (None, *bounds, *([None] * (15 - len(bounds))))
        self._exact: Final[dict[float | None, int]] = {None: 0, **dict(ascending)}
        self._ascending: Final = tuple(bound for bound, _ in ascending)
        self._codes: Final = (*(code for _, code in ascending), 0)

    def category(self, field: str, accuracy: float | None) -> int:
        """Return the tightest category whose bound is at least `accuracy`; 0 for None or beyond them all."""
        exact = self._exact.get(accuracy)
        if exact is not None:
            return exact
        if accuracy is None or not 0.0 <= accuracy < float("inf"):
            refuse(field, accuracy, "0 or more, and finite")
        return self._codes[bisect_left(self._ascending, accuracy)]

    def bound(self, category: int) -> float | None:
        """Return the upper bound of a category 0 to 15; None if unknown or reserved."""
        return self.bounds[check_integer("accuracy category", category, 15)]


HORIZONTAL_ACCURACY_M: Final = AccuracyScale(
    18520.0, 7408.0, 3704.0, 1852.0, 926.0, 555.6, 185.2, 92.6, 30.0, 10.0, 3.0, 1.0
)
VERTICAL_ACCURACY_M: Final = AccuracyScale(150.0, 45.0, 25.0, 10.0, 3.0, 1.0)
"""Accuracy of geodetic and barometric altitude."""
SPEED_ACCURACY_MPS: Final = AccuracyScale(10.0, 3.0, 1.0, 0.3)
TIMESTAMP_ACCURACY_S: Final = AccuracyScale(*(tenths / 10.0 for tenths in range(1, 16)))


# ---------------------------------------------------------------- text: Latin-1, NUL-padded


def text_to_wire(field: str, text: str, size: int) -> bytes:
    """Encode text as Latin-1. The caller's struct pads it to `size` with NULs."""
    if "\0" in text:
        refuse(field, text, "text without NUL")
    return raw_text_to_wire(field, text, size)


def raw_text_to_wire(field: str, text: str, size: int) -> bytes:
    """Encode raw bytes that are held as one Latin-1 character each; NULs are allowed."""
    try:
        data = text.encode("latin-1")
    except UnicodeEncodeError:
        refuse(field, text, "Latin-1 characters")
    if len(data) > size:
        refuse(field, text, f"at most {size} characters")
    return data


def text_from_wire(data: bytes) -> str:
    """Decode Latin-1 text up to the first NUL."""
    return data.partition(b"\0")[0].decode("latin-1")


def raw_text_from_wire(data: bytes) -> str:
    """Decode all bytes but the trailing NUL padding, one Latin-1 character per byte."""
    return data.rstrip(b"\0").decode("latin-1")
