"""Reads a Rerun recording back, so that tests can check its content."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from ground_tools.inspect.viewer import drawing

WHOLE, ENCOUNTER = drawing.WHOLE, drawing.ENCOUNTER


class Read:
    """A recording's columns, by entity."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        self.batches: dict[str, list[Any]] = {}
        self.static: dict[str, list[Any]] = {}
        for chunk in RrdReader(path).stream().to_chunks():
            place = self.static if chunk.is_static else self.batches
            place.setdefault(str(chunk.entity_path), []).append(chunk.to_record_batch())

    def column(self, entity: str, component: str, line: str = WHOLE) -> list[tuple[float, Any]]:
        """(time, value) of every row, in order of time."""
        rows = []
        for batch in self.batches[entity]:
            names = batch.schema.names
            found = [n for n in names if n.endswith(f":{component}")]
            if line not in names or not found:
                continue
            (name,) = found
            times = [round(value.value * 1e-9, 6) for value in batch.column(line)]
            rows += zip(times, batch.column(name).to_pylist(), strict=True)
        return sorted(rows, key=lambda row: row[0])

    def fixed(self, entity: str, component: str) -> Any:
        """A static component, which applies to all rows."""
        (value,) = [
            batch.column(name)[0].as_py()
            for batch in self.static[entity]
            for name in batch.schema.names
            if name.endswith(f":{component}")
        ]
        return value


def packed(rgb: tuple[int, int, int]) -> int:
    """A colour as Rerun stores it."""
    red, green, blue = rgb
    return red << 24 | green << 16 | blue << 8 | 255


def verify(path: Path) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).with_name("rerun")
    return subprocess.run(
        [program, "rrd", "verify", path], capture_output=True, text=True, timeout=60, check=False
    )
