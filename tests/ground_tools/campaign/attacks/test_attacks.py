"""The attackers, their transmitter and the evaluation: properties that do not depend on the companion."""

from __future__ import annotations

import json
import math

import msgspec
import numpy as np
import pytest
from rich.console import Console

from companion.errors import ConfigError
from companion.radio.frames_io import FrameReceiver, radio_address
from companion.remote_id.messages import BasicId, Location
from companion.remote_id.transports import WIFI_BEACON
from ground_tools import cli
from ground_tools.campaign.attacks import flight, kept, scene, search
from ground_tools.campaign.attacks.air import Air, path_loss_db
from ground_tools.campaign.attacks.attacker import FRAMES_PER_S, Aircraft, Budget, Sent, Silent, View
from ground_tools.campaign.attacks.flight import World, fly, judged
from ground_tools.campaign.attacks.kinds import KINDS, Attack, attack_at, draw_attack
from ground_tools.campaign.attacks.messages import HOME, geodetic, location, report
from ground_tools.campaign.attacks.outcome import Judge, least_distance
from ground_tools.campaign.attacks.scene import Cell
from ground_tools.common.workers import rounds_in_parallel
from sitl_mocks.encounters.lockstep import UTC_AT_START_S

MEETING_KINDS = [kind for kind in KINDS if kind not in scene.LEADING]
VIEW = View(
    own=Aircraft((0.0, 0.0, -60.0), (10.0, 0.0, 0.0)),
    honest=(Aircraft((300.0, 0.0, -60.0), (-10.0, 0.0, 0.0)),),
    names=("PEER0",),
    addresses=(radio_address("PEER0"),),
)


def sent_by(kind, view=VIEW, *, seconds=10.0, **values):
    """Everything that the attack of seed 1 sends while the aircraft do not move."""
    attack = draw_attack(kind, 1)
    drawn = scene.draw(Cell(kind=kind), 1)
    attacker = KINDS[kind].make({**attack.values, **values}, drawn, np.random.default_rng(1))
    found = []
    for tick in range(round(seconds / 0.05)):
        found += [(tick * 0.05, sent) for sent in attacker.send(tick * 0.05, view)]
    return found


def parts(sent):
    (name,) = [m for m in sent.messages if isinstance(m, BasicId)]
    (place,) = [m for m in sent.messages if isinstance(m, Location)]
    return name.uas_id, place, HOME.to_ned(place.lat_deg, place.lon_deg, place.alt_geodetic_m - 47.0)


# ------------------------------------------------------------ what an attacker sends


def test_a_crowd_flies_along_without_conflict():
    frames = sent_by(
        "crowd", begin_s=0.0, rate=100.0, fakes=200.0, closing_mps=-1.0, near_m=36.0, spread_m=8.0
    )
    assert len({sent.address for _, sent in frames}) == 200
    for _, sent in frames:
        _, said, place = parts(sent)
        assert said.speed_mps == pytest.approx(10.0)
        assert 35.0 < math.hypot(place[0], place[1]) < 46.0


def test_a_clone_has_name_and_address_of_the_honest_aircraft():
    frames = sent_by("clone-near", begin_s=0.0, away_m=40.0, above_m=0.0)
    assert frames
    for _, sent in frames:
        name, _, place = parts(sent)
        assert (name, sent.address) == ("PEER0", radio_address("PEER0"))
        assert math.dist(place, (300.0, 0.0, -60.0)) == pytest.approx(40.0, abs=1.5)


@pytest.mark.parametrize("lead_s", [4.8, -3.0])
def test_a_shadow_shifts_its_timestamps(lead_s):
    for now_s, sent in sent_by("shadow", begin_s=0.0, lead_s=lead_s):
        _, said, _ = parts(sent)
        ahead = said.timestamp_s - (UTC_AT_START_S + now_s) % 3600.0
        assert (ahead + 1800.0) % 3600.0 - 1800.0 == pytest.approx(lead_s, abs=0.11)


def test_a_herding_ghost_seems_to_fly_into_the_own_aircraft():
    for _, sent in sent_by("herd", begin_s=0.0, closing_mps=4.0, away_m=14.0):
        _, said, place = parts(sent)
        gap = np.array(place) - (0.0, 0.0, -60.0)
        course = math.radians(said.direction_deg)
        north, east = said.speed_mps * math.cos(course), said.speed_mps * math.sin(course)
        closing = np.array([north - 10.0, east, -said.vertical_speed_mps]) @ gap / np.linalg.norm(gap)
        assert np.linalg.norm(gap) == pytest.approx(14.0, abs=1.0)
        assert closing == pytest.approx(-4.0, abs=0.1)


def test_a_replay_sends_the_same_bytes_later():
    drawn = scene.draw(Cell(kind="replay"), 1)
    values = {**draw_attack("replay", 1).values, "begin_s": 0.0, "delay_s": 2.0, "copies": 3.0, "whose": 0.0}
    attacker = KINDS["replay"].make(values, drawn, np.random.default_rng(1))
    attacker.overhear(1.0, "PEER0", WIFI_BEACON, "aa", b"frame")
    attacker.overhear(1.0, "OWN", WIFI_BEACON, "bb", b"own")
    assert attacker.send(2.9, VIEW) == []
    assert attacker.send(3.0, VIEW) == [Sent(WIFI_BEACON, "aa", frame=b"frame")] * 3
    assert attacker.send(4.0, VIEW) == []


def test_a_liars_position_has_the_offset_of_the_attack():
    drawn = scene.draw(Cell(kind="liar"), 1)
    values = {"away_m": 50.0, "bearing_turn": 0.25, "above_m": 0.0}
    assert KINDS["liar"].make(values, drawn, np.random.default_rng(1)).lie() == pytest.approx(
        (0.0, 50.0, 0.0)
    )


def test_an_adsb_ghost_is_no_remote_id():
    drawn = scene.draw(Cell(kind="adsb"), 1)
    attacker = KINDS["adsb"].make(
        draw_attack("adsb", 1).values | {"begin_s": 0.0}, drawn, np.random.default_rng(1)
    )
    reports = [r for tick in range(200) for r in attacker.reports(tick * 0.05, VIEW)]
    assert len(reports) == 10
    assert attacker.send(5.0, VIEW) == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_every_corner_of_a_kinds_parameters_can_be_sent(kind, share):
    """A receiver can read the frames at every corner of the search space."""
    attack = attack_at(kind, [share] * len(KINDS[kind].parameters))
    attack.check()
    drawn, receiver = scene.draw(Cell(kind=kind), 1), FrameReceiver()
    attacker = KINDS[kind].make(attack.values, drawn, np.random.default_rng(1))
    for tick in range(0, 1400, 7):
        for sent in attacker.send(tick * 0.05, VIEW)[:3]:
            sender = flight.FrameSender(sent.address)
            for frame in sender.frames(sent.transport, sent.messages):
                assert receiver.receive(sent.transport, sent.address, frame) is not None


def test_the_transmitter_sends_no_more_than_it_can():
    budget, taken = Budget(), 0
    for _ in range(100):
        budget.pass_time(0.05)
        taken += sum(budget.spend(WIFI_BEACON) for _ in range(1000))
    assert taken == pytest.approx(5.0 * FRAMES_PER_S[WIFI_BEACON], rel=0.06)


@pytest.mark.parametrize(
    ("values", "word"),
    [({"away_m": 1e6}, "away_m"), ({"more": 1.0}, "more"), ({}, None)],
)
def test_an_attack_beyond_its_limits_is_refused(values, word):
    attack = draw_attack("liar", 1)
    changed = Attack("liar", {**attack.values, **values})
    if word is None:
        changed.check()
        return
    with pytest.raises(ConfigError, match=word):
        changed.check()


# ------------------------------------------------------------ the air


def test_the_position_survives_the_conversion():
    for place in ((0.0, 0.0, 0.0), (2000.0, -1500.0, -600.0), (-9000.0, 9000.0, -20.0)):
        assert HOME.to_ned(*geodetic(place)) == pytest.approx(place, abs=1e-6)
        assert geodetic(place) == pytest.approx(HOME.to_geodetic(*place), abs=1e-6)


def test_a_location_is_that_of_its_timestamp():
    said = location(10.05, (100.0, 0.0, -50.0), (20.0, 0.0, 0.0))
    assert HOME.to_ned(said.lat_deg, said.lon_deg, said.alt_geodetic_m - 47.0)[0] == pytest.approx(
        99.0, abs=0.02
    )


def heard_at(distance_m, *, signal=True, seed=1, count=400):
    air = Air(seed, signal=signal)
    air.join("OWN")
    sender = flight.FrameSender(radio_address("X"))
    for number in range(count):
        messages = report("X", 0.1 * number, (0.0, 0.0, -50.0), (0.0, 0.0, 0.0))
        for frame in sender.frames(WIFI_BEACON, messages):
            air.send(
                0.1 * number, "X", (0.0, 0.0, -50.0), {"OWN": (distance_m, 0.0, -50.0)}, WIFI_BEACON, "aa",
                frame, 18.0, honest=False,
            )  # fmt: skip
    return air.heard("OWN", math.inf)


def test_the_signal_strength_is_that_of_the_channel_model():
    strengths = [np.mean([h.rssi_dbm for h in heard_at(100.0, seed=seed, count=40)]) for seed in range(60)]
    assert np.mean(strengths) == pytest.approx(18.0 - path_loss_db(100.0), abs=2.0)
    assert 2.5 < np.std(strengths) < 5.5
    within = np.std([h.rssi_dbm for h in heard_at(100.0)])
    assert 4.0 < within < 5.0


def test_nothing_is_heard_beyond_the_range():
    assert len(heard_at(100.0, count=40)) == 40
    assert not heard_at(40_000.0, count=40)


def test_without_signal_strength_there_is_none():
    assert {h.rssi_dbm for h in heard_at(100.0, signal=False, count=5)} == {None}


# ------------------------------------------------------------ flights and the judge


@pytest.mark.parametrize("kind", MEETING_KINDS)
def test_a_seed_gives_one_flight(kind):
    assert fly(Cell(kind=kind), 3) == fly(Cell(kind=kind), 3)


def test_without_the_attack_all_kinds_fly_the_same():
    rows = [fly(scene.baseline(Cell(kind=kind)), 4) for kind in ("crowd", "replay")]
    assert rows[0] == rows[1]
    drawn = {scene.draw(Cell(kind=kind), 4) for kind in ("crowd", "clone-near", "shadow", "replay", "free")}
    assert len(drawn) == 1


def test_the_unavoided_paths_meet():
    """Without a companion the drawn aircraft would lose separation, so an attack can do harm."""
    for seed in range(50):
        drawn = scene.draw(Cell(kind="crowd"), seed)
        own = drawn.planned(drawn.meeting_s)
        assert math.dist(own, drawn.honest[0].state(0.0)[0]) < 10.0


def test_an_attack_changes_the_flight():
    cell = Cell(kind="herd")
    assert fly(cell, 1) != fly(scene.baseline(cell), 1)


def test_the_judge_detects_a_planted_loss():
    """An aircraft that nobody hears flies into the own one."""
    drawn = scene.draw(Cell(kind="crowd", intruder="blind"), 1)
    mute = msgspec.structs.replace(drawn.honest[0], sends_from_s=1e9)
    drawn = msgspec.structs.replace(drawn, honest=(mute,))
    attacker = Silent({}, drawn, np.random.default_rng(1))
    row = judged(World(drawn, attacker, (0.0, 0.0, 0.0), 20.0), "blind")
    assert row.lost
    assert row.separation_m < 10.0
    assert row.held_s < 8.0  # the aircraft starts from rest, 20 m behind the path's point


def test_the_judge_sees_between_two_steps():
    assert least_distance((0, 0, 0), (5, 1, 0), (10, 0, 0), (5, 1, 0)) == pytest.approx(1.0)
    assert least_distance((0, 0, 0), (3, 4, 0), (0, 0, 0), (3, 4, 0)) == pytest.approx(5.0)


def test_the_judge_measures_from_the_path():
    drawn = scene.draw(Cell(kind="herd"), 3)
    judge = Judge(drawn, "fence")
    north, east, down = drawn.planned(10.0)
    beside = north - 70.0 * math.sin(drawn.heading_rad), east + 70.0 * math.cos(drawn.heading_rad), down - 7.0
    for _ in range(20):
        judge.look(10.0, 0.05, [beside], [True], on_mission=False)
    row = judge.row()
    assert row.separation_m is None
    assert (row.aside_m, row.up_m, row.down_m, row.beyond_m) == (70.0, 7.0, 0.0, 10.0)
    assert (row.held_s, row.longest_s) == (1.0, 1.0)


# ------------------------------------------------------------ search, kept cases, command line


def test_a_search_is_reproducible_and_finds_no_less_than_it_flew():
    pytest.importorskip("cma")
    told = []
    cell = Cell(kind="liar", intruder="blind")
    words = Console()
    ((_, first),) = rounds_in_parallel(
        search.fly, [search.worst(cell, 2, "separation", 7, told.append)], 1, words
    )
    ((_, again),) = rounds_in_parallel(search.fly, [search.worst(cell, 2, "separation", 7)], 2, words)
    assert first == again == told[-1]
    harms = [search.harm_of(found.row, "separation") for found in told]
    assert harms == sorted(harms)
    first.attack.check()
    assert fly(cell, 2, first.attack) == first.row


def test_a_search_moves_towards_the_harm():
    """The separation is replaced by the distance of the parameters from those of one attack."""
    pytest.importorskip("cma")
    cell, row = Cell(kind="liar", intruder="blind"), fly(Cell(kind="liar"), 5)
    parameters = KINDS["liar"].parameters

    def separation_m(attack):
        """Distance from the attack at 0.7 of every range, in hundredths of the range."""
        parts = ((attack.values[p.name] - p.low) / (p.high - p.low) - 0.7 for p in parameters)
        return 100.0 * math.hypot(*parts)

    work = search.worst(cell, 2, "separation", 400)
    flights = next(work)
    try:
        while True:
            flown = [separation_m(attack) for _, _, attack in flights]
            flights = work.send([msgspec.structs.replace(row, separation_m=m) for m in flown])
    except StopIteration as end:
        found = end.value
    assert found.evaluations >= 400
    assert found.row.separation_m == separation_m(found.attack) < 1.0


def test_an_interrupted_search_goes_on_where_it_was(tmp_path, capsys, monkeypatch):
    pytest.importorskip("cma")
    row, flown = fly(Cell(kind="liar"), 5), []

    def flight_outcome(flight_):
        """Replacement of a flight: the separation depends only on the attack."""
        flown.append(flight_)
        return msgspec.structs.replace(row, separation_m=sum(flight_[2].values.values()) % 50.0)

    monkeypatch.setattr(search, "fly", flight_outcome)
    path = tmp_path / "liar-blind-separation-2.jsonl"
    line = ["campaign", "attacks", "--kind", "worst", "--of", "liar", "--intruder", "blind", "--seeds", "2-2",
            "--jobs", "1", "--json", "--out", str(tmp_path), "--evaluations"]  # fmt: skip
    assert cli.main([*line, "60"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    kept_lines = path.read_text().splitlines(keepends=True)
    assert len(kept_lines) == 2 + found["evaluations"]  # Header, drawn attack, search.
    path.write_text("".join(kept_lines[:-1]) + kept_lines[-1][:40])  # As a killed process leaves it.

    flown.clear()
    assert cli.main([*line, "60"]) == 0
    assert json.loads(capsys.readouterr().out) == [found]
    assert 0 < len(flown) < 30  # Only the incomplete generation was flown again.
    assert cli.main([*line, "90"]) == 0
    longer = json.loads(capsys.readouterr().out)
    assert longer[0]["evaluations"] >= 90
    path.unlink()
    assert cli.main([*line, "90"]) == 0  # The same search without an interruption.
    assert json.loads(capsys.readouterr().out) == longer


def test_a_kept_case_survives_its_file(tmp_path):
    cell = Cell(kind="liar")
    row = fly(cell, 5)
    case = kept.Case(
        about="", cell=cell, seed=5, attack=draw_attack("liar", 5), found=row, found_with=kept.software()
    )
    kept.write(tmp_path / "case.json", case)
    assert kept.read(tmp_path / "case.json") == case
    assert kept.fly(case) == row
    assert not kept.broken(case, row)
    promised = msgspec.structs.replace(
        case, at_least_m=row.separation_m + 1.0, most_aside_m=row.aside_m - 1.0
    )
    assert len(kept.broken(promised, row)) == 2


def test_the_command_prints_the_table_and_repeats_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    args = [
        "campaign",
        "attacks",
        "--kind",
        "liar",
        "--seeds",
        "1-2",
        "--jobs",
        "1",
        "--out",
        "kept",
        "--json",
    ]
    assert cli.main(args) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["liar"]["flights"] == 2
    assert first["liar"]["without"]["flights"] == 2
    monkeypatch.setattr(flight, "fly", None)
    assert cli.main(args) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert cli.main([*args[:-1]]) == 0
    assert "| liar | 2 |" in capsys.readouterr().out
