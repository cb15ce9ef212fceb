"""Sends drawings to a Rerun recording: in columns, on two time lines, and removed when stale.

rerun is imported on use, because its import takes seconds and it is an optional dependency.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from companion.arrays import Floats, Integers
from companion.errors import ConfigError
from companion.shipped import how_to_install
from ground_tools.inspect.viewer.palette import Rgb
from ground_tools.inspect.viewer.scene import Scene
from ground_tools.inspect.viewer.shapes import ARROW_S, enu

WHOLE = "time"
ENCOUNTER = "encounter"
SHOWN_S = 3.0
"""A position is drawn until the next one, but no longer than this."""
HELD_ROWS = 2000
"""Parts of a line are collected up to this many rows and sent together, because each part that is sent costs
memory until the end."""

_SHAPES = {
    "Arrows3D": "vectors",
    "Ellipsoids3D": "half_sizes",
    "LineStrips3D": "strips",
    "Points3D": "positions",
}
"""Required component of each archetype, which is sent empty to draw nothing."""


def rerun() -> Any:
    """Import rerun and return the module.

    Raises:
        ConfigError: rerun is not installed.
    """
    try:
        import pyarrow
        import rerun as module
    except ImportError as error:
        raise ConfigError(how_to_install("rerun", "inspect")) from error
    # Arrow's own allocator would keep the memory that is freed between pieces.
    pyarrow.set_memory_pool(pyarrow.system_memory_pool())
    return module


class Drawing:
    """Draws one scene into one stream."""

    def __init__(self, stream: Any, scene: Scene) -> None:
        self._rr = rerun()
        self._stream = stream
        self._scene = scene
        self._known: set[str] = set()
        self._held: dict[str, list[tuple[Floats, Floats]]] = {}
        """Times and values of lines that are not sent yet, by entity."""
        self._due: dict[str, tuple[str, float]] = {}
        """Archetype and time of the last row, by entity. The row is to be removed when it is stale."""

    def has(self, entity: str) -> bool:
        """Whether anything was drawn as this entity."""
        return entity in self._known

    def settle(self, now_s: float = math.inf) -> None:
        """Send the rows that are held back, and remove what was drawn last if it is stale now.

        Call it without an argument at the end of a run, to remove everything that was drawn last.
        """
        for entity in list(self._held):
            self._send_held(entity)
        for entity, due in list(self._due.items()):
            if now_s - due[1] > SHOWN_S:
                self._blank(entity, *self._due.pop(entity))

    def arrows(
        self, parts: tuple[str, str], time_s: Floats, from_ned_m: Floats, velocity: Floats, rgb: Rgb
    ) -> None:
        """Draw arrows (n, 3) of velocities, in m/s NED, from these positions (m, NED)."""
        rr = self._rr
        entity = self.entity("aircraft", *parts)
        self.style(entity, rr.Arrows3D.from_fields(colors=[rgb], radii=[0.5]))
        columns = rr.Arrows3D.columns(vectors=enu(ARROW_S * velocity), origins=enu(from_ned_m))
        self.send_until_stale(entity, "Arrows3D", time_s, columns)

    def line(self, parts: tuple[str, ...], time_s: Floats, values: Floats, rgb: Rgb, width: float) -> None:
        """Draw a figure over time. Rows are held back and sent together (`HELD_ROWS`)."""
        if not len(time_s):
            return
        entity = self.entity(*parts)
        named = [self._scene.name] if self._scene.name else []
        style = self._rr.SeriesLines(colors=[rgb], widths=[width], names=[" ".join([*named, *parts[1:]])])
        self.style(entity, style)
        held = self._held.setdefault(entity, [])
        if held and self._scene.piece(held[-1][0][0])[1] != self._scene.piece(time_s[0])[1]:
            self._send_held(entity)
            held = self._held.setdefault(entity, [])
        held.append((time_s, values))
        if sum(len(times) for times, _ in held) >= HELD_ROWS:
            self._send_held(entity)

    def _send_held(self, entity: str) -> None:
        times, values = (np.concatenate(rows) for rows in zip(*self._held.pop(entity), strict=True))
        self.send(entity, times, self._rr.Scalars.columns(scalars=values))

    def points(
        self,
        parts: tuple[str, ...],
        time_s: Floats,
        position_ned_m: Floats,
        rgb: Rgb,
        radius_m: float,
        label: str,
        *,
        named: bool = False,
    ) -> None:
        """Draw a point for each place (n, 3) in m NED."""
        rr = self._rr
        entity = self.entity(*parts)
        labels = [label] if label else None
        self.style(
            entity,
            rr.Points3D.from_fields(colors=[rgb], radii=[radius_m], labels=labels, show_labels=named),
        )
        columns = rr.Points3D.columns(positions=enu(position_ned_m))
        self.send_until_stale(entity, "Points3D", time_s, columns)

    def send_until_stale(
        self,
        entity: str,
        archetype: str,
        time_s: Floats,
        columns: Any,
        lengths: Integers | None = None,
    ) -> None:
        """Send rows that are removed after SHOWN_S unless another row follows, also in a later piece."""
        due = self._due.pop(entity, None)
        if due is not None and time_s[0] - due[1] > SHOWN_S:
            self._blank(entity, *due)
        each = np.ones(len(time_s), dtype=np.int64) if lengths is None else lengths
        times, counts = until_stale(time_s, each)
        self.send(entity, times, columns.partition(counts))
        self._due[entity] = archetype, float(time_s[-1])

    def _blank(self, entity: str, archetype: str, last_s: float) -> None:
        empty = {_SHAPES[archetype]: np.zeros((0, 3), np.float32)}
        columns = getattr(self._rr, archetype).columns(**empty).partition([0])
        self.send(entity, np.array([last_s + SHOWN_S]), columns)

    def style(self, entity: str, style: Any) -> None:
        """Log once what applies to all rows of an entity."""
        if entity not in self._known:
            self._known.add(entity)
            self._stream.log(entity, style, static=True)

    def send(self, entity: str, time_s: Floats, columns: Any, *, clip: bool = False) -> None:
        """Send rows of one piece of the time line.

        Args:
            entity: Entity path.
            time_s: Times of the rows.
            columns: Their data.
            clip: Also put rows outside the encounter on its time line, at its ends, because their content
                stays valid.
        """
        rr, one = self._rr, self._scene.encounter
        times = [rr.TimeColumn(WHOLE, duration=time_s)]
        if one is not None and (clip or one.start_s <= time_s[0] <= one.end_s):
            times.append(rr.TimeColumn(ENCOUNTER, duration=one.clipped(time_s)))
        self._stream.send_columns(entity, times, columns)

    def entity(self, *parts: str) -> str:
        """Path of an entity of this scene."""
        escape = self._rr.escape_entity_path_part
        return "/".join([self._scene.root, *(escape(part) for part in parts)])


def until_stale(time_s: Floats, lengths: Integers) -> tuple[Floats, Integers]:
    """Add an empty row wherever the next row comes later than SHOWN_S; `lengths` are the points per row."""
    last = np.append(np.diff(time_s) > SHOWN_S, False)
    times = np.concatenate([time_s, time_s[last] + SHOWN_S])
    counts = np.concatenate([lengths, np.zeros(last.sum(), dtype=np.int64)])
    order = np.argsort(times, kind="stable")
    return times[order], counts[order]
