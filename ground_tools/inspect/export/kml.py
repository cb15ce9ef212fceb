"""Writes a run as KML, which Google Earth plays on its time slider.

Every aircraft is a `gx:Track` of times and positions (longitude, latitude, metres above mean sea level), or
a `gx:MultiTrack` of several where positions are missing in between, so that no leg is drawn over the gap.
Every pair's closest approach is a placemark. The structure follows OGC KML 2.2 (12-007r2) and Google's
extension namespace.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from companion.arrays import Floats
from companion.errors import ConfigError
from ground_tools.inspect.export.tables import iso, to_geodetic
from ground_tools.inspect.read.flown import Flown, Separation, at, gap_s, unbroken
from ground_tools.inspect.read.flown import Path as FlownPath
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.viewer.palette import colour

KML = "http://www.opengis.net/kml/2.2"
GX = "http://www.google.com/kml/ext/2.2"
PERIOD_S = 0.2
"""Minimum time between two points of a track."""
MAX_APPROACHES = 45
"""Most pairs that get a placemark, the closest first. Ten aircraft have 45 pairs."""


def write(run: Run, ways: Flown, pairs: list[Separation], path: Path) -> None:
    """Write the KML file `path`.

    Raises:
        ConfigError: The run's UTC is unknown, or the file cannot be written.
    """
    if ways.utc_at_zero_s is None:
        raise ConfigError(
            f"--kml: {run.folder}: KML needs UTC, which this run does not have (time line: {ways.clock})"
        )
    ET.register_namespace("", KML)
    ET.register_namespace("gx", GX)
    root = ET.Element(f"{{{KML}}}kml")
    document = _add(root, "Document")
    _add(document, "name", run.name)
    _add(document, "open", "1")
    if problems := (*run.problems, *ways.problems):
        _add(document, "description", "\n".join(problems))
    for index in range(len(ways.paths)):
        style = _add(document, "Style")
        style.set("id", f"aircraft{index}")
        line = _add(style, "LineStyle")
        _add(line, "color", _abgr(colour(index)))
        _add(line, "width", "3")
    flights = _add(document, "Folder")
    _add(flights, "name", f"Flown ({ways.positions})")
    for index, one in enumerate(ways.paths):
        _track(flights, one, f"#aircraft{index}", ways)
    closest = [pair for pair in pairs if pair.minimum_m is not None][:MAX_APPROACHES]
    if closest:
        folder = _add(document, "Folder")
        _add(folder, "name", "Closest approaches")
        for pair in closest:
            _approach(folder, pair, ways)
    ET.indent(root)
    try:
        ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def _add(parent: ET.Element, name: str, text: str | None = None, namespace: str = KML) -> ET.Element:
    element = ET.SubElement(parent, f"{{{namespace}}}{name}")
    element.text = text
    return element


def _track(folder: ET.Element, path: FlownPath, style: str, ways: Flown) -> None:
    mark = _add(folder, "Placemark")
    _add(mark, "name", path.name)
    _add(mark, "styleUrl", style)
    spans = unbroken(path.time_s, gap_s(path.time_s))
    if len(spans) > 1:
        mark = _add(mark, "MultiTrack", namespace=GX)
        _add(mark, "interpolate", "0", GX)
    for span in spans:
        track = _add(mark, "Track", namespace=GX)
        _add(track, "altitudeMode", "absolute")
        kept = _thinned(path.time_s[span])
        for time_s in path.time_s[span][kept]:
            _add(track, "when", iso(float(time_s) + (ways.utc_at_zero_s or 0.0)))
        for lat, lon, alt in to_geodetic(path.position_ned_m[span][kept], ways.origin):
            _add(track, "coord", f"{lon:.7f} {lat:.7f} {alt:.2f}", GX)


def _approach(folder: ET.Element, pair: Separation, ways: Flown) -> None:
    by_name = {path.name: path for path in ways.paths}
    time_s = pair.minimum_time_s or 0.0
    both = [at(by_name[name], np.array([time_s]))[0] for name in (pair.first, pair.second)]
    places = to_geodetic(np.array(both), ways.origin)
    verdict = "kept" if (pair.minimum_m or 0.0) >= pair.required_m else "LOST"
    mark = _add(folder, "Placemark")
    _add(mark, "name", f"{pair.first} - {pair.second}: {pair.minimum_m:.1f} m")
    _add(mark, "description", f"{pair.required_m:g} m required: {verdict}")
    stamp = _add(mark, "TimeStamp")
    _add(stamp, "when", iso(time_s + (ways.utc_at_zero_s or 0.0)))
    geometry = _add(mark, "MultiGeometry")
    point = _add(geometry, "Point")
    _add(point, "altitudeMode", "absolute")
    # Not the mean of the longitudes, which is on the other side of the Earth beside the antimeridian.
    middle = to_geodetic(np.mean(both, axis=0)[None, :], ways.origin)
    _add(point, "coordinates", _coordinates(middle))
    line = _add(geometry, "LineString")
    _add(line, "altitudeMode", "absolute")
    _add(line, "coordinates", _coordinates(places))


def _coordinates(places: Floats) -> str:
    return " ".join(f"{lon:.7f},{lat:.7f},{alt:.2f}" for lat, lon, alt in places)


def _thinned(time_s: Floats) -> list[int]:
    """Return the indexes to keep: the first, the last, and points that are at least PERIOD_S apart."""
    kept = [0]
    for index in range(1, len(time_s)):
        if time_s[index] - time_s[kept[-1]] >= PERIOD_S - 1e-6 or index == len(time_s) - 1:
            kept.append(index)
    return kept


def _abgr(rgb: tuple[int, int, int]) -> str:
    red, green, blue = rgb
    return f"ff{blue:02x}{green:02x}{red:02x}"
