"""`python -m bench.commands.big_log SOURCE TARGET [MB]`: makes a large onboard log from a small one.

The data of SOURCE (.bin or .ulg) are repeated, with increasing time stamps, until TARGET has the given size
in units of 10^6 bytes (default: 1074). `python -m bench.commands.convert_run report TARGET FILE` then prints
how much memory a report takes.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np

from companion.flight_logs import dataflash, ulog

PAUSE_US = 1000
"""Gap in the time stamps between two repetitions."""


def stamps_of_dataflash(data: bytes) -> tuple[int, int, list[int]]:
    """Offsets (bytes) of the beginning and the end of the repeated part, and of the time stamps in it."""
    lengths, stamped, found = {128: 89}, set(), []
    at = 0
    while data[at : at + 2] == dataflash.HEAD and at + lengths[data[at + 2]] <= len(data):
        kind = data[at + 2]
        if kind == 128:
            number, lengths_of, _, _, columns = struct.unpack_from("<BB4s16s64s", data, at + 3)
            lengths[number] = lengths_of
            if columns.startswith(b"TimeUS"):
                stamped.add(number)
        if kind in stamped:
            found.append(at + 3)
        at += lengths[kind]
    return 0, at, found


def stamps_of_ulog(data: bytes) -> tuple[int, int, list[int]]:
    """As `stamps_of_dataflash`. The repeated part begins with the first data message, after all
    definitions."""
    at, first = 16, 0
    found = []
    while at + 3 <= len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        if at + 3 + size > len(data):
            break
        if kind == ord("D"):
            first = first or at
            found.append(at + 5)
        elif kind == ord("L") and first:
            found.append(at + 4)
        at += 3 + size
    return first, at, found


def main(source: str, target: str, megabytes: str = "1074") -> None:
    """Write the log."""
    data = Path(source).read_bytes()
    is_ulog = data.startswith(ulog.MAGIC)
    first, last, offsets = (stamps_of_ulog if is_ulog else stamps_of_dataflash)(data)
    body = np.frombuffer(data[first:last], np.uint8)
    places = np.array(offsets)[:, None] - first + np.arange(8)
    times = body[places].copy().view(np.uint64).ravel()
    length = int(times.max() - times.min()) + PAUSE_US
    with Path(target).open("wb") as stream:
        stream.write(data[:first])
        turn = 0
        while stream.tell() < float(megabytes) * 1e6:
            later = body.copy()
            later[places] = (times + np.uint64(turn * length)).view(np.uint8).reshape(-1, 8)
            stream.write(later.tobytes())
            turn += 1
    print(f"{target}: {turn} times {length / 1e6:.1f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
