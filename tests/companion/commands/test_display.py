"""The display's server: who is answered, what a flight notices of browsers, and the page in a real one."""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import re
import socket
import threading
import time

import msgspec
import pytest

from companion.commands import cli
from companion.commands import display as display_module
from companion.commands.display import MOST_AT_ONCE, Display, _Source, read_token
from companion.errors import ConfigError
from companion.runtime.status.status_socket import StatusServer, TrackStatus
from tests.browser import chromium
from tests.companion.runtime.status.test_status import STATUS
from tests.support.waiting import until

LONG_S = 60.0
LEVELS = ("none", "advisory", "caution", "warning")


def track(number):
    return TrackStatus(
        track_id=f"UAS{number:03d}<b>", transport="wifi", distance_m=40.0 + 9.0 * number,
        above_m=(None, -80.0, 0.0, 80.0)[number % 4], speed_mps=5.0, age_s=0.1 * number,
        alert=LEVELS[number % 4], conflict=number == 3, bearing_deg=7.2 * number, track_deg=float(number),
    )  # fmt: skip


BUSY = msgspec.structs.replace(
    STATUS, tracks=tuple(track(n) for n in range(50)), track_count=62, radio="hci0: 24 frames",
    wanted_ned_mps=(3.0, 0.0, 0.0), chosen_ned_mps=(2.0, 2.0, -0.5), limits=("fence",),
)  # fmt: skip


@pytest.fixture
def flight(tmp_path):
    """The status socket of a flight that is served until the end, and how often it was asked."""
    server, ended, asked = (
        StatusServer("companion-OWN", {"RUNTIME_DIRECTORY": str(tmp_path)}),
        threading.Event(),
        [],
    )

    def state():
        asked.append(1)
        return BUSY

    def serve():
        while not ended.wait(0.005):
            server.serve(state)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield server.path, asked
    ended.set()
    thread.join(LONG_S)
    server.close()


@contextlib.contextmanager
def served(path, host="127.0.0.1", token=None):
    with Display(path, host, 0, token) as display:
        thread = threading.Thread(target=display.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        try:
            yield display
        finally:
            display.shutdown()
            thread.join(LONG_S)


def get(display, path, host=None):
    connection = http.client.HTTPConnection("127.0.0.1", display.server_port, timeout=LONG_S)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    return answer.status, answer.read(), answer.headers


def test_the_page_and_the_state_are_served(flight):
    with served(flight[0]) as display:
        code, page, headers = get(display, "/")
        assert (code, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
        assert b"<svg" in page
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        code, state, _ = get(display, "/state")
        assert code == 200
        assert json.loads(state) == json.loads(msgspec.json.encode(BUSY))
        assert get(display, "/etc/passwd")[0] == 404


def test_the_page_names_no_other_host():
    page = display_module._PAGE.read_text().replace("http://www.w3.org/2000/svg", "")
    assert "//" not in page.replace("// ", "")


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "192.168.0.7", "["]
)
def test_on_loopback_only_its_own_names_are_answered(flight, host):
    with served(flight[0]) as display:
        assert get(display, "/state", host)[0] == 403
        for own in ("localhost", f"127.0.0.1:{display.server_port}", "[::1]:1"):
            assert get(display, "/state", own)[0] == 200


def test_elsewhere_nothing_is_answered_without_the_token(flight):
    with served(flight[0], "0.0.0.0") as display:
        token = display.url.partition("?token=")[2]
        assert len(token) >= 16
        for path in ("/", "/state", "/?token=", f"/state?token={token[:-1]}", f"/state?token={token}x"):
            code, body, _ = get(display, path)
            assert (code, body) == (403, b"the token is missing or wrong\n")
        assert get(display, f"/state?token={token}")[0] == 200
        assert get(display, f"/state?token={token}", "evil.example")[0] == 403
        assert get(display, f"/state?token={token}", f"{socket.gethostname()}:1")[0] == 200


def test_a_token_may_be_given_on_loopback_too(flight):
    with served(flight[0], token="correct horse") as display:
        assert get(display, "/state")[0] == 403
        assert get(display, "/state?token=correct%20horse")[0] == 200


def test_the_token_comes_from_a_file_because_options_are_seen_by_all_users(tmp_path, capsys):
    path = tmp_path / "token"
    with pytest.raises(ConfigError, match="no such file"):
        read_token(path)
    path.write_text("correct horse\n")
    path.chmod(0o644)
    with pytest.raises(ConfigError, match=r"--token-file: .*mode 0644 .*run chmod 600"):
        read_token(path)
    path.chmod(0o600)
    assert read_token(path) == "correct horse"
    path.write_bytes(b"\xff" * 20)
    with pytest.raises(ConfigError, match="not UTF-8 text"):
        read_token(path)
    assert cli.main(["display", "--socket", str(path), "--token", "correct horse"]) == 2
    assert "correct horse" not in capsys.readouterr().err


@pytest.mark.parametrize("token", ["a b&c#d%e+f=gh", "schlüssel-für-heute"])
def test_the_printed_address_works_with_any_token(flight, token):
    with served(flight[0], token=token) as display:
        assert get(display, display.url.removeprefix(f"http://127.0.0.1:{display.server_port}"))[0] == 200


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("example.org", 0, None), "--host: 'example.org'"),
        (("127.0.0.1", 0, "short"), "--token-file: too short"),
        (("127.0.0.1", 99999, None), "cannot listen there"),
        (("192.0.2.1", 0, None), "cannot listen there"),
    ],
)
def test_wrong_options_are_named(tmp_path, options, words):
    with pytest.raises(ConfigError) as refused:
        Display(tmp_path / "x.sock", *options)
    assert words in str(refused.value)


def test_the_flight_is_asked_at_most_twice_a_second_however_many_look(tmp_path, monkeypatch):
    asked, now = [], [0.0]
    monkeypatch.setattr(display_module, "ask", lambda path: asked.append(path) or BUSY)
    source = _Source(tmp_path, lambda: now[0])
    for _ in range(100):
        source.state()
    assert len(asked) == 1
    now[0] = 0.5
    source.state()
    assert len(asked) == 2


def answers_again(display):
    """Whether the page answers within `LONG_S`."""
    deadline_s = time.monotonic() + LONG_S
    while time.monotonic() < deadline_s:
        with contextlib.suppress(OSError, http.client.HTTPException):
            if get(display, "/state")[0] == 200:
                return True
        time.sleep(0.02)
    return False


def test_who_hangs_holds_neither_the_flight_nor_others(flight, monkeypatch):
    """Browsers that connect and say nothing: further ones are refused until those are given up."""
    path, asked = flight
    monkeypatch.setattr(display_module._Handler, "timeout", 0.3)
    with served(path) as display, contextlib.ExitStack() as open_ones:
        for number in range(MOST_AT_ONCE):
            hung = open_ones.enter_context(
                socket.create_connection(("127.0.0.1", display.server_port), LONG_S)
            )
            hung.sendall(b"GET /state HTTP/1.1\r\n" if number % 2 else b"")
        assert answers_again(display)
        assert len(asked) == 1


def test_who_sends_one_byte_now_and_then_is_given_up_too(flight, monkeypatch):
    """Each byte restarts the socket's own timeout, which is without end here."""
    path, _ = flight
    monkeypatch.setattr(display_module._Handler, "timeout", None)
    monkeypatch.setattr(display_module, "_PATIENCE_S", 0.3)
    with served(path) as display, contextlib.ExitStack() as open_ones:
        slow = [
            open_ones.enter_context(socket.create_connection(("127.0.0.1", display.server_port), LONG_S))
            for _ in range(MOST_AT_ONCE)
        ]
        for one in slow:
            one.sendall(b"GET /state HTTP/1.1\r\nX-Slow: a")
        assert [one.recv(1) for one in slow] == [b""] * MOST_AT_ONCE, "they are cut off"
        assert answers_again(display)


def test_a_flight_that_ended_is_said(tmp_path):
    state = json.loads(_Source(tmp_path / "gone.sock").state())
    assert "no companion answers there" in state["error"]


def test_without_a_flight_the_command_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(display_module, "find_socket", lambda given, environ: tmp_path / "gone.sock")
    assert cli.main(["display", "--host", "nowhere"]) == 2
    assert "--host: 'nowhere'" in capsys.readouterr().err


@pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing()))
@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_draws_every_track_and_asks_nobody_else(flight, width):
    with served(flight[0]) as display, chromium.opened(width, 800) as page:
        page.page.goto(display.url)
        page.page.wait_for_selector("svg g.track")
        assert page.page.locator("svg g.track").count() == 50
        assert page.page.locator("#tracks tr").count() == 50
        assert page.page.locator("svg b, #tracks b").count() == 0, "names are text, not markup"
        texts = page.page.locator("main").inner_text()
        for words in (
            "2.8 m/s towards 045°, up 0.5",
            "avoids UAS003<b>; limited by fence",
            "hci0: 24 frames",
            "wifi 2/s",
        ):
            assert words in texts
        # Track 5 is drawn at its bearing and at its distance in the scale of the outer ring.
        ring_m = page.page.locator("svg text").all_text_contents()[3]
        scale = 190.0 / {"500 m": 500.0}[ring_m]
        moved = page.page.locator("svg g.track").nth(5).get_attribute("transform")
        x, y = map(float, moved.removeprefix("translate(").removesuffix(")").split())
        assert math.hypot(x, y) == pytest.approx(scale * BUSY.tracks[5].distance_m, abs=0.1)
        assert math.degrees(math.atan2(x, -y)) == pytest.approx(BUSY.tracks[5].bearing_deg, abs=0.1)
        assert page.page.evaluate("document.documentElement.scrollWidth") <= width
        # On a busy machine, an answer may have come late.
        page.page.wait_for_selector("#trouble", state="hidden")
        assert all(
            url.startswith((f"http://127.0.0.1:{display.server_port}/", "data:")) for url in page.requests
        )
        assert page.errors == []
        # The browser's clock is set back.
        page.page.evaluate("{ const now = Date.now; Date.now = () => now() - 3.6e6; }")
        display.source._path = display.source._path.with_name("gone.sock")
        page.page.wait_for_selector("#trouble:not([hidden])")
        trouble = page.page.locator("#trouble").inner_text()
        assert "no companion answers there" in trouble
        assert re.search(r"what is shown is \d+ s old", trouble), "never younger than it is"


@pytest.mark.skipif(chromium.missing() is not None, reason=str(chromium.missing()))
def test_a_stopped_browser_changes_nothing_for_the_flight_and_for_others(flight):
    """A page that asks once a second stops, as on a phone that sleeps; others are answered as before."""
    (path, asked), answers = flight, []
    with served(path) as display, chromium.opened(390, 800) as page:
        page.page.goto(display.url)
        page.page.wait_for_selector("svg g.track")
        with chromium.stopped():
            before = len(asked)
            until(
                lambda: len(asked) >= before + 5,
                "the flight's answer to another browser",
                meanwhile=lambda: answers.append(get(display, "/state")[0]),
                pause_s=0.05,
            )
            assert set(answers) == {200}
        page.page.evaluate("document.querySelectorAll('svg g.track').forEach(track => track.remove())")
        page.page.wait_for_selector("svg g.track")  # awake again, it goes on
        assert page.errors == []
