"""The flight loop goes on through whatever happens beside it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import socket
import threading
import time

import msgspec
import numpy as np
import pytest

from companion.autopilot.signing import Signing, timestamp_at
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.commands import status
from companion.config import NullRadio, RecordConfig, VehicleConfig
from companion.errors import ConfigError
from companion.events import Firmware, RadioState, RemoteIdHeard
from companion.radio.null import NullTransport
from companion.radio.radio import Health
from companion.remote_id.messages import Location, Status
from companion.remote_id.region import Region
from companion.runtime import clock, radios
from companion.runtime.flight import Flight
from companion.runtime.links.byte_link import LinkTrouble, Received
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions

LONG_S = 60.0


class Autopilot:
    """The autopilot's side of a TCP link: sends heartbeats to whoever connects."""

    def __init__(self, port=0, wrap=bytes):
        self._wrap = wrap
        self._server = socket.socket()
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(("127.0.0.1", port))
        self._server.listen()
        self._server.settimeout(0.05)
        self.port = self._server.getsockname()[1]
        self.commands = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        with self._server:
            while not self._ended.is_set():
                try:
                    peer = self._server.accept()[0]
                except TimeoutError:
                    continue
                with peer, contextlib.suppress(ConnectionError):
                    self._speak(peer)

    def _speak(self, peer):
        writer, reader = MavlinkWriter(1, 1), MavlinkReader()
        peer.setblocking(False)
        while not self._ended.wait(0.02):
            peer.sendall(self._wrap(writer.pack(writer.encoder.heartbeat_encode(2, 3, 1, 5, 4))))
            try:
                data = peer.recv(65536)
            except BlockingIOError:
                continue
            self.commands += [m for m in reader.feed(data) if m.get_type() == "COMMAND_LONG"]

    def end(self):
        """Drop the connection and the port."""
        self._ended.set()
        self._thread.join(LONG_S)


class Radio(NullTransport):
    """Keeps when it was asked to broadcast; refuses if told to."""

    def __init__(self):
        self.broadcasts = 0
        self.refusals = []
        self.closed = False
        self._states = [RadioState(can_send=("wifi",))]

    def events(self, now_s):
        states, self._states = self._states, []
        return states

    def broadcast(self, transport, messages, now_s):
        self.broadcasts += 1
        if self.refusals:
            raise ValueError(self.refusals[self.broadcasts % len(self.refusals)])

    def close(self):
        self.closed = True


@pytest.fixture
def autopilot():
    served = Autopilot()
    yield served
    served.end()


@pytest.fixture
def said():
    return []


@pytest.fixture
def kept_signals():
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def watchdog(monkeypatch):
    """What is done with the watchdog; the real one would end the tests on a slow machine."""
    calls = []

    class Recorded:
        def start(self):
            calls.append("start")

        def report(self):
            calls.append("report")

        def stop(self):
            calls.append("stop")

    monkeypatch.setattr("companion.runtime.flight.Watchdog", Recorded)
    return calls


@pytest.fixture
def flight(autopilot, said, make_config, tmp_path, kept_signals, watchdog, monkeypatch):
    """A flight that watches, not yet running."""
    monkeypatch.setattr("companion.runtime.links.kept_link._PAUSE_S", 0.01)
    monkeypatch.setattr("companion.runtime.flight._STATUS_S", 0.1)
    made = Flight(configured(make_config, tmp_path, autopilot.port), said.append, dry_run=False)
    made.radio = Radio()
    return made


def configured(make_config, tmp_path, port):
    return msgspec.structs.replace(
        make_config(use="watch"),
        vehicle=VehicleConfig(link=f"tcp:127.0.0.1:{port}", wait_s=LONG_S),
        record=RecordConfig(folder=str(tmp_path)),
    )


def fly(flight, *script):
    """Run the flight while a thread does `script` in turn, then stops it; what failed there fails here."""
    failed = []

    def act():
        try:
            for part in script:
                part()
        except AssertionError as error:
            failed.append(error)
        finally:
            flight.stop()

    thread = threading.Thread(target=act, daemon=True)
    thread.start()
    flight.run()
    thread.join(LONG_S)
    if failed:
        raise failed[0]


def summary(flight):
    return json.loads((flight.folder / "summary.json").read_text())


def heard_of(said, text, after=0):
    """A condition for `until`: a line with `text` was said."""
    return lambda: any(text in line for line in said[after:])


def test_a_lost_link_comes_back_and_remote_id_goes_on_meanwhile(flight, autopilot, said, until):
    again = []

    def broadcasts_without_link():
        sent = flight.radio.broadcasts
        until(lambda: flight.radio.broadcasts >= sent + 2)
        assert not flight.link.up

    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        autopilot.end,
        lambda: until(heard_of(said, "lost:")),
        broadcasts_without_link,
        lambda: until(heard_of(said, "link down")),
        lambda: again.append(Autopilot(autopilot.port)),
        lambda: until(lambda: flight.link.up and again[0].commands),
    )
    again[0].end()
    assert sum("lost:" in line for line in said) == 1
    assert sum(line.endswith(": back") for line in said) == 1
    found = summary(flight)
    assert found["link_losses"] == 1
    assert found["link_sends_dropped"] > 0
    assert found["recorder_error"] is None


def test_a_refused_broadcast_is_counted_and_said_once(flight, said, until):
    flight.radio.refusals = ["too high", "too fast"]
    fly(flight, lambda: until(lambda: flight.radio.broadcasts >= 4 and heard_of(said, "recording to")()))
    found = summary(flight)
    assert found["broadcasts_refused"] >= 4
    assert found["broadcast_errors"] == ["too fast", "too high"]
    assert sum("too high" in line for line in said) == 1
    assert sum("too fast" in line for line in said) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_a_flight_in_order(flight, said, until, number):
    signal.signal(number, lambda *_: None)
    released = threading.Event()

    def ended():
        os.kill(os.getpid(), number)
        until(lambda: flight._stop)
        released.set()

    fly(flight, lambda: until(heard_of(said, "recording to")), ended)
    assert released.is_set()
    assert summary(flight)["ticks"] > 0


def test_under_nohup_a_closed_terminal_ends_nothing(flight, said, until):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def hang_up():
        os.kill(os.getpid(), signal.SIGHUP)
        ticks = flight._ticks
        until(lambda: flight._ticks > ticks + 3)
        assert not flight._stop

    fly(flight, lambda: until(heard_of(said, "recording to")), hang_up)


@pytest.mark.parametrize(("held_up_s", "leaves"), [(0.2, True), (0.3, False)])
def test_what_a_tick_decided_leaves_in_time_or_not_at_all(flight, monkeypatch, held_up_s, leaves):
    """The gate is asked as the bytes leave, not as they were decided."""
    now, asked = [1000.0], []
    monkeypatch.setattr(clock, "now_s", lambda: now[0])
    monkeypatch.setattr(flight.link, "receive", lambda _: Received())

    def held_up(now_s, **_):
        flight.onboard.gate.decided(now_s)
        now[0] += held_up_s
        return []

    monkeypatch.setattr(flight.onboard, "tick", held_up)
    monkeypatch.setattr(flight.onboard, "drain", lambda now_s: asked.append(now_s) or b"")
    flight._tick()
    assert asked == [1000.0 + held_up_s]
    assert flight.onboard.gate.in_time(asked[0]) is leaves
    flight._close()


def test_a_broken_pipe_does_not_end_a_flight(autopilot, make_config, tmp_path, kept_signals, watchdog, until):
    def broken(_line):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    made = Flight(configured(make_config, tmp_path, autopilot.port), broken, dry_run=False)

    def flown():
        ticks = made._ticks
        until(lambda: made.folder is not None and made._ticks > ticks + 5)

    fly(made, flown)
    assert summary(made)["lines_dropped"] >= 3


class Control:
    """What a flight asks of the heart before it lets go."""

    def __init__(self, heart, in_control):
        self._heart = heart
        self.in_control = in_control

    def __getattr__(self, name):
        return getattr(self._heart, name)


@pytest.mark.parametrize("in_control", [True, False])
def test_lets_go_of_what_it_controls_and_of_nothing_else(
    flight, autopilot, said, until, watchdog, monkeypatch, in_control
):
    monkeypatch.setattr("companion.runtime.flight._LET_GO_S", 0.3)
    asked = []
    monkeypatch.setattr(flight.onboard, "let_go", lambda _now_s: asked.append(list(watchdog)))
    flight.onboard.heart = Control(flight.onboard.heart, in_control)
    fly(flight, lambda: until(heard_of(said, "recording to")), lambda: until(lambda: watchdog))
    assert heard_of(said, "asking the vehicle to hold")() is in_control
    # Letting go may last; the watchdog must not end it.
    assert [calls[-1] for calls in asked] == (["stop"] if in_control else [])
    assert watchdog[0] == "start"
    assert "report" in watchdog


class FullDisk:
    """A recorder as it is when the disk is full."""

    error = "No space left on device"
    dropped = 7
    deleted = ()
    recording = True
    answers = True

    def __init__(self, folder):
        self.folder = folder

    def close(self, timeout_s):
        return self.answers


@pytest.mark.parametrize("answers", [True, False])
def test_a_full_disk_is_said_and_the_radio_and_the_link_are_closed(
    flight, said, until, monkeypatch, tmp_path, answers
):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("companion.runtime.record.run_record.write_json", full)

    def fill():
        flight.onboard.tlog = None
        disk = FullDisk(flight.folder)
        disk.answers = answers
        disk.step = lambda _step: None
        flight._run._recorder = disk

    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        fill,
        lambda: until(heard_of(said, "not recording: No space left")),
    )
    assert flight.radio.closed
    assert not flight.link.up
    assert heard_of(said, "summary.json: cannot be written")() is answers


def test_a_link_that_cannot_be_opened_lets_out_what_was_said(make_config, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lines = []

    def slow(line):
        time.sleep(0.05)
        lines.append(line)

    with pytest.raises(ConfigError):
        Flight(configured(make_config, tmp_path, port), slow, dry_run=False)
    assert len(lines) == 2


US = Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5")), location_period_s=1.0)


class Sender(Radio):
    """A radio that sends on some transports."""

    wifi_channel = 6

    def __init__(self, *capabilities):
        super().__init__()
        self.able, self.configured = frozenset(capabilities), None

    @property
    def capabilities(self):
        return self.able

    def configure(self, rates):
        self.configured = rates
        return ["radio: set"]


@pytest.fixture
def arm(monkeypatch, make_config, said, tmp_path, autopilot):
    """Make a flight whose radios can send on these transports, and end it."""

    def build(use, *capabilities):
        radio = Sender(*capabilities)
        monkeypatch.setattr("companion.runtime.flight.Radios", lambda *_, **__: radio)
        config = configured(make_config, tmp_path, autopilot.port)
        config = msgspec.structs.replace(
            config, region=US, flight=msgspec.structs.replace(config.flight, use=use)
        )
        flight = Flight(config, said.append, dry_run=False)
        flight._close()
        return radio

    return build


def test_a_radio_that_cannot_be_legal_does_not_fly(arm):
    with pytest.raises(ConfigError, match=r"remote_id: region us asks for .*; the radio can send on ble4"):
        arm("fly", "ble4")
    arm("fly", "wifi")


def test_one_that_only_watches_goes_on_without_broadcasting(arm, said):
    radio = arm("watch", "ble4")
    assert radio.configured is None
    assert any("nothing is broadcast" in line for line in said)


def test_radios_that_only_listen_leave_the_broadcast_to_the_vehicle(arm, said):
    radio = arm("fly")
    assert radio.configured is None
    assert any("Remote ID module of its own" in line for line in said)


def test_what_the_law_adds_is_configured_and_said(arm, said):
    radio = arm("fly", "ble4", "ble5")
    assert radio.configured == {"ble4": 2, "ble5": 2}
    assert "remote ID: ble4 1/s, ble5 1/s (radio cannot send on wifi; region us asks for ble4, ble5)" in said
    assert "radio: set" in said


# ---------------------------------------------------------------- a signed link

KEY = bytes.fromhex("d4ee003d187614d9ffa24d20f58b448551c2cdc1e54cf42fc00bb86182249126")


@pytest.fixture
def signed(make_config, tmp_path, said, kept_signals, watchdog, monkeypatch):
    """A flight with a key, to a port; and the folder of its runs."""
    monkeypatch.setattr("companion.runtime.flight._STATUS_S", 0.1)
    key_file = tmp_path / "signing.key"
    key_file.write_text(KEY.hex())
    key_file.chmod(0o600)

    def make(port, wait_s=LONG_S):
        config = configured(make_config, tmp_path / "runs", port)
        vehicle = VehicleConfig(link=config.vehicle.link, wait_s=wait_s, signing_key=str(key_file))
        made = Flight(msgspec.structs.replace(config, vehicle=vehicle), said.append, dry_run=False)
        made.radio = Radio()
        return made

    return make


def test_the_run_folder_and_the_log_hold_no_key(signed, said, until, tmp_path):
    vehicle = Signing(KEY, timestamp_at(time.time()), 0.0)
    forged = MavlinkWriter(1, 1)

    def wrap(frame):
        return vehicle.sign(frame) + forged.pack(forged.encoder.heartbeat_encode(2, 3, 1, 4, 4))

    served = Autopilot(wrap=wrap)
    flight = signed(served.port)
    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        lambda: until(heard_of(said, "frames refused: ")),
        lambda: until(lambda: served.commands),
    )
    served.end()
    found = summary(flight)["signing"]
    assert found["valid"] > 0
    assert found["unsigned"] > 0
    assert flight.onboard.heart.own.heartbeat.custom_mode == 5
    for path in (tmp_path / "runs").rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            assert KEY not in data, path
            assert KEY.hex().encode() not in data, path
    assert not any(KEY.hex() in line for line in said)
    assert (tmp_path / "runs" / "signing-timestamp").exists()


def test_a_vehicle_that_does_not_sign_is_told_in_plain_words(signed, autopilot):
    flight = signed(autopilot.port, wait_s=0.5)
    with pytest.raises(ConfigError, match="every frame of the vehicle is unsigned: signing is not set up"):
        flight.run()


@pytest.mark.parametrize("delete_oldest", [True, False])
def test_old_runs_make_room_for_a_new_one_where_they_may(
    flight, said, until, tmp_path, monkeypatch, delete_oldest
):
    old = tmp_path / "20260101T000000Z-companion"
    old.mkdir()
    (old / "manifest.json").write_text('{"what": "companion run"}')
    (old / "A.events").write_bytes(b"")
    monkeypatch.setattr(
        "companion.runtime.record.disk.free_mb", lambda _folder: 50.0 if old.exists() else 300.0
    )
    record = msgspec.structs.replace(flight.config.record, delete_oldest=delete_oldest)
    flight.config = msgspec.structs.replace(flight.config, record=record)
    recording = "recording to" if delete_oldest else "not recording: less than 200 MB are free"
    fly(flight, lambda: until(heard_of(said, recording)))
    assert old.exists() is not delete_oldest
    assert heard_of(said, f"deleted the oldest runs: {old.name}")() is delete_oldest
    assert (summary(flight)["recorder_error"] is None) is delete_oldest


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """What a service manager with a watchdog is told."""
    name = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    monkeypatch.setenv("WATCHDOG_USEC", "20000")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(name)
        server.setblocking(False)

        def told():
            lines = []
            with contextlib.suppress(BlockingIOError):
                while True:
                    lines.append(server.recv(4096).decode())
            return lines

        yield told


def test_the_service_manager_is_told_from_the_loop_alone(manager, flight, said, until):
    """A loop that hangs pings no more; one that goes on does again."""
    hang, hanging = threading.Event(), threading.Event()
    tick, told = flight.onboard.tick, []

    def stuck(now_s, **read):
        if hang.is_set():
            hanging.set()
            until(lambda: not hang.is_set())
        return tick(now_s, **read)

    flight.onboard.tick = stuck

    def hung():
        hang.set()
        until(hanging.is_set)
        told.extend(manager())
        time.sleep(0.3)
        assert "WATCHDOG=1" not in manager()
        hang.clear()
        until(lambda: "WATCHDOG=1" in manager())

    before = manager()
    fly(flight, lambda: until(heard_of(said, "recording to")), lambda: until(lambda: flight._ticks > 5), hung)
    assert before == [], "not ready before the vehicle is there"
    assert told.index("READY=1") < told.index("WATCHDOG=1")
    assert any(line.startswith("STATUS=standby, waiting for") for line in told)
    assert manager()[-1] == "STOPPING=1"


def test_a_flight_that_finds_no_vehicle_is_never_ready(manager, make_config, tmp_path, kept_signals):
    config = configured(make_config, tmp_path, 0)
    config = msgspec.structs.replace(config, vehicle=VehicleConfig(link="udpin:127.0.0.1:0", wait_s=0.2))
    flight = Flight(config, lambda _line: None, dry_run=False)
    with pytest.raises(ConfigError, match="no vehicle"):
        flight.run()
    assert manager() == []


def test_the_live_state_is_served_and_gone_with_the_flight(flight, said, until):
    states = []

    def asked():
        states.append(status.ask(flight._server.path))
        status.render(states[0])

    fly(flight, lambda: until(heard_of(said, "recording to")), asked)
    (state,) = states
    assert state.aircraft == "OWN"
    assert state.state == "standby"
    assert state.mode is not None
    assert state.vehicle.startswith("ardupilot, system 1")
    assert state.folder == str(flight.folder)
    assert state.heartbeat_age_s < LONG_S
    assert state.position_age_s is None
    assert any("recording to" in line for line in state.said)
    assert not flight._server.path.exists()


def test_a_bug_in_what_is_shown_does_not_end_the_flight(flight, said, until, monkeypatch):
    monkeypatch.setattr(flight, "live", lambda _now_s: 1 // 0)
    path = flight._server.path

    def asked():
        with pytest.raises(ConfigError):
            status.ask(path)
        ticks = flight._ticks
        until(lambda: flight._ticks > ticks + 3)

    fly(flight, lambda: until(heard_of(said, "recording to")), asked)
    assert sum("status: not served any more: ZeroDivisionError" in line for line in said) == 1
    assert summary(flight)["ticks"] > 0


def test_a_second_companion_of_the_name_flies_without_a_socket(
    flight, autopilot, make_config, tmp_path, said
):
    before = len(said)
    second = Flight(configured(make_config, tmp_path, autopilot.port), said.append, dry_run=False)
    second._close()
    assert heard_of(said, "another companion of this name", before)()
    assert flight._server.path.exists(), "the first one's"
    flight._close()


class Joined:
    """A link whose other end is a mock vehicle in this process; keeps every frame that left."""

    up = True

    def __init__(self, firmware):
        options = VehicleOptions(
            firmware=firmware,
            airborne=True,
            start_position_ned_m=(0.0, 0.0, -50.0),
            start_mode=VehicleMode.EXTERNAL if firmware is Firmware.ARDUPILOT else VehicleMode.HOLD,
            utc_at_zero_s=time.time() - clock.now_s(),
        )
        self.vehicle = MockVehicle(options, np.random.default_rng(1), clock.now_s())
        self.left = []
        self._reader = MavlinkReader()

    def wait(self, timeout_s):
        time.sleep(min(timeout_s, 0.01))

    def receive(self, now_s):
        self.vehicle.advance(now_s)
        return Received(self.vehicle.drain())

    def send(self, data):
        self.left += self._reader.feed(data)
        self.vehicle.receive(data, clock.now_s())

    def discard(self):
        """Nothing waits."""

    def close(self):
        """Nothing to release."""


class Air(NullTransport):
    """A radio that could send, and hears another aircraft where ours is."""

    capabilities = frozenset({"wifi"})

    def __init__(self, link):
        self._link = link
        self.sent, self.changed = 0, 0

    def configure(self, rates, *, probe=False):
        self.changed += not probe
        return ()

    def broadcast(self, transport, messages, now_s):
        self.sent += 1

    def heard(self, now_s):
        north, east, _down = self._link.vehicle.position_ned_m
        message = Location(
            status=Status.AIRBORNE,
            lat_deg=47.397 + (north + 20.0) / 111_194.9,
            lon_deg=8.545 + east / 75_370.0,
            alt_geodetic_m=None,
            direction_deg=180.0,
            speed_mps=3.0,
            vertical_speed_mps=0.0,
            horizontal_accuracy_m=3.0,
            timestamp_s=round(time.time() % 3600.0, 1),
        )
        return [RemoteIdHeard(transport="wifi", address="02:00:00:00:00:01", messages=(message,))]

    def health(self, now_s):
        return Health(
            ok=True, text="", frames_sent=0, frames_heard=0, bad_frames=0, can_send=self.capabilities
        )


ASKS = {"HEARTBEAT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_ACK"}
ASKS |= {"PARAM_REQUEST_READ", "TIMESYNC"}
"""What a dry run may send beside COMMAND_LONG with SET_MESSAGE_INTERVAL: to be told things, and no more."""


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("dry_run", [True, False])
def test_a_dry_run_computes_and_transmits_nothing(
    make_config, tmp_path, monkeypatch, said, until, kept_signals, watchdog, firmware, dry_run
):
    """Beside the same flight that is none: it sends what the dry run must not."""
    link = Joined(firmware)
    air = Air(link)
    monkeypatch.setattr("companion.runtime.flight.KeptLink", lambda *_: link)
    monkeypatch.setattr(link, "trouble", LinkTrouble(), raising=False)
    monkeypatch.setattr(radios, "open_radio", lambda *_: air)
    base = make_config(use="fly")
    config = msgspec.structs.replace(
        base,
        remote_id=msgspec.structs.replace(base.remote_id, component=True),
        radio=(NullRadio(),),
        record=RecordConfig(folder=str(tmp_path)),
    )
    made = Flight(config, said.append, dry_run=dry_run)
    mode = link.vehicle.custom_mode
    fly(made, lambda: until(heard_of(said, "guarding -> avoiding")), lambda: time.sleep(1.0))
    kinds = {message.get_type() for message in link.left}
    commands = {m.command for m in link.left if m.get_type() == "COMMAND_LONG"}
    if dry_run:
        assert kinds <= ASKS | {"COMMAND_LONG"}
        assert commands == {511, 512}
        assert link.vehicle.custom_mode == mode
        assert (air.sent, air.changed) == (0, 0)
        assert not made.live(clock.now_s()).rates
    else:
        assert kinds >= {"SET_POSITION_TARGET_LOCAL_NED", "STATUSTEXT", "COLLISION"}
        assert air.sent > 0
        assert air.changed > 0
    assert heard_of(said, "dry run: nothing goes on the air")() is dry_run
    assert made.onboard.heart.state.value == "avoiding"
    assert made.folder is not None
    assert any(path.stat().st_size > 1000 for path in made.folder.glob("*.events"))


@pytest.mark.parametrize(("took_s", "leaves"), [(0.01, True), (0.2, True), (0.3, False), (10.0, False)])
def test_what_was_let_leave_before_a_stall_does_not_leave_after_it(monkeypatch, took_s, leaves):
    """The process stops between the gate's word and the link."""

    class Stub:
        def __init__(self):
            self.now_s, self.sent, self.discarded, self.said = 100.0, [], 0, []

        def drain(self, _now_s):
            self.now_s += took_s
            return b"command"

        def discard(self):
            self.discarded += 1

    stub = Stub()
    monkeypatch.setattr(clock, "now_s", lambda: stub.now_s)
    flight = Flight.__new__(Flight)
    flight.onboard = flight.link = stub
    stub.send = stub.sent.append
    flight._say, flight._stalls, flight._read_s = stub.said.append, 0, 100.0
    flight._send()
    assert stub.sent == ([b"command"] if leaves else [])
    assert (flight._stalls, stub.discarded, len(stub.said)) == ((0, 0, 0) if leaves else (1, 1, 1))
