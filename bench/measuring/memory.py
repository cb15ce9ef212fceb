"""Memory of a process, read from Linux.

`ru_maxrss` does not measure a child: across fork and exec, Linux keeps the peak of the program that started
it. `VmHWM` belongs to the address space, which begins anew with each program.
"""

from __future__ import annotations

import os
import re
from pathlib import Path


def memory_mb(key: str, pid: int | None = None) -> float:
    """A memory field of /proc/PID/status, in units of 10^6 bytes.

    Args:
        key: `VmRSS` (resident now), `RssAnon` (of that, not backed by a file) or `VmHWM` (the largest
            `VmRSS` so far).
        pid: the process; None for this one.
    """
    text = Path(f"/proc/{pid or os.getpid()}/status").read_text()
    found = re.search(rf"{key}:\s+(\d+) kB", text)
    assert found is not None
    return int(found[1]) * 1024 / 1e6
