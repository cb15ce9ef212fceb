"""How often downloads are asked for, and how long what they brought counts."""

from __future__ import annotations

import msgspec
import pytest

from companion.authority.downloads import Downloads
from companion.authority.terms import Terms
from companion.config import LimitsConfig
from companion.errors import ConfigError
from companion.events import (
    DownloadFence,
    DownloadMission,
    FenceArea,
    FenceDownloaded,
    MissionDownloaded,
    Say,
)
from tests.companion.conftest import config, mission

AREA = FenceArea(inclusion=True, points=((47.0, 8.0), (48.0, 8.0), (48.0, 9.0)))


def downloads(**limits):
    return Downloads(Terms(msgspec.structs.replace(config(), limits=LimitsConfig(**limits))))


def test_the_first_attempt_is_made_at_once_and_the_next_after_ten_seconds():
    made = downloads()
    tries = [now_s for now_s in (100.0, 100.1, 109.9, 110.1, 120.0, 120.2) if made.may_try(now_s)]
    assert tries == [100.0, 110.1, 120.2]


def test_a_request_is_repeated_only_once_it_can_no_longer_be_answered():
    """The link would begin the download anew."""
    made = downloads()
    assert made.ask_mission(100.0) == [DownloadMission()]
    assert made.ask_mission(174.9) == []
    assert made.ask_mission(175.1) == [DownloadMission()]


@pytest.mark.parametrize("answered", ["mission", "fence", "refused"])
def test_an_answer_lets_the_next_request_go_out(answered):
    made = downloads(fence="vehicle")
    made.ask_mission(100.0)
    if answered == "mission":
        made.mission_downloaded(MissionDownloaded(items=mission(300.0)), 101.0)
    elif answered == "fence":
        made.fence_downloaded(FenceDownloaded(areas=(AREA,)), 101.0)
    else:
        (said,) = made.refused("no answer after 5 tries")
        assert isinstance(said, Say)
        assert said.text == "DMUCA: path refused: no answer after 5 tries"
    assert made.ask_mission(101.0) == [DownloadMission()]


@pytest.mark.parametrize(("answered", "at_once"), [(True, True), (False, False)])
def test_after_an_answer_there_is_no_pause_after_a_refusal_there_is(answered, at_once):
    made = downloads()
    assert made.may_try(100.0)
    if answered:
        made.mission_downloaded(MissionDownloaded(items=mission(300.0)), 101.0)
    else:
        made.refused("no answer after 5 tries")
    assert made.may_try(101.0) is at_once


def test_a_mission_is_fresh_for_a_second():
    """The vehicle flies on, and its mission may be changed."""
    made = downloads()
    assert not made.mission_is_fresh(0.0)
    made.mission_downloaded(MissionDownloaded(items=mission(300.0)), 100.0)
    assert made.mission_is_fresh(100.9)
    assert not made.mission_is_fresh(101.1)
    assert made.items == mission(300.0)


@pytest.mark.parametrize("end", [Downloads.forget, Downloads.outdate_mission])
def test_a_mission_that_is_forgotten_or_outdated_is_not_fresh_and_is_tried_at_once(end):
    made = downloads()
    made.mission_downloaded(MissionDownloaded(items=mission(300.0)), 100.0)
    assert made.may_try(100.0)
    end(made)
    assert not made.mission_is_fresh(100.0)
    assert made.may_try(100.0)
    assert bool(made.items) is (end is Downloads.outdate_mission)


def test_a_vehicle_without_a_fence_is_told_of_once_where_one_is_expected():
    made = downloads(fence="vehicle")
    (said,) = made.fence_downloaded(FenceDownloaded(areas=()), 10.0)
    assert "no fence is kept" in said.text
    assert made.fence_downloaded(FenceDownloaded(areas=()), 110.0) == []
    assert made.fence_downloaded(FenceDownloaded(areas=(AREA,)), 210.0) == []


def test_the_vehicles_fence_is_asked_for_until_it_is_90_seconds_old():
    made = downloads(fence="vehicle")
    assert made.ask_fence(0.0) == [DownloadFence()]
    made.fence_downloaded(FenceDownloaded(areas=(AREA,)), 10.0)
    assert made.areas() == (AREA,)
    assert made.ask_fence(99.9) is None
    assert made.ask_fence(100.1) == [DownloadFence()]
    made.forget()
    made.hurry()
    assert made.ask_fence(100.2) == [DownloadFence()]


@pytest.mark.parametrize("fence", [None, "fence.toml"])
def test_a_fence_that_is_not_the_vehicles_is_not_asked_for(fence):
    assert downloads(fence=fence).ask_fence(0.0) is None


def test_a_fence_that_makes_no_sense_is_refused():
    made = downloads(fence="vehicle")
    made.fence_downloaded(FenceDownloaded(areas=(AREA, FenceArea(inclusion=True, points=()))), 10.0)
    with pytest.raises(ConfigError, match=r"area\[1\]"):
        made.areas()
