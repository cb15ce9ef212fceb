"""Delay, age, loss and coverage of hand-written runs."""

import math

import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.packets.metrics import loss, never_heard, sample_delay_s
from sitl_mocks.channel.packets.simulation import Result
from sitl_mocks.channel.packets.timing import BLE4, WIFI


def written(*heard: tuple[int, int, float], duration_s: float = 10.0, mode: int = BLE4) -> Result:
    """Aircraft 0 samples at -0.5, 0.5, 1.5 ... s. Heard: (sample number, by whom, when)."""
    carried = np.zeros((3, 3, 3), bool)
    carried[0, 1:, mode] = True
    sample = np.array([h[0] for h in heard], int)
    events = len(heard)
    return Result(
        duration_s=duration_s,
        gnss_period_s=1.0,
        first_sample_s=np.array([-0.5, -0.2, -0.1]),
        carried=carried,
        transmitter=np.zeros(events, int),
        mode=np.full(events, mode),
        sample=sample,
        start_s=sample - 0.5,
        sample_s=sample - 0.5,
        heard_event=np.arange(events),
        heard_by=np.array([h[1] for h in heard], int),
        heard_s=np.array([h[2] for h in heard], float),
        hearable=np.zeros((3, 3, 3), np.int64),
        lost=np.zeros((3, 3, 3), np.int64),
    )


def test_a_later_samples_message_serves_the_earlier_ones() -> None:
    # Samples 1 to 4 (0.5 to 3.5 s) count in a run of 5 s with a tail of 1 s.
    result = written((1, 1, 0.7), (3, 1, 2.6), (3, 1, 2.9), (4, 1, 4.0), duration_s=5.0)
    delay = sample_delay_s(result, tail_s=1.0)
    # 0.2; sample 2 waits for the message with sample 3: 1.1; 0.1; 0.5.
    assert delay.mean_s[0, 1, BLE4] == pytest.approx((0.2 + 1.1 + 0.1 + 0.5) / 4)
    assert delay.open_samples[0, 1, BLE4] == 0
    pieces = np.array([0.2, 1.1, 0.1, 0.5])
    assert delay.standard_error_s[0, 1, BLE4] == pytest.approx(pieces.std(ddof=1) / 2.0)


def test_who_never_hears_has_an_infinite_delay_and_is_told_apart() -> None:
    result = written(*((k, 1, k - 0.4) for k in range(1, 60)), duration_s=59.0)
    delay = sample_delay_s(result, tail_s=5.0)
    assert delay.mean_s[0, 1, BLE4] == pytest.approx(0.1)
    assert delay.mean_s[0, 2, BLE4] == math.inf
    assert delay.open_samples[0, 2, BLE4] == 54
    assert delay.pooled_s[BLE4] == pytest.approx(0.1)
    assert delay.pooled_error_s[BLE4] == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(delay.mean_s[1:]).all()
    assert np.isnan(delay.pooled_s[WIFI])
    assert never_heard(result) == 0.5


def test_a_sample_under_way_at_the_end_enters_with_the_time_waited_and_is_counted() -> None:
    result = written((1, 1, 0.7), duration_s=4.0)
    delay = sample_delay_s(result, tail_s=1.0)
    # Samples at 0.5, 1.5 and 2.5 s: 0.2, and 2.5 and 1.5 so far.
    assert delay.mean_s[0, 1, BLE4] == pytest.approx((0.2 + 2.5 + 1.5) / 3)
    assert delay.open_samples[0, 1, BLE4] == 2


def test_another_receivers_or_modes_messages_do_not_count() -> None:
    result = written((1, 1, 0.7), (1, 2, 1.4), (2, 2, 1.6), duration_s=3.0)
    assert sample_delay_s(result, tail_s=2.5).mean_s[0, :, BLE4] == pytest.approx(
        [math.nan, 0.2, 0.9], nan_ok=True
    )


def test_a_tail_longer_than_the_run_is_refused() -> None:
    with pytest.raises(ConfigError, match="tail_s"):
        sample_delay_s(written((1, 1, 0.7)), tail_s=10.0)


def test_loss_is_the_share_of_hearable_packets() -> None:
    result = written((1, 1, 0.7))
    result.hearable[0, 1, BLE4], result.lost[0, 1, BLE4] = 8, 2
    assert loss(result)[0, 1, BLE4] == 0.25
    assert np.isnan(loss(result)[0, 2, BLE4])
