"""Timestamps of DRIP (section 3.2.4.3): whole seconds since 2019-01-01 00:00:00 UTC, four bytes,
little-endian.

The examples of RFC 9575 appendix B and RFC 9886 appendix A hold Unix times instead. This package follows the
text, so the examples are dated some 49 years ahead here.
"""

from __future__ import annotations

import struct
from typing import Final

EPOCH_S: Final = 1_546_300_800
WINDOW: Final = struct.Struct("<II")
"""Valid not before (VNB) and valid not after (VNA)."""


def pack_window(not_before_utc_s: int, not_after_utc_s: int) -> bytes:
    """Encode a window of Unix times. Raises ValueError for a time that does not fit."""
    for utc_s in (not_before_utc_s, not_after_utc_s):
        if not EPOCH_S <= utc_s < EPOCH_S + 2**32:
            raise ValueError(f"time {utc_s}; allowed: {EPOCH_S} (2019) to {EPOCH_S + 2**32 - 1}")
    return WINDOW.pack(not_before_utc_s - EPOCH_S, not_after_utc_s - EPOCH_S)


def unpack_window(data: bytes) -> tuple[int, int]:
    """Decode eight bytes to two Unix times."""
    not_before, not_after = WINDOW.unpack(data)
    return not_before + EPOCH_S, not_after + EPOCH_S
