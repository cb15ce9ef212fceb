"""The client of hostapd against a scripted one: answers, refusals, silence, death and return."""

import contextlib
import os
import select
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError
from companion.radio.wifi import hostapd as module
from companion.radio.wifi.hostapd import ApStatus, HostapdControl, parse_status

STATUS = (
    "state=ENABLED\nfreq=2437\nchannel=6\nbeacon_int=100\n"
    "bss[0]=wlan0\nbssid[0]=02:00:00:AA:BB:CC\nssid[0]=RID\n"
)
ELEMENT = bytes.fromhex("dd05fa0bbc0d01")
SET = f"SET vendor_elements {ELEMENT.hex()}"
CLEAR = "SET vendor_elements "


class FakeHostapd:
    """Answers what `answers` says, OK to the rest; answers nothing for None."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "wlan0"
        self.answers: dict[str, str | None] = {"PING": "PONG\n", "STATUS": STATUS}
        self._waiting, self._wake = socket.socketpair()
        self.start()

    def start(self) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(self.path))
        self.socket.setblocking(False)

    def stop(self) -> None:
        self.socket.close()
        self.path.unlink(missing_ok=True)

    def close(self) -> None:
        self.stop()
        self._waiting.close()
        self._wake.close()

    def serve(self) -> list[str]:
        """Take and answer what waits; what was said."""
        heard = []
        while True:
            try:
                heard.append(self._answer_one())
            except BlockingIOError:
                return heard

    def serve_patiently(self, commands: int) -> None:
        """Answer so many commands, waiting for them."""
        for _ in range(commands):
            readable, _, _ = select.select([self.socket, self._waiting], [], [], 10.0)
            if self.socket not in readable:
                return
            self._answer_one()

    def stop_waiting(self) -> None:
        self._wake.send(b"x")

    def _answer_one(self) -> str:
        data, client = self.socket.recvfrom(4096)
        command = data.decode()
        answer = self.answers.get(command.split(" ")[0], "OK\n")
        if answer is not None:
            with contextlib.suppress(FileNotFoundError):  # the client is gone: hostapd does not mind
                self.socket.sendto(answer.encode(), client)
        return command


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeHostapd]:
    fake = FakeHostapd(tmp_path)
    yield fake
    fake.close()


@pytest.fixture
def control(fake: FakeHostapd) -> Iterator[HostapdControl]:
    control = open_control(fake)
    yield control
    control.close()


def open_control(fake: FakeHostapd) -> HostapdControl:
    """The constructor waits for its two answers, which are given beside it."""
    beside = threading.Thread(target=fake.serve_patiently, args=(2,))
    beside.start()
    try:
        return HostapdControl(str(fake.path))
    finally:
        fake.stop_waiting()
        beside.join()


def step(control: HostapdControl, fake: FakeHostapd, now_s: float) -> list[str]:
    """One round of the loop: what hostapd was told, and its answers taken."""
    control.poll(now_s)
    said = fake.serve()
    control.poll(now_s)
    return said


def test_what_it_says_of_itself(control: HostapdControl) -> None:
    assert control.status == ApStatus("ENABLED", "02:00:00:aa:bb:cc", 6, 100)
    assert control.trouble is None


def test_an_element_is_set_and_the_beacon_updated(control: HostapdControl, fake: FakeHostapd) -> None:
    control.set_element(ELEMENT, 0.0)
    assert control.updates == 0
    assert step(control, fake, 0.0) == [SET, "UPDATE_BEACON", "STATUS"]
    assert (control.updates, control.failures, control.trouble) == (1, 0, None)


def test_close_takes_the_element_off_and_leaves_no_file(fake: FakeHostapd) -> None:
    control = open_control(fake)
    folder = control._folder
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    control.set_element(ELEMENT, 0.0)
    control.close()
    assert fake_heard_last(fake) == [SET, "UPDATE_BEACON", CLEAR, "UPDATE_BEACON"]
    assert not folder.exists()


def fake_heard_last(fake: FakeHostapd) -> list[str]:
    fake.answers = {"SET": None, "UPDATE_BEACON": None}
    return fake.serve()


def test_close_leaves_a_beacon_alone_that_was_never_touched(fake: FakeHostapd) -> None:
    control = open_control(fake)
    step(control, fake, 0.0)
    control.close()
    assert fake.serve() == []


def test_an_element_that_is_not_renewed_goes_off_the_air(control: HostapdControl, fake: FakeHostapd) -> None:
    control.set_element(ELEMENT, 0.0)
    said = [(now, line) for now in (0.0, 0.5, 1.5, 1.6, 5.0) for line in step(control, fake, now)]
    assert [(now, line) for now, line in said if line != "STATUS"] == [
        (0.0, SET),
        (0.0, "UPDATE_BEACON"),
        (1.6, CLEAR),
        (1.6, "UPDATE_BEACON"),
    ]
    control.set_element(ELEMENT, 7.0)
    assert step(control, fake, 7.0)[:2] == [SET, "UPDATE_BEACON"]


@pytest.mark.parametrize("command", ["SET", "UPDATE_BEACON"])
def test_a_refusal_is_told_and_tried_again_without_content(
    control: HostapdControl, fake: FakeHostapd, command: str
) -> None:
    fake.answers[command] = "FAIL\n"
    control.set_element(ELEMENT, 0.0)
    step(control, fake, 0.0)
    assert control.trouble is not None
    assert f"'FAIL' to {command}" in control.trouble
    assert control.updates == 0
    assert control.failures == 1
    assert step(control, fake, 1.0) == ["STATUS", CLEAR, "UPDATE_BEACON"]
    assert control.trouble is not None
    del fake.answers[command]
    assert step(control, fake, 2.0) == ["STATUS", CLEAR, "UPDATE_BEACON"]
    assert control.trouble is None


def test_it_dies_and_returns(control: HostapdControl, fake: FakeHostapd) -> None:
    control.set_element(ELEMENT, 0.0)
    step(control, fake, 0.0)
    fake.stop()
    control.set_element(ELEMENT, 0.5)
    assert control.trouble is not None
    assert "check that hostapd runs" in control.trouble
    control.set_element(ELEMENT, 0.6)
    assert control.failures == 1
    fake.start()
    assert step(control, fake, 1.5) == ["STATUS"]
    # Alive, but what its beacon holds is not known: only a cleared one makes it able again.
    assert control.trouble is not None
    assert "being cleared" in control.trouble
    assert step(control, fake, 2.5) == ["STATUS", CLEAR, "UPDATE_BEACON"]
    assert control.trouble is None
    control.set_element(ELEMENT, 3.0)
    step(control, fake, 3.0)
    assert control.trouble is None


def test_a_left_over_socket_file_is_nobody(control: HostapdControl, fake: FakeHostapd) -> None:
    fake.socket.close()
    control.poll(0.0)
    assert control.trouble is not None
    assert "no program listens there" in control.trouble


def test_it_hangs_and_its_late_answers_are_not_taken_for_others(
    control: HostapdControl, fake: FakeHostapd
) -> None:
    control.set_element(ELEMENT, 0.0)
    control.poll(0.0)
    control.poll(2.0)
    assert control.trouble is None
    control.poll(2.1)
    assert control.trouble is not None
    assert "no answer to SET vendor_elements for 2 s" in control.trouble
    fake.answers |= {"SET": "FAIL\n", "STATUS": "FAIL\n"}
    assert fake.serve() == [SET, "UPDATE_BEACON", "STATUS", CLEAR, "UPDATE_BEACON", "STATUS"]
    del fake.answers["SET"]
    fake.answers["STATUS"] = STATUS
    step(control, fake, 3.2)
    assert control.trouble is not None
    assert "being cleared" in control.trouble
    assert step(control, fake, 4.3) == ["STATUS", CLEAR, "UPDATE_BEACON"]
    assert control.trouble is None


def test_it_takes_no_more_commands(control: HostapdControl, fake: FakeHostapd) -> None:
    for _ in range(10_000):
        control.set_element(ELEMENT, 0.0)
        if control.trouble:
            break
    assert control.trouble == "hostapd: accepts no commands because it hangs"


def test_an_access_point_that_sends_nothing_is_trouble(control: HostapdControl, fake: FakeHostapd) -> None:
    fake.answers["STATUS"] = STATUS.replace("ENABLED", "DFS")
    step(control, fake, 0.0)
    assert control.trouble == "hostapd sends no beacons: its state is DFS"
    fake.answers["STATUS"] = STATUS.replace("channel=6", "channel=11")
    step(control, fake, 1.0)
    assert control.trouble is None
    assert control.status.channel == 11


def test_events_and_answers_that_nobody_waits_for_are_passed_over(
    control: HostapdControl, fake: FakeHostapd
) -> None:
    step(control, fake, 0.0)
    for junk in (b"<3>AP-STA-CONNECTED 02:00:00:00:00:01", b"", b"FAIL\n", b"\xff\xfe", b"x" * 9000):
        fake.socket.sendto(junk, str(control._folder / "1"))
    control.poll(0.1)
    assert control.trouble is None


def test_an_element_too_long_is_refused(control: HostapdControl) -> None:
    control.set_element(bytes(257), 0.0)
    with pytest.raises(ValueError, match="258 bytes"):
        control.set_element(bytes(258), 0.0)


def test_nobody_there_is_said_in_words(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"radio\.hostapd: .*no such socket; check that hostapd runs"):
        HostapdControl(str(tmp_path / "wlan0"))
    with pytest.raises(ConfigError, match="give the socket of the interface"):
        HostapdControl(str(tmp_path))
    with pytest.raises(ConfigError, match="too long"):
        HostapdControl("/x" * 100)
    with pytest.raises(ConfigError, match="no such socket"):
        HostapdControl("a\0b")


def test_somebody_else_there_is_said_in_words(fake: FakeHostapd) -> None:
    fake.answers["PING"] = "UNKNOWN COMMAND\n"
    with pytest.raises(ConfigError, match=r"'UNKNOWN COMMAND.*check that it is hostapd's"):
        open_control(fake)


def test_one_that_hangs_at_the_start_is_said_in_words(
    fake: FakeHostapd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_OPEN_TIMEOUT_S", 0.05)
    with pytest.raises(ConfigError, match=r"no answer for 0\.05 s"):
        HostapdControl(str(fake.path))


def test_no_permission_is_said_in_words(fake: FakeHostapd) -> None:
    fake.path.chmod(0)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)  # root may write to every socket
    try:
        with pytest.raises(ConfigError, match="ctrl_interface_group"):
            HostapdControl(str(fake.path))
    finally:
        os.seteuid(user)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ApStatus("unknown")),
        ("FAIL\n", ApStatus("unknown")),
        # driver=none
        (
            "state=ENABLED\nchannel=0\nbss[0]=wlan1\nbssid[0]=00:00:00:00:00:00\n",
            ApStatus("ENABLED", None, None, None),
        ),
        # two access points on one card
        (
            "state=ENABLED\nchannel=36\nbss[0]=wlan0\nbssid[0]=02:00:00:00:00:01\n"
            "bss[1]=wlan1\nbssid[1]=02:00:00:00:00:02\n",
            ApStatus("ENABLED", "02:00:00:00:00:02", 36, None),
        ),
        (f"state=ENABLED\nchannel={'9' * 5000}\nbeacon_int=-1\nbssid[0]=x\n", ApStatus("ENABLED")),
    ],
)
def test_status_is_read_as_far_as_it_goes(text: str, expected: ApStatus) -> None:
    assert parse_status(text, "wlan1") == expected


@given(st.text(max_size=200))
def test_any_status_is_read(text: str) -> None:
    assert isinstance(parse_status(text, "wlan0"), ApStatus)
