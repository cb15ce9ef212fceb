"""Results of the encounters of a cell, as numbers and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from ground_tools.campaign.encounters import ratios
from ground_tools.campaign.encounters.cells import Cell, Row

LIMITS_HEARD: Final = (0.18, 0.40)
"""Greatest risk ratio and ratio of losses of well clear of ASTM F3442/F3442M-20 against intruders that
transmit."""
LIMITS_UNHEARD: Final = (0.30, 0.50)
"""The same limits against intruders that do not transmit."""
_MOST_SEEDS: Final = 20


def summary(cell: Cell, rows: Sequence[Row]) -> dict[str, Any]:
    """The reported results. Counts are unweighted; the ratios use the importance weights (`ratios`)."""
    weights = np.array([row.weight for row in rows])
    nmac, nmac_unavoided = (
        np.array([getattr(row, name) for row in rows], bool) for name in ("nmac", "nmac_unavoided")
    )
    lowc, lowc_unavoided = (
        np.array([getattr(row, name) is not None for row in rows], bool)
        for name in ("lowc_s", "lowc_unavoided_s")
    )
    alerted = np.array([row.alert_s is not None for row in rows], bool)
    ahead = [
        row.lowc_unavoided_s - row.alert_s
        for row in rows
        if row.alert_s is not None and row.lowc_unavoided_s is not None
    ]
    deviation = np.array([row.deviation_m for row in rows])
    risk_limit, lowc_limit = LIMITS_UNHEARD if cell.altitude == "unheard" else LIMITS_HEARD
    return {
        "encounters": len(rows),
        "effective_encounters": round(ratios.effective(weights), 1),
        "nmac": int(nmac.sum()),
        "nmac_unavoided": int(nmac_unavoided.sum()),
        "nmac_induced": int((nmac & ~nmac_unavoided).sum()),
        "risk_ratio": ratios.ratio(nmac, nmac_unavoided, weights),
        "risk_ratio_interval": ratios.interval(nmac, nmac_unavoided, weights),
        "risk_ratio_limit": risk_limit,
        "lowc": int(lowc.sum()),
        "lowc_unavoided": int(lowc_unavoided.sum()),
        "lowc_induced": int((lowc & ~lowc_unavoided).sum()),
        "lowc_ratio": ratios.ratio(lowc, lowc_unavoided, weights),
        "lowc_ratio_interval": ratios.interval(lowc, lowc_unavoided, weights),
        "lowc_ratio_limit": lowc_limit,
        "alerts": int(alerted.sum()),
        "false_alerts": int((alerted & ~lowc_unavoided).sum()),
        "late_alerts": int(lowc_unavoided.sum()) - sum(time_s > 0.0 for time_s in ahead),
        "alert_time_median_s": float(np.median(ahead)) if ahead else None,
        "alert_time_p5_s": float(np.percentile(ahead, 5)) if ahead else None,
        "deviation_median_m": float(np.median(deviation)),
        "deviation_p95_m": float(np.percentile(deviation, 95)),
        "deviation_max_m": float(deviation.max()),
        "aside_max_m": max(row.aside_m for row in rows),
        "containment_m": cell.reach_m[0],
        "nmac_seeds": [row.seed for row in rows if row.nmac][:_MOST_SEEDS],
    }


def lines(cell: Cell, found: dict[str, Any]) -> list[str]:
    """The results as text."""
    heard = "not heard" if cell.altitude == "unheard" else f"heard with {cell.altitude} altitude"
    heard += ", taken for a small aircraft" if cell.taken == "small" else ""
    own = "hovering" if cell.own == "hover" else f"at {cell.own} m/s"
    r = found
    said = [
        f"{cell.model}, {heard}; own aircraft {own}, separations {cell.horizontal_m:g} m or "
        f"{cell.vertical_m:g} m: {r['encounters']:,} encounters (effective {r['effective_encounters']:,})",
        f"near mid-air collisions: {r['nmac']:,}, of these induced {r['nmac_induced']:,}; without avoidance "
        f"{r['nmac_unavoided']:,}",
        _ratio("risk ratio", r, "risk_ratio"),
        f"losses of well clear: {r['lowc']:,}, of these induced {r['lowc_induced']:,}; without avoidance "
        f"{r['lowc_unavoided']:,}",
        _ratio("ratio of losses of well clear", r, "lowc_ratio"),
        f"alerts: {r['alerts']:,}, of these false {r['false_alerts']:,}; not before well clear was lost: "
        f"{r['late_alerts']:,}",
    ]
    if r["alert_time_median_s"] is not None:
        said.append(
            f"alert before well clear would be lost: median {r['alert_time_median_s']:.1f} s, "
            f"5th percentile {r['alert_time_p5_s']:.1f} s"
        )
    said.append(
        f"largest deviation: median {r['deviation_median_m']:.0f} m, 95th percentile "
        f"{r['deviation_p95_m']:.0f} m, largest {r['deviation_max_m']:.0f} m; aside from the path at most "
        f"{r['aside_max_m']:.0f} m, of {r['containment_m']:.0f} m in the containment"
    )
    if r["nmac_seeds"]:
        said.append(f"seeds with a near mid-air collision: {', '.join(map(str, r['nmac_seeds']))}")
    return said


def _ratio(words: str, found: dict[str, Any], key: str) -> str:
    if found[key] is None:
        return f"{words}: none, because none happened without avoidance"
    low, high = found[f"{key}_interval"]
    return (
        f"{words}: {found[key]:.3f} (95 % interval: {low:.3f} to {high:.3f}; ASTM F3442: at most "
        f"{found[f'{key}_limit']:.2f})"
    )
