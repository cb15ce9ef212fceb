"""Statements are checked against made-up rows that confirm them, and rows that do not."""

from __future__ import annotations

import pytest
from rich.console import Console

from ground_tools.channel.fixed_modes import Row
from ground_tools.paper.figures import delay_rate, fixed_modes, packet_loss
from ground_tools.paper.report import Comparison, Report, Statement, json_rows, show
from ground_tools.paper.study import curves_of

SIDES_M = (100.0, 500.0, 1000.0, 3000.0, 5000.0, 10000.0)
RATES = range(1, 11)
CURVES = (("ble4", "shared"), ("ble5", "shared"), ("wifi", "shared"), ("wifi", "random"))
AS_PUBLISHED = {
    "ble4": (1000, 900, 800, 700, 950, 600, 500, 400, 300, 350),
    "ble5": (2000, 1900, 1800, 1700, 1600, 1500, 1400, 1300, 1200, 1100),
    "wifi": (700, 650, 600, 660, 500, 400, 450, 500, 300, 250),
}
SMALL = {"ble4": 1.0, "ble5": 1.0, "wifi": 1.0}
LARGE = {"ble4": 0.1, "ble5": 1.0, "wifi": 1.0}


def delay(mode, side_m, rate):
    """Delays as the paper describes them."""
    return AS_PUBLISHED[mode][rate - 1] * (SMALL if side_m <= 1000 else LARGE)[mode]


def loss(mode, side_m, rate):
    """Losses as the paper describes them."""
    share = {"ble4": 0.005 * 100 / side_m, "ble5": 0.02, "wifi": 0.01}[mode]
    return rate * share * (1.0 if mode == "ble4" or side_m <= 1000 else 1000 / side_m)


def rows_of(delay=delay, loss=loss, sigma_db=0.0, error_ms=3.0):
    return [
        Row(
            mode, rate, side_m, sigma_db, reading,
            delay(mode, side_m, rate), error_ms, loss(mode, side_m, rate), 0.0, 10, 5,
        )
        for side_m in SIDES_M
        for mode, reading in CURVES
        for rate in RATES
    ]  # fmt: skip


def verdicts(statements):
    return {s.published: s.verdict for s in statements}


def test_rows_as_published_hold():
    for module in (delay_rate, packet_loss):
        found = module.statements(rows_of())
        assert len(found) >= 10
        assert {s.verdict for s in found} == {"holds"}, [s for s in found if not s.holds]
        assert len({s.published for s in found}) == len(found)


@pytest.mark.parametrize("curve", ["BLE 4", "Wi-Fi shared", "Wi-Fi random"])
def test_a_missing_and_an_unexpected_jump(curve):
    name = {"BLE 4": "ble4"}.get(curve, "wifi")
    at, elsewhere = {"ble4": (5, 3), "wifi": (7, 2)}[name]

    def changed(mode, side_m, rate):
        if mode == name and side_m == 500.0:
            if rate == at:
                return delay(mode, side_m, rate - 1)  # equal is no jump
            if rate == elsewhere:
                return delay(mode, side_m, rate - 1) + 0.1
        return delay(mode, side_m, rate)

    found = verdicts(delay_rate.statements(rows_of(changed)))
    assert found[f"{curve} jumps at rate {at}"] == "holds at 5 of 6"
    assert found[f"{curve} jumps at no other rate"] == "holds at 5 of 6"
    other = {"ble4": 10, "wifi": 8}[name]
    assert found[f"{curve} jumps at rate {other}"] == "holds"


def test_a_jump_of_ble5():
    def changed(mode, side_m, rate):
        return 1450 if (mode, rate) == ("ble5", 8) else delay(mode, side_m, rate)

    (found,) = [s for s in delay_rate.statements(rows_of(changed)) if "BLE 5 falls" in s.published]
    assert (found.ours, found.verdict) == ("jumps at 8", "does not hold")
    assert found.checks == {f"{side_m:,g} m": False for side_m in SIDES_M}


def test_other_best_rates():
    def changed(mode, side_m, rate):
        return 1.0 if (mode, rate) == ("ble4", 7) else delay(mode, side_m, rate)

    found = {s.published: s for s in delay_rate.statements(rows_of(changed))}
    best = found["BLE 4 is fastest at rate 9"]
    assert (best.ours, best.holds) == ("fastest at 7", False)
    # This also makes BLE 4 the fastest in small sizes.
    assert found["Wi-Fi shared is fastest in small sizes"].verdict == "does not hold"
    assert found["Wi-Fi shared is fastest in small sizes"].ours == "BLE 4"
    assert found["BLE 4 is fastest in large sizes (Wi-Fi shared)"].holds


def test_the_order_of_the_modes():
    def changed(mode, side_m, rate):
        factor = {("ble4", 5000.0): 100.0, ("ble5", 100.0): 0.24}.get((mode, side_m), 1.0)
        return factor * delay(mode, side_m, rate)

    found = {s.published: s for s in delay_rate.statements(rows_of(changed))}
    assert found["BLE 4 is fastest in large sizes (Wi-Fi random)"].verdict == "holds at 2 of 3"
    slowest = found["BLE 5 is slowest in small sizes (Wi-Fi random)"]
    assert (slowest.verdict, slowest.ours) == ("holds at 2 of 3", "BLE 4 or BLE 5")


def test_jumps_are_rates_with_a_larger_delay_than_the_one_before():
    curve = curves_of(rows_of())["Wi-Fi shared"]
    assert delay_rate.jumps(curve, 100.0) == (4, 7, 8)


def test_nobody_in_range_is_reported():
    def nobody(mode, side_m, rate):
        return 0.0 if mode == "ble4" else delay(mode, side_m, rate)

    def none(mode, side_m, rate):
        return None if mode == "ble4" and side_m > 5000 else loss(mode, side_m, rate)

    found = {s.published: s for s in delay_rate.statements(rows_of(nobody))}
    assert found["BLE 4 jumps at rate 5"].ours == "nobody in range"
    assert not found["BLE 4 jumps at rate 5"].holds
    found = {s.published: s for s in packet_loss.statements(rows_of(loss=none))}
    assert found["BLE 4 is near zero in large sizes"].verdict == "holds at 2 of 3"
    assert found["BLE 4 is near zero in large sizes"].ours.endswith("- %")


@pytest.mark.parametrize(
    ("wanted", "mode", "side_m", "factor", "verdict"),
    [
        ("BLE 5 is unchanged in small sizes", "ble5", 500.0, 0.91, "holds at 5 of 10"),
        ("Wi-Fi shared is unchanged in small sizes", "wifi", 1000.0, 0.6, "holds at 2 of 10"),
        ("BLE 4 falls with the size", "ble4", 1000.0, 3.0, "holds at 4 of 5"),
        ("BLE 4 is near zero in large sizes", "ble4", 3000.0, 6.1, "holds at 2 of 3"),
        ("BLE 5 is above BLE 4 and Wi-Fi shared in small sizes", "ble5", 500.0, 0.5, "holds at 2 of 3"),
        ("BLE 5 is above BLE 4 and Wi-Fi random in small sizes", "wifi", 100.0, 2.0, "holds at 2 of 3"),
        ("BLE 5 falls in large sizes", "ble5", 5000.0, 0.4, "holds at 1 of 2"),
        ("Wi-Fi random falls in large sizes", "wifi", 10000.0, 2.0, "holds at 1 of 2"),
    ],
)
def test_losses_that_are_not_as_published(wanted, mode, side_m, factor, verdict):
    def changed(m, s, r):
        return loss(m, s, r) * (factor if (m, s) == (mode, side_m) else 1.0)

    assert verdicts(packet_loss.statements(rows_of(loss=changed)))[wanted] == verdict


def test_a_loss_at_one_rate_is_enough_to_fall_short():
    def changed(mode, side_m, rate):
        return 0.5 if (mode, side_m, rate) == ("wifi", 5000.0, 3) else loss(mode, side_m, rate)

    found = verdicts(packet_loss.statements(rows_of(loss=changed)))
    assert found["Wi-Fi shared falls in large sizes"] == "holds at 1 of 2"


def test_fixed_modes_are_means_over_sizes_at_their_best_rates():
    found = {
        (c.name, c.labels["density"]): c for c in fixed_modes.comparisons(rows_of(sigma_db=2.0, error_ms=3.0))
    }
    assert len(found) == 4 * 3
    low = found["BLE 4", "low"]
    assert low.labels == {
        "mode": "ble4", "wifi_channels": "shared", "rate": 9, "sigma_db": 2.0, "density": "low",
    }  # fmt: skip
    assert (low.ours_ms, low.published_ms) == (pytest.approx(30.0), 232.38)
    assert low.error_ms == pytest.approx(3.0 / 3**0.5)
    assert low.ratio == pytest.approx(30.0 / 232.38)
    assert found["BLE 4", "dynamic"].ours_ms == pytest.approx((3 * 300 + 3 * 30) / 6)
    assert found["BLE 4", "dynamic"].error_ms == pytest.approx(3.0 / 6**0.5)
    assert found["BLE 4", "high"].published_ms is None
    assert found["BLE 4", "high"].ratio is None
    assert found["BLE 5", "dynamic"].published_ms is None
    for reading in ("shared", "random"):
        wifi = [found[f"Wi-Fi {reading}", density] for density in ("high", "low", "dynamic")]
        assert [c.published_ms for c in wifi] == [1865.07, 1487.69, 1671.77]
        assert {c.labels["rate"] for c in wifi} == {10}


def test_the_rate_is_that_of_least_mean_over_all_sizes():
    """For BLE 4, rate 2 is better by 100 ms in small sizes and rate 3 by 40 ms in large ones; and the
    reverse."""
    for small_ms, large_ms, best in ((100.0, 40.0, 2), (40.0, 100.0, 3)):

        def changed(mode, side_m, rate, small_ms=small_ms, large_ms=large_ms):
            if side_m <= 1000:
                return {2: 10.0, 3: 10.0 + small_ms}.get(rate, 5000.0)
            return {2: 10.0 + large_ms, 3: 10.0}.get(rate, 5000.0)

        found = fixed_modes.comparisons(rows_of(changed))
        assert {c.labels["rate"] for c in found} == {best}


def test_json_rows():
    report = Report(
        "t",
        (),
        (Statement("s", "o", {"a": True, "b": False}),),
        (Comparison("n", {"mode": "x"}, 3.0, float("inf"), 2.0),),
    )
    assert json_rows("f", report) == [
        {
            "figure": "f",
            "kind": "statement",
            "published": "s",
            "ours": "o",
            "holds": False,
            "checks": {"a": True, "b": False},
        },
        {
            "figure": "f",
            "kind": "number",
            "mode": "x",
            "published_ms": 2.0,
            "ours_ms": 3.0,
            "ours_se_ms": None,
            "ratio": 1.5,
        },
    ]


def test_a_note_keeps_its_brackets(capsys):
    """They are no markup: the extra that is to be installed stands in them."""
    show(Report("title", notes=("pip install 'dmuca[train]'",)), Console(width=160))
    assert "pip install 'dmuca[train]'" in capsys.readouterr().out
