"""The simple radio channel: its four parameters, its errors and its random draws."""

import math

import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.air import Transmission
from sitl_mocks.channel.simple import SimpleChannel


def deliver(channel: SimpleChannel, distance_m: float | None, rng: np.random.Generator) -> float | None:
    """Delay of one message that is sent at time 0."""
    channel.transmit(Transmission(0, 0.0, "a", "ble4", {"b": distance_m}), rng)
    (outcome,) = channel.settle(0.0, rng)
    return outcome.arrival_s


def deliveries(channel: SimpleChannel, distance_m: float | None = 100.0, n: int = 2000) -> list[float | None]:
    rng = np.random.default_rng(7)
    return [deliver(channel, distance_m, rng) for _ in range(n)]


def test_every_receiver_gets_one_outcome_and_it_is_told_once() -> None:
    channel, rng = SimpleChannel(delay_s=(0.5, 0.5), range_m=50.0), np.random.default_rng(1)
    assert channel.next_s() is None
    channel.transmit(Transmission(3, 10.0, "a", "wifi", {"b": 1.0, "c": 60.0}), rng)
    channel.transmit(Transmission(4, 11.0, "b", "wifi", {"a": 1.0}), rng)
    assert channel.next_s() == 10.0
    told = [(o.number, o.receiver, o.arrival_s) for o in channel.settle(11.0, rng)]
    assert told == [(3, "b", 10.5), (3, "c", None), (4, "a", 11.5)]
    assert channel.settle(99.0, rng) == []
    assert channel.next_s() is None


def test_a_channel_without_parameters_is_perfect() -> None:
    assert set(deliveries(SimpleChannel())) == {0.0}


def test_equal_bounds_make_the_delay_constant() -> None:
    assert set(deliveries(SimpleChannel(delay_s=(0.4, 0.4)))) == {0.4}


def test_the_delay_is_uniform_between_its_bounds() -> None:
    delays = [d for d in deliveries(SimpleChannel(delay_s=(0.2, 1.0))) if d is not None]
    assert len(delays) == 2000
    assert 0.2 <= min(delays) < 0.21
    assert 0.99 < max(delays) <= 1.0
    assert np.mean(delays) == pytest.approx(0.6, abs=0.02)
    assert np.std(delays) == pytest.approx(0.8 / math.sqrt(12), abs=0.02)


@pytest.mark.parametrize("loss", [0.0, 0.25, 1.0])
def test_the_share_lost_is_the_probability(loss: float) -> None:
    lost = deliveries(SimpleChannel(loss=loss)).count(None)
    assert lost / 2000 == pytest.approx(loss, abs=0.03 if 0 < loss < 1 else 0)


@pytest.mark.parametrize(("distance_m", "arrives"), [(499.9, True), (500.1, False), (None, True)])
def test_nothing_is_heard_out_of_range(distance_m: float | None, arrives: bool) -> None:
    channel = SimpleChannel(range_m=500.0)
    assert all((d is not None) == arrives for d in deliveries(channel, distance_m, 50))


def test_the_luck_of_a_message_does_not_depend_on_where_the_others_were() -> None:
    """Two runs with one seed differ only by what their aircraft do."""
    channel = SimpleChannel(delay_s=(0.0, 1.0), loss=0.3, range_m=500.0)
    near, mixed = np.random.default_rng(3), np.random.default_rng(3)
    for i in range(200):
        one = deliver(channel, 10.0, near)
        other = deliver(channel, 10.0 if i % 2 else 900.0, mixed)
        assert other == (one if i % 2 else None)


@pytest.mark.parametrize(
    ("arguments", "key", "limit"),
    [
        ({"delay_s": (-0.1, 1.0)}, "channel.delay_s", "0 <= low <= high <= 60"),
        ({"delay_s": (1.0, 0.5)}, "channel.delay_s", "0 <= low <= high <= 60"),
        ({"delay_s": (0.0, 61.0)}, "channel.delay_s", "0 <= low <= high <= 60"),
        ({"delay_s": (0.0, math.nan)}, "channel.delay_s", "0 <= low <= high <= 60"),
        ({"loss": -0.01}, "channel.loss", "0 to 1"),
        ({"loss": 1.01}, "channel.loss", "0 to 1"),
        ({"loss": math.nan}, "channel.loss", "0 to 1"),
        ({"range_m": 0.0}, "channel.range_m", "above 0"),
        ({"range_m": math.inf}, "channel.range_m", "above 0"),
        ({"range_m": math.nan}, "channel.range_m", "above 0"),
    ],
)
def test_a_bad_parameter_is_refused_by_name_and_limit(
    arguments: dict[str, object], key: str, limit: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        SimpleChannel(**arguments)  # type: ignore[arg-type]
    assert key in str(refused.value)
    assert limit in str(refused.value)
