"""The status socket: any client may come, hang or die, and the loop notices nothing of it."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import stat
import threading

import msgspec
import pytest
from rich.console import Console

from companion.commands import status
from companion.commands.status import ask, find_socket, render
from companion.errors import ConfigError
from companion.runtime.status.status_socket import Status, StatusServer, TrackStatus, folders
from tests.support.place import HOME

LONG_S = 60.0
STATUS = Status(
    aircraft="OWN", software="0", dry_run=False, up_s=12.0, utc_s=1_767_225_600.0, state="avoiding",
    waits_for=None, unfit=None, vehicle="px4, system 1", mode="external", armed=True, landed="in air",
    heartbeat_age_s=0.4, position_age_s=0.05, lat_deg=HOME.lat_deg, lon_deg=HOME.lon_deg, alt_msl_m=450.0,
    velocity_ned_mps=(3.0, 0.0, 0.0), gnss_fix_type=3, sigma_m=1.0, link="udpin:127.0.0.1:14540",
    link_up=True, link_losses=0, link_dropped=0, link_errors=0, radio="connected", radio_ok=True,
    rates={"wifi": 2}, remote_id_trouble=None, frames_sent=24, frames_heard=300, bad_frames=0,
    broadcasts_refused=0, path_late_s=0.0, track_count=1,
    tracks=(
        TrackStatus(
            track_id="UAS1", transport="wifi", distance_m=81.0, above_m=-4.0, speed_mps=5.0, age_s=0.7,
            alert="caution", conflict=True, doubts=("clock",),
        ),
    ),
    ticks=240, late_ticks=1, worst_tick_ms=61.0, folder="runs/x", recorder_error=None, records_dropped=0,
    said=("standby -> guarding",),
)  # fmt: skip
HUGE = msgspec.structs.replace(STATUS, said=tuple("x" * 1000 for _ in range(4000)))
"""More than any socket takes at once."""


@pytest.fixture
def server(tmp_path):
    made = StatusServer("companion-OWN", {"RUNTIME_DIRECTORY": str(tmp_path)})
    yield made
    made.close()


def connect(server):
    client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    client.settimeout(LONG_S)
    client.connect(str(server.path))
    return client


def serving(server, status=STATUS):
    """Serve in a thread until told to stop."""
    ended = threading.Event()

    def serve():
        while not ended.wait(0.005):
            server.serve(lambda: status)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()

    def stop():
        ended.set()
        thread.join(LONG_S)
        assert not thread.is_alive()

    return stop


def test_whoever_asks_is_told(server):
    stop = serving(server)
    assert [ask(server.path) for _ in range(3)] == [STATUS] * 3
    stop()


def test_a_name_that_is_no_text_does_not_end_the_status(server):
    """Names of files are bytes. An exception here would end the status for the rest of the flight."""
    odd = os.fsdecode(b"/media/caf\xe9/runs")
    server_state = msgspec.structs.replace(STATUS, folder=odd, said=(f"recording to {odd}",))
    client = connect(server)
    server.serve(lambda: server_state)
    client.close()
    stop = serving(server, server_state)
    told = ask(server.path)
    stop()
    assert told == msgspec.structs.replace(
        STATUS, folder="/media/caf?/runs", said=("recording to /media/caf?/runs",)
    )


def test_clients_that_do_not_read_die_or_talk_hold_nothing_up(server):
    mute = [connect(server) for _ in range(10)]
    talker = connect(server)
    talker.send(b"GET / HTTP/1.1")
    connect(server).close()
    stop = serving(server, HUGE)
    with pytest.raises(ConfigError, match="not the status of this version"):
        ask(server.path)  # cut off, but answered
    stop()
    for client in (*mute, talker):
        client.close()
    stop = serving(server)
    assert ask(server.path) == STATUS
    stop()


def test_a_tick_builds_one_state_and_answers_a_few(server):
    clients = [connect(server) for _ in range(6)]
    built = []

    def state():
        built.append(1)
        return STATUS

    server.serve(state)
    assert len(built) == 1
    answered = 0
    for client in clients:
        client.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            answered += bool(client.recv(100))
        client.close()
    assert answered == 4


def test_without_a_client_no_state_is_built(server):
    server.serve(lambda: pytest.fail("nobody asked"))


def test_a_socket_that_may_not_be_removed_ends_nothing(server, monkeypatch):
    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(type(server.path), "unlink", refused)
        server.close()


def test_owner_and_group_may_ask(server):
    assert stat.S_IMODE(os.stat(server.path).st_mode) == 0o660


def test_what_a_killed_process_left_is_replaced(tmp_path):
    environ = {"RUNTIME_DIRECTORY": str(tmp_path)}
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as killed:
        killed.bind(str(tmp_path / "companion-OWN.sock"))
    server = StatusServer("companion-OWN", environ)
    stop = serving(server)
    assert ask(server.path) == STATUS
    with pytest.raises(ConfigError, match="another companion of this name"):
        StatusServer("companion-OWN", environ)
    stop()
    server.close()
    assert not server.path.exists()


def test_a_socket_that_nobody_serves_says_so(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "nothing.sock", tmp_path / "file", tmp_path):
        with pytest.raises(ConfigError, match=f"{path}: no companion answers there"):
            ask(path)


def test_a_companion_that_hangs_is_told_however_often_it_is_asked(tmp_path, monkeypatch):
    """Nobody takes the clients from the queue, which fills up as the display keeps asking."""
    monkeypatch.setattr(status, "_PATIENCE_S", 0.01)
    path = tmp_path / "A.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stopped:
        stopped.bind(str(path))
        stopped.listen(2)
        for _ in range(6):
            with pytest.raises(ConfigError, match=r"no answer.*: the companion hangs"):
                ask(path)


def test_what_is_no_socket_stays(tmp_path, monkeypatch):
    monkeypatch.setattr("companion.runtime.status.status_socket.folders", lambda _environ: [tmp_path])
    (tmp_path / "companion-OWN.sock").write_text("mine")
    with pytest.raises(ConfigError, match="the status socket cannot be created"):
        StatusServer("companion-OWN", {})
    assert (tmp_path / "companion-OWN.sock").read_text() == "mine"


def test_the_first_folder_that_can_be_used_is(tmp_path):
    environ = {"RUNTIME_DIRECTORY": "/dev/null/x", "XDG_RUNTIME_DIR": str(tmp_path)}
    server = StatusServer("a", environ)
    assert server.path == tmp_path / "dmuca" / "a.sock"
    server.close()
    assert [str(path) for path in folders({})] == ["/run/dmuca"]
    # As the service has it. A folder named twice would make one companion look like two.
    assert [str(path) for path in folders({"RUNTIME_DIRECTORY": "/run/dmuca"})] == ["/run/dmuca"]


def test_one_companion_is_found_and_of_several_one_must_be_named(tmp_path, monkeypatch):
    monkeypatch.setattr("companion.commands.status.folders", lambda _environ: [tmp_path])
    (tmp_path / "dead.sock").touch()
    with pytest.raises(ConfigError, match="no companion runs on this computer"):
        find_socket(None, {})
    environ = {"RUNTIME_DIRECTORY": str(tmp_path)}
    first = StatusServer("one", environ)
    assert find_socket(None, {}) == first.path
    second = StatusServer("two", environ)
    with pytest.raises(ConfigError, match=r"choose one with --socket .*one.sock or .*two.sock"):
        find_socket(None, {})
    assert find_socket(second.path, {}) == second.path
    first.close()
    second.close()


def test_what_a_terminal_shows():
    odd = msgspec.structs.replace(STATUS.tracks[0], track_id="[bold]\x1b]0;evil\x07")
    console = Console(width=150, record=True, file=io.StringIO())
    console.print(render(msgspec.structs.replace(STATUS, tracks=(odd,), track_count=60)))
    shown = console.export_text()
    for words in (
        "avoiding", "px4, system 1", "heartbeat 0.40 s, position 0.05 s", "81 m", "-4 m", "caution, conflict",
        "on the air: wifi 2/s", "240 ticks, 1 missed", "2026-01-01 00:00:00 UTC",
        "59 more distant ones not shown", "[bold]?]0;evil?",
    ):  # fmt: skip
        assert words in shown, words


def test_a_rate_that_the_region_raises_is_shown_as_it_is_sent():
    console = Console(width=150, record=True, file=io.StringIO())
    console.print(render(msgspec.structs.replace(STATUS, sent_per_s={"wifi": 6.67})))
    assert "on the air: wifi 2/s chosen, 6.67/s sent; frames sent" in console.export_text()


def test_what_goes_wrong_with_the_disk_is_shown_once_each():
    status = msgspec.structs.replace(
        STATUS,
        recorder_error="No space left on device",
        records_dropped=7,
        troubles=("not recording: No space left on device", "settings not saved: /x: Read-only file system"),
    )
    console = Console(width=150, record=True, file=io.StringIO())
    console.print(render(status))
    shown = console.export_text()
    assert "NONE until the companion is restarted: No space left on device; 7 records are missing" in shown
    assert shown.count("No space left") == 1
    assert "settings not saved: /x: Read-only file system" in shown


def test_a_narrow_terminal_cuts_nothing_of_a_track():
    warned = msgspec.structs.replace(
        STATUS.tracks[0], track_id="1596B0000DMUCA000001", distance_m=1234.0, speed_mps=12.0, alert="warning"
    )
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(render(msgspec.structs.replace(STATUS, tracks=(warned,))))
    shown = console.export_text()
    assert "\u2026" not in shown
    for words in ("distance", "1234 m", "12.0 m/s", "warning", "conflict", "clock"):
        assert words in shown, words
