"""The report is self-contained, printable and complete, and treats nothing from a log as markup."""

import html.parser
import re
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.config import Config, FlightConfig, IdentityConfig
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import AlertChanged, AuthorityChanged, Broadcast, VehicleText
from companion.remote_id.messages import Location
from ground_tools.inspect.explain.manoeuvres import find
from ground_tools.inspect.read.flown import flown, separations
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import plots
from ground_tools.inspect.report.page import page
from ground_tools.inspect.report.summary import describe
from tests.browser import chromium
from tests.ground_tools.inspect.flights import decision, guarded, inspect, read, step, track, write

pytest.importorskip("matplotlib")
EVIL = "<script>alert(1)</script>$x_{\\frac}$\"'&\x1b[2J"


class Page(html.parser.HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.words.append(data)


def page_of(folder: Path) -> str:
    run = read_run(folder)
    return page(run, describe(run))


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page of a run in which an attacker chose all names and texts."""
    folder = tmp_path_factory.mktemp("hostile") / "<b>run"
    for name in ("ONE" + EVIL[:20], "TWO" + EVIL[:20]):
        steps = [
            step(
                k / 5,
                decision(track(EVIL), chosen=(4, 3, 0)),
                Broadcast(transport="wifi" if k % 2 else "nan", messages=(Location(),)),
                *(
                    [
                        AlertChanged(
                            track_id=EVIL,
                            level=2,
                            reason=EVIL,
                            time_to_closest_s=1.0,
                            horizontal_m=1.0,
                            vertical_m=1.0,
                            acting=True,
                        )
                    ]
                    if k == 5
                    else []
                ),
                AuthorityChanged(previous="guarding", state=EVIL, trigger="x", reason=EVIL),
                events=(VehicleText(severity=1, text=EVIL),),
            )
            for k in range(40)
        ]
        write(folder, Config(identity=IdentityConfig(uas_id=name), flight=FlightConfig(use="fly")), steps)
    (folder / "manifest.json").write_text('{"what": "<img src=x>"}')
    return page_of(folder)


@pytest.fixture(scope="module")
def guard(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A guarded vehicle of which control was taken, and its page."""
    folder = tmp_path_factory.mktemp("guard")
    for config, steps in guarded():
        write(folder, config, steps)
    return SimpleNamespace(folder=folder, page=page_of(folder))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pages without drawings, which take two seconds per page."""
    monkeypatch.setattr(plots, "svg", lambda size_in, draw: "<svg></svg>")


def test_nothing_of_a_log_is_markup(hostile: str) -> None:
    found = Page(hostile)
    assert "script" not in found.tags
    assert "img" not in found.tags
    assert "b" not in found.tags
    words = "".join(found.words)
    assert "<script>alert(1)</script>" in words
    assert "$x_{\\\\frac}$" in words or "$x_{\\frac}$" in words
    assert "\x1b" not in words
    assert "written by <img src=x>" in words


def test_nothing_is_fetched(hostile: str) -> None:
    found = Page(hostile)
    for name, value in found.attributes:
        if name in ("src", "href", "xlink:href", "data", "action"):
            assert (value or "").startswith("#"), (name, value)
    assert "@import" not in hostile
    assert re.findall(r"url\((?!#)", hostile) == []
    assert ("content", "default-src 'none'; style-src 'unsafe-inline'") in found.attributes


def test_every_plot_and_manoeuvre_is_there(guard: SimpleNamespace) -> None:
    text = guard.page
    found = Page(text)
    titles = ["Conflicts", "Paths from above", "Separation", "Authority, modes, events and alerts"]
    titles += [
        "Height",
        "Speeds",
        "Age of information",
        "Broadcasts",
        "Flights",
        "Manoeuvres",
        "All manoeuvres",
    ]
    assert [t for t in titles if f"<h2>{t}</h2>" not in text] == []
    assert found.tags.count("svg") == 8  # seven plots and one velocity space
    words = "".join(found.words)
    assert "would have led within 1.0 m of TWO in 31.8 s" in words
    assert "turn right by 15 deg" in words
    assert "break-inside: avoid" in text
    assert text.count("<svg") == text.count("</svg>")
    assert len(text) < 1_500_000


def test_the_same_run_makes_the_same_page(guard: SimpleNamespace) -> None:
    assert page_of(guard.folder) == guard.page


@pytest.mark.usefixtures("undrawn")
def test_damage_is_reported_at_the_top(run_folder: Path) -> None:
    path = run_folder / "DMUCA002.events"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    words = page_of(run_folder)
    assert words.index("problem: DMUCA002.events: byte") < words.index("<h2>")


def test_a_minimum_survives_the_thinning(run_folder: Path) -> None:
    import numpy as np

    time = np.arange(100_000.0)
    values = np.full(100_000, 50.0)
    values[77_777], values[:50] = 3.0, np.nan
    short_time, short = plots.lowest(time, values)
    assert len(short) < 3000
    assert np.nanmin(short) == 3.0
    assert short_time[np.nanargmin(short)] == 77_777.0


def test_separation_draws_the_limit_and_the_pair(run_folder: Path) -> None:
    drawing = plots.separation(separations(flown(read_run(run_folder)).paths))
    assert "limit 10 m" in drawing
    assert "DMUCA001 - DMUCA002" in drawing


def test_without_any_position_the_rest_is_shown(tmp_path: Path) -> None:
    steps = [Step(now_s=float(t), events=(), commands=()) for t in range(3)]
    write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE")), steps)
    text = page_of(tmp_path)
    assert "no aircraft recorded a position" in text
    assert "<h2>Flights</h2>" in text
    assert "<svg" not in text


def test_fifty_tracks_fit_into_a_velocity_space(tmp_path: Path) -> None:
    many = [track(f"T{k:02}", position_ned_m=(60.0 + k, float(k - 25), -51.0)) for k in range(50)]
    steps = [step(k / 5, decision(*many, chosen=(4, 3, 0))) for k in range(10)]
    config = Config(identity=IdentityConfig(uas_id="ONE"), flight=FlightConfig(use="fly"))
    (one,) = find(read(tmp_path, config, steps))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # matplotlib warns about content that does not fit
        assert "chosen by the law" in plots.velocities(one, 5.0)


def test_the_command_writes_a_report(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect(run_folder, "--report", tmp_path / "r.html") == 0
    assert (tmp_path / "r.html").read_text().startswith("<!DOCTYPE html>")
    assert f"wrote {tmp_path / 'r.html'}" in capsys.readouterr().out
    assert not (run_folder / "inspect.rrd").exists()


@pytest.mark.parametrize("arguments", [["second"], ["--save", "x.rrd"]])
def test_a_report_needs_exactly_one_run(run_folder: Path, arguments: list[str]) -> None:
    with pytest.raises(ConfigError, match="--report"):
        inspect(run_folder, *arguments, "--report", "x.html")


@pytest.mark.usefixtures("undrawn")
def test_an_unwritable_report_is_reported(run_folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"--report: no/such/x.html: cannot be written: No such file"):
        inspect(run_folder, "--report", "no/such/x.html")


def test_missing_matplotlib_is_one_line_of_advice_and_no_file(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ConfigError, match="matplotlib is not installed"):
        inspect(run_folder, "--report", str(tmp_path / "x.html"))
    assert not (tmp_path / "x.html").exists()


@pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing()))
def test_a_browser_shows_the_report_without_messages_or_requests(hostile: str, tmp_path: Path) -> None:
    path = tmp_path / "r.html"
    path.write_text(hostile, encoding="utf-8")
    told: list[str] = []
    with chromium.opened(1000, 800) as browser:
        shown = browser.page
        shown.on("console", lambda message: told.append(message.text))
        shown.on("pageerror", lambda error: told.append(str(error)))
        shown.on("dialog", lambda dialog: told.append(dialog.message))
        shown.goto(path.as_uri())
        sizes = shown.evaluate("[...document.querySelectorAll('svg')].map(s => s.getBBox().width)")
        wide = shown.evaluate("document.documentElement.scrollWidth")
    assert told == []
    assert browser.requests == [path.as_uri()]
    assert len(sizes) >= 7
    assert all(size > 100 for size in sizes)
    assert wide <= 1000


@pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing()))
def test_the_report_is_usable_in_dark_mode_on_a_phone_and_by_keyboard(
    guard: SimpleNamespace, tmp_path: Path
) -> None:
    path = tmp_path / "r.html"
    path.write_text(guard.page, encoding="utf-8")
    colours = "(s => [s.color, s.backgroundColor])(getComputedStyle(document.body))"
    light, dark = ["rgb(27, 27, 27)", "rgb(255, 255, 255)"], ["rgb(232, 232, 232)", "rgb(22, 24, 27)"]
    with chromium.opened(390, 800) as browser:
        shown = browser.page
        shown.goto(path.as_uri())
        assert shown.evaluate(colours) == light
        shown.emulate_media(color_scheme="dark")
        assert shown.evaluate(colours) == dark
        shown.emulate_media(color_scheme="dark", media="print")
        assert shown.evaluate(colours) == light
        shown.emulate_media(color_scheme="light", media="screen")
        assert shown.evaluate("document.documentElement.scrollWidth") <= 390
        assert shown.evaluate("document.querySelector('.verdicts').getBoundingClientRect().bottom") < 800
        shown.keyboard.press("Tab")
        shown.keyboard.press("Enter")
        assert shown.evaluate("location.hash") == "#conflicts"
        boxes = shown.evaluate("[...document.querySelectorAll('.wide')].map(e => e.tabIndex)")
        assert boxes
        assert set(boxes) == {0}


PAPER = "[...document.querySelectorAll('figure #patch_1 path')].map(e => getComputedStyle(e).fill)"
"""Colour behind each drawing."""
DRAWN = """kind => [...document.querySelectorAll('figure svg ' + kind)]
  .filter(e => !e.style.fill.startsWith('rgb(27') && !e.closest('[id^=xtick],[id^=ytick],defs'))
  .map(e => [getComputedStyle(e).fill, getComputedStyle(e).stroke].find(c => c !== 'none'))"""
"""Colours of text and lines, except the grid and text within coloured spans."""

CUT = """[...document.querySelectorAll('figure svg text')].filter(e => {
  const [word, sheet] = [e, e.closest('svg')].map(one => one.getBoundingClientRect());
  return word.left < sheet.left - 1 || word.right > sheet.right + 1;
}).map(e => e.textContent)"""
"""Texts that extend beyond the edge of their drawing."""


def luminance(colour: str) -> float:
    """Relative luminance of "rgb(r, g, b)" (WCAG 2)."""
    parts = [int(part) / 255.0 for part in re.findall(r"\d+", colour)[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours (WCAG 2)."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing()))
def test_drawings_are_legible_in_dark_mode_in_print_and_on_a_phone(
    guard: SimpleNamespace, tmp_path: Path
) -> None:
    path = tmp_path / "r.html"
    path.write_text(guard.page, encoding="utf-8")
    dark, white = "rgb(22, 24, 27)", "rgb(255, 255, 255)"
    boxes = "[...document.querySelectorAll('figure svg')].map(s => s.getBoundingClientRect().toJSON())"
    with chromium.opened(390, 800) as browser:
        shown = browser.page
        shown.emulate_media(color_scheme="dark")
        shown.goto(path.as_uri())
        assert set(shown.evaluate(PAPER)) == {dark}
        words, lines = shown.evaluate(DRAWN, "text"), shown.evaluate(DRAWN, "g[id^=line2d] path")
        assert len(words) > 40
        assert len(lines) > 10
        assert min(contrast(colour, dark) for colour in words) > 7.0
        assert min(contrast(colour, dark) for colour in lines) > 3.0
        # Text keeps its size on a phone: a drawing is scrolled, not shrunk.
        assert all(box["width"] >= 450.0 for box in shown.evaluate(boxes))
        assert shown.evaluate("document.documentElement.scrollWidth") <= 390
        shown.emulate_media(color_scheme="dark", media="print")
        shown.set_viewport_size({"width": 688, "height": 1017})  # A4 without its margins
        assert set(shown.evaluate(PAPER)) == {white}
        assert set(shown.evaluate(DRAWN, "text")) == {"rgb(27, 27, 27)"}
        assert all(box["right"] <= 688.5 and box["height"] < 1017.0 for box in shown.evaluate(boxes))
        assert shown.evaluate(CUT) == []
        assert shown.evaluate("document.documentElement.scrollWidth") <= 688


def test_a_name_that_reads_like_a_colour_stays_as_it_is() -> None:
    def draw(figure: Any) -> None:
        figure.text(0.5, 0.5, 'fill: #000000 style="fill: #ffffff"')

    text = plots.svg((2.0, 1.0), draw)
    assert 'fill: #000000 style="fill: #ffffff"' in "".join(Page(text).words)
    assert "fill: var(--plot-ffffff, #ffffff)" in text
