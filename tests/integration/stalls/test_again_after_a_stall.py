"""Which flights are flown again: those that a stall of the machine prevented, and no others."""

from __future__ import annotations

import pytest

from tests.integration import conftest
from tests.integration.conftest import StalledError, again_after_a_stall

FAULT = "guarding -> fault: the control loop is late: no command sent for 1 s\n"
STOPPED = "the program was stopped for 2.1 s; the data waiting to be sent was discarded\n"
OLD = "guarding -> fault: own position older than 1 s\n"


def flown_with(start, tmp_path, *happens):
    """Fly until nothing happens; the folders of the flights."""
    folders = []
    coming = [*happens, None]

    @again_after_a_stall
    def test(start, tmp_path):
        folders.append(tmp_path.name)
        happened = coming.pop(0)
        if happened is not None:
            raise happened

    test(start=start, tmp_path=tmp_path)
    return folders


def test_a_stalled_flight_is_flown_again_in_a_folder_of_its_own(start, tmp_path):
    assert flown_with(start, tmp_path) == ["0"]
    again = tmp_path / "again"
    again.mkdir()
    assert flown_with(start, again, StalledError(), StalledError()) == ["0", "1", "2"]


def test_what_is_no_stall_fails_at_once(start, tmp_path):
    with pytest.raises(AssertionError, match="exit code 1"):
        flown_with(start, tmp_path, AssertionError("exit code 1"))
    assert [folder.name for folder in tmp_path.iterdir() if folder.is_dir()] == ["0"]


def test_stalls_without_end_fail(start, tmp_path, monkeypatch):
    monkeypatch.setattr(conftest, "AGAIN_S", -1.0)
    with pytest.raises(StalledError):
        flown_with(start, tmp_path, StalledError())


def test_a_stalled_companion_that_ends_with_an_error_fails_at_once(start, tmp_path):
    companion = start("this.is.no.module")
    assert companion.process.wait(conftest.PATIENCE_S) == 1
    companion.must_not_stall = True
    with pytest.raises(AssertionError, match="No module named"):
        flown_with(start, tmp_path, StalledError())
    companion.log.write_text(FAULT)
    companion.check_stall()


def test_of_two_companions_that_stalled_both_are_ended(start, tmp_path):
    for companion in (start("this"), start("this")):
        assert companion.process.wait(conftest.PATIENCE_S) == 0
        companion.log.write_text(FAULT)
        companion.must_not_stall = True
    assert flown_with(start, tmp_path, StalledError()) == ["0", "1"]


@pytest.mark.parametrize(
    ("said", "stalled"),
    [(FAULT, True), (STOPPED + OLD, True), (STOPPED, False), (OLD, False), (OLD + STOPPED, False)],
)
def test_only_what_the_companion_reports_is_a_stall(start, said, stalled):
    companion, other = start("this"), start("this")
    assert companion.process.wait(conftest.PATIENCE_S) == 0
    assert other.process.wait(conftest.PATIENCE_S) == 0
    companion.log.write_text(said)
    other.check_stall()
    companion.must_not_stall = True
    for child in (companion, other):
        if stalled:
            with pytest.raises(StalledError):
                child.check_stall()
        else:
            child.check_stall()


@pytest.mark.parametrize("said", [OLD, "guarding -> yielded: mode changed to RTL, not by the companion\n"])
def test_a_stall_of_the_mock_vehicle_excuses_a_companion_that_gives_it_back(start, said):
    vehicle, companion = start("this"), start("this")
    for child in (vehicle, companion):
        assert child.process.wait(conftest.PATIENCE_S) == 0
    companion.must_not_stall = True
    companion.log.write_text(said)
    companion.check_stall()
    words = "the program was stopped for {} s; the vehicle flew on without its links\n"
    vehicle.log.write_text(words.format(0.3))
    companion.check_stall()
    vehicle.log.write_text(words.format(1.2))
    with pytest.raises(StalledError):
        companion.check_stall()
    companion.log.write_text("standby -> guarding: ready\n")
    companion.check_stall()
