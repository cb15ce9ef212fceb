"""Writes the results of city runs as Parquet, each file with a provenance record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from companion.errors import ConfigError
from companion.shipped import how_to_install
from ground_tools.city import measure
from ground_tools.city.cells import CHANNEL, POLICY, ROOTS, City, Row
from ground_tools.city.simulation import Result
from ground_tools.city.traffic.demand import PURPOSES
from ground_tools.common import provenance

_FLIGHTS: Final = {
    "begun_s": measure.T_BEGUN,
    "ended_s": measure.T_ENDED,
    "least_m": measure.T_LEAST,
    "largest_deviation_m": measure.T_GAP_MOST,
    "way_m": measure.T_FLOWN,
    "energy_j": measure.T_ENERGY,
    "planned_energy_j": measure.T_PLANNED,
    "late_s": measure.T_LATE,
    "manoeuvres": measure.T_MANOEUVRES,
}
_LOSSES: Final = {
    "time_s": measure.L_TIME,
    "first": measure.L_FIRST,
    "second": measure.L_SECOND,
    "least_m": measure.L_LEAST,
    "north_m": measure.L_NORTH,
    "east_m": measure.L_EAST,
    "down_m": measure.L_DOWN,
    "terminal": measure.L_TERMINAL,
}


def check() -> None:
    """Check that pyarrow is installed.

    Raises:
        ConfigError: pyarrow is not installed.
    """
    _parquet()


def write_runs(path: Path, city: City, rows: Sequence[Row], command: str) -> None:
    """Write the runs of a cell, one row each, and a provenance record beside the file.

    Args:
        command: the command that makes such a file, for the record.

    Raises:
        ConfigError: the file cannot be written.
    """
    columns: dict[str, Any] = {
        name: [getattr(row, name) for row in sorted(rows, key=lambda row: row.seed)]
        for name in Row.__struct_fields__
    }
    _write(path, columns, {"city": msgspec.json.encode(city).decode()})
    data = [CHANNEL, *([POLICY] if city.transports == "policy" else [])]
    provenance.write(path, provenance.now(command, ROOTS, data, ("numpy", "numba")))


def write_study(path: Path, cells: Sequence[tuple[City, str, float, Sequence[Row]]]) -> None:
    """Write the runs of many cells as one table, one row each.

    Args:
        cells: for each cell the city, the name of the method, the background load, and the runs.

    Raises:
        ConfigError: the file cannot be written.
    """
    runs = [(city, method, load, row) for city, method, load, rows in cells for row in rows]
    columns: dict[str, Any] = {
        "method": [method for _, method, _, _ in runs],
        "load": [load for _, _, load, _ in runs],
        "per_km2": [city.demand.per_km2 for city, _, _, _ in runs],
        "side_m": [city.demand.north_m for city, _, _, _ in runs],
    }
    columns |= {name: [getattr(row, name) for _, _, _, row in runs] for name in Row.__struct_fields__}
    columns["city"] = [msgspec.json.encode(city).decode() for city, _, _, _ in runs]
    _write(path, columns, {})


Columns = dict[str, Any]
"""Columns of a table by their names, of the same length."""


def flights_of(result: Result) -> Columns:
    """The flights of a run, one row each. Infinite values and NaN are written as empty."""
    tally = result.state.tally.flights
    columns: dict[str, Any] = {"flight": np.arange(len(tally))}
    columns["purpose"] = [PURPOSES[p] for p in result.purpose.tolist()]
    columns["due_s"], columns["waited_s"] = result.due_s, result.waited_s
    columns |= {name: tally[:, column] for name, column in _FLIGHTS.items()}
    columns["mean_deviation_m"] = tally[:, measure.T_GAP_SUM] / np.maximum(tally[:, measure.T_STEPS], 1.0)
    return columns


def losses_of(result: Result) -> Columns:
    """The losses of separation of a run, one row each."""
    losses = result.state.tally.losses[: int(result.state.tally.number[0])]
    columns: dict[str, Any] = {name: losses[:, column] for name, column in _LOSSES.items()}
    columns |= {name: columns[name].astype(int) for name in ("first", "second")}
    columns["terminal"] = columns["terminal"] != 0.0
    return columns


def write(path: Path, columns: Columns) -> None:
    """Write one table.

    Raises:
        ConfigError: the file cannot be written.
    """
    _write(path, columns, {})


def _write(path: Path, columns: dict[str, Any], said: dict[str, str]) -> None:
    pa, pq = _parquet()
    arrays = {}
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.dtype == np.float64:
            values = np.where(np.isfinite(values), values, np.nan)
        arrays[name] = pa.array(values, from_pandas=True)
    try:
        pq.write_table(pa.table(arrays).replace_schema_metadata(said), path)
    except OSError as error:
        raise ConfigError(f"--out: {path}: cannot be written: {error}") from error


def _parquet() -> tuple[Any, Any]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise ConfigError(how_to_install("pyarrow", "inspect")) from error
    return pa, pq
