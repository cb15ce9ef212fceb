"""`ground-tools channel table` and `plot` from the command line."""

from __future__ import annotations

import argparse
import json
import math
import sys

import pytest

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.channel import options, plot
from ground_tools.channel.fixed_modes import Row
from ground_tools.channel.table import delay_cell, json_line, loss_cell, with_error
from sitl_mocks.channel.parameters import ChannelParameters

QUICK = ["--samples", "5", "--sides", "100"]
KEYS = [
    "mode",
    "rate",
    "side_m",
    "sigma_db",
    "wifi_channels",
    "system_delay_ms",
    "system_delay_se_ms",
    "loss",
    "loss_se",
    "uavs",
    "samples",
]


def parsed(*words):
    parser = argparse.ArgumentParser()
    options.add_arguments(parser)
    return options.settings_of(parser.parse_args(words))


def test_defaults():
    settings = parsed()
    assert settings.parameters == ChannelParameters()
    assert settings.sides_m == (100.0, 500.0, 1000.0, 3000.0, 5000.0, 10000.0)
    assert settings.rates == dict.fromkeys(("ble4", "ble5", "wifi"), tuple(range(1, 11)))
    assert settings.sigmas_db == (0.0,)
    assert (settings.uavs, settings.samples, settings.seed) == (10, 1000, 1)


@pytest.mark.parametrize(
    ("words", "rates"),
    [
        (["9"], (9,)),
        (["1-10"], tuple(range(1, 11))),
        (["1,5,9"], (1, 5, 9)),
        (["9", "1", "5"], (1, 5, 9)),
        (["1-3,", "2,7-8"], (1, 2, 3, 7, 8)),
        (["4-4"], (4,)),
    ],
)
def test_rates(words, rates):
    assert parsed("--rates", *words).rates["wifi"] == rates


@pytest.mark.parametrize(
    "words", [["100", "500"], ["100,500"], ["100, 500"], ["100,", "500"], ["1e2,5e2,100"]]
)
def test_sides(words):
    assert parsed("--sides", *words).sides_m == (100.0, 500.0)


def test_modes_and_sigmas():
    settings = parsed("--modes", "wifi,ble4", "--sigma", "0", "2.449")
    assert list(settings.rates) == ["ble4", "wifi"]
    assert settings.sigmas_db == (0.0, 2.449)


def test_a_parameter_file_sets_sigma_and_rates(tmp_path):
    path = tmp_path / "p.toml"
    path.write_text("[ble4]\nmax_rate = 3\n[ble5]\nmax_rate = 12\n[propagation]\nshadowing_sigma_db = 2.0\n")
    settings = parsed("--parameters", str(path))
    assert settings.rates == {"ble4": (1, 2, 3), "ble5": tuple(range(1, 11)), "wifi": tuple(range(1, 11))}
    assert settings.sigmas_db == (2.0,)
    assert parsed("--parameters", str(path), "--sigma", "0").sigmas_db == (0.0,)
    assert parsed("--parameters", str(path), "--modes", "ble5", "--rates", "12").rates == {"ble5": (12,)}
    with pytest.raises(ConfigError, match=r"--rates: 4: ble4: rate 4 is out of range; allowed: 1 to 3"):
        parsed("--parameters", str(path), "--rates", "4")


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--rates", "0"], "--rates: 0: ble4: rate 0 is out of range; allowed: 1 to 10"),
        (["--rates", "11"], "--rates: 11: ble4: rate 11 is out of range; allowed: 1 to 10"),
        (["--rates", "5-999999999"], "allowed: 1 to 10"),
        (["--rates", "5-2"], "--rates: 5-2: the range must rise"),
        (["--rates", "nine"], "--rates: nine is not allowed; allowed: whole numbers"),
        (["--rates", "1.5"], "--rates: 1.5 is not allowed; allowed: whole numbers"),
        (
            ["--sides", "-5"],
            "--sides: -5 is not allowed; allowed: numbers, more than 0 and at most 1,000,000",
        ),
        (["--sides", "0"], "--sides: 0 is not allowed"),
        (["--sides", "nan"], "--sides: nan is not allowed"),
        (["--sides", "inf"], "--sides: inf is not allowed"),
        (["--sides", "wide"], "--sides: wide is not allowed"),
        (["--sides", "1,,2"], "an item of the list is empty"),
        (["--sides", ""], "an item of the list is empty"),
        (["--sigma", "-1"], "--sigma: -1 is not allowed; allowed: numbers, 0 to 30"),
        (["--sigma", "31"], "--sigma: 31 is not allowed; allowed: numbers, 0 to 30"),
        (["--modes", "lora"], "--modes: lora is unknown; allowed: ble4, ble5, wifi"),
        (["--samples", "1"], "--samples: 1 is out of range; allowed: 2 to 100000"),
        (["--samples", "100001"], "--samples: 100001 is out of range"),
        (["--seed", "-1"], "--seed: -1 is out of range; allowed: 0 to 4294967295"),
        (["--uavs", "1"], "--uavs: 1 is out of range; allowed: 2 to 1000"),
        (["--uavs", "1001"], "--uavs: 1001 is out of range"),
        (["--parameters", "/nowhere/p.toml"], "/nowhere/p.toml: cannot be read"),
    ],
)
def test_wrong_options_are_named_and_exit_with_2(capsys, words, what):
    assert cli.main(["channel", "table", *words]) == 2
    out, err = capsys.readouterr()
    assert what in err
    assert not out


def test_json_lines(capsys):
    assert cli.main(["channel", "table", "--json", *QUICK, "--rates", "9,10", "--sigma", "0", "2.449"]) == 0
    out, err = capsys.readouterr()
    rows = [json.loads(line) for line in out.splitlines()]
    assert not err  # no progress bar, because stderr is not a terminal
    assert [list(row) for row in rows] == [KEYS] * (2 * 2 * 4)
    assert {row["sigma_db"] for row in rows} == {0.0, 2.449}
    assert {(row["mode"], row["wifi_channels"]) for row in rows} == {
        ("ble4", "shared"),
        ("ble5", "shared"),
        ("wifi", "shared"),
        ("wifi", "random"),
    }
    first = rows[0]
    assert (first["mode"], first["rate"], first["side_m"], first["samples"]) == ("ble4", 9, 100.0, 5)
    assert first["system_delay_ms"] == pytest.approx(3131, rel=0.01)


def test_progress_in_a_terminal_leaves_the_output_alone(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert cli.main(["channel", "table", "--json", *QUICK, "--rates", "9"]) == 0
    out, err = capsys.readouterr()
    assert [json.loads(line)["mode"] for line in out.splitlines()] == ["ble4", "ble5", "wifi", "wifi"]
    assert "fixed modes" in err


def test_json_is_null_where_nobody_is_in_range(capsys):
    assert (
        cli.main(["channel", "table", "--json", "--samples", "2", "--sides", "900000", "--rates", "1"]) == 0
    )
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(row["loss"], row["loss_se"], row["system_delay_ms"]) for row in rows] == [(None, None, 0.0)] * 4


def test_the_table_for_people_fits_80_columns_and_says_what_it_shows(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["channel", "table", *QUICK]) == 0
    out = capsys.readouterr().out
    assert "Side 100 m, sigma 0 dB, 10 aircraft, 5 environments" in out
    assert "3131 ±0.0  5.29" in out
    assert "Monte Carlo" in out
    assert max(map(len, out.splitlines())) <= 80
    assert "…" not in out


def test_rates_that_a_mode_lacks_stay_empty(capsys, tmp_path):
    path = tmp_path / "p.toml"
    path.write_text("[ble4]\nmax_rate = 1\n")
    assert cli.main(["channel", "table", *QUICK, "--modes", "ble4,ble5", "--parameters", str(path)]) == 0
    lines = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line.split()}
    assert len(lines["1"]) == 1 + 2 * 3
    assert len(lines["2"]) == 1 + 3


def row(**changes):
    usual = dict(
        zip(KEYS, ["ble4", 9, 100.0, 0.0, "shared", 487.25, 3.44, 0.0512, 0.001, 10, 5], strict=True)
    )
    return Row(**(usual | changes))


def test_cells():
    assert delay_cell(row()) == "487.2 ±3.4"
    assert delay_cell(row(system_delay_ms=None, system_delay_se_ms=None)) == "never"
    assert json.loads(json_line(row(system_delay_ms=None)))["system_delay_ms"] is None
    assert loss_cell(row()) == "5.12"
    assert loss_cell(row(loss=None)) == "-"
    assert [with_error(3131.27, 0.04), with_error(612.3, 61.9)] == ["3131 ±0.0", "612 ±62"]


def test_plot_writes_a_picture(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    path = tmp_path / "delay.png"
    assert cli.main(["channel", "plot", "--out", str(path), "--samples", "5", "--rates", "8-10"]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")
    assert str(path) in capsys.readouterr().out


@pytest.mark.filterwarnings("error")
def test_plot_where_nobody_is_in_range(tmp_path):
    pytest.importorskip("matplotlib")
    words = ["--samples", "2", "--sides", "900000", "--rates", "1", "--out", str(tmp_path / "p.png")]
    assert cli.main(["channel", "plot", *words]) == 0


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--sigma", "0", "1"], "--sigma: 2 values are too many; allowed in a picture: 1"),
        (
            ["--sides", *map(str, range(1, 14))],
            "--sides: 13 values are too many; allowed in a picture: up to 12",
        ),
        (["--out", "{}/p"], "/p: cannot be written: the file name must end in .png"),
        (["--out", "{}"], ": cannot be written: the file name must end in .png"),
        (["--out", "{}/p.jpgg"], "/p.jpgg: cannot be written: the file name must end in .png"),
        (["--out", "{}/none/p.png"], "/none/p.png: cannot be written: the folder "),
        (["--out", "{}/folder.png"], "/folder.png: cannot be written: it is a folder"),
    ],
)
def test_plot_refuses_wrong_options_before_it_computes(tmp_path, capsys, monkeypatch, words, what):
    monkeypatch.setattr(plot, "evaluate", lambda *_: pytest.fail("computed"))
    place = tmp_path / "here"
    (place / "folder.png").mkdir(parents=True)
    words = [word.replace("{}", str(place)) for word in words]
    assert cli.main(["channel", "plot", "--out", str(place / "p.png"), *words]) == 2
    error = capsys.readouterr().err
    assert what in error
    assert words[0] in error
    assert [path.name for path in tmp_path.rglob("*")] == ["here", "folder.png"]


def test_plot_without_matplotlib_or_folder(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    words = ["channel", "plot", *QUICK, "--rates", "9", "--out"]
    assert cli.main([*words, str(tmp_path / "none" / "p.png")]) == 2
    assert "cannot be written" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main([*words, str(tmp_path / "p.png")]) == 2
    assert ".[inspect]" in capsys.readouterr().err


def test_plot_draws_the_rows():
    figures = pytest.importorskip("matplotlib.figure")
    figure = figures.Figure()
    rows = [
        row(mode=mode, wifi_channels=reading, side_m=side_m, rate=rate, system_delay_ms=side_m * rate)
        for side_m in (100.0, 500.0)
        for mode, reading in (("ble4", "shared"), ("wifi", "shared"), ("wifi", "random"))
        for rate in (1, 2, 3)
    ]
    plot.draw(figure, rows, "delay")
    first, second = figure.axes
    assert [axes.get_title(loc="left") or axes.get_title() for axes in (first, second)] == [
        "side 100 m",
        "side 500 m",
    ]
    assert first.get_legend_handles_labels()[1] == ["BLE 4", "Wi-Fi shared", "Wi-Fi random"]
    assert list(second.containers[1].lines[0].get_ydata()) == [500.0, 1000.0, 1500.0]
    assert [lines[0].get_linestyle() for lines in second.containers] == ["-", "-", "--"]
    assert first.get_yscale() == second.get_yscale() == "log"


def test_plot_draws_losses_in_percent_with_gaps():
    figures = pytest.importorskip("matplotlib.figure")
    figure = figures.Figure()
    losses = {1: 0.05, 2: None, 3: 0.25}
    plot.draw(figure, [row(rate=rate, loss=loss) for rate, loss in losses.items()], "loss")
    (axes,) = figure.axes
    assert axes.containers[0].lines[0].get_ydata() == pytest.approx([5.0, math.nan, 25.0], nan_ok=True)
    assert (axes.get_ylim()[0], axes.get_yscale()) == (0.0, "linear")
    (_, _, (bars,)) = axes.containers[0].lines
    low, high = bars.get_segments()[0][:, 1]
    assert (low, high) == pytest.approx((4.9, 5.1))


def test_json_of_numbers_that_json_does_not_know_is_an_error():
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_line(row(loss=math.nan))
