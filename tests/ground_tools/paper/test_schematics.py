"""Which packets are drawn as received in the picture of the radio modes."""

import pytest

from ground_tools.paper.figures.schematics import ble_windows, is_heard, primary_packets, wifi_windows
from sitl_mocks.channel.parameters import ChannelParameters

P = ChannelParameters()


@pytest.mark.parametrize(
    ("begin_ms", "heard"),
    [
        (0.6, [True, False, False]),  # channel 37 is scanned from 0 to 2 ms
        (1.7, [False, False, False]),  # the packet ends after the window
        (8.0 - 0.501, [False, True, False]),  # channel 38, from 8 ms on
        (15.0, [False, False, True]),  # channel 39, from 16 ms on
    ],
)
def test_packets_within_a_window_of_their_channel_are_heard(begin_ms, heard):
    windows = ble_windows(P.ble4)
    assert [is_heard(packet, windows) for packet in primary_packets(P.ble4, begin_ms)] == heard


def test_wifi_is_deaf_while_it_switches():
    windows = wifi_windows(P.wifi)
    assert is_heard((5.0, 0.632, 0), windows)
    assert not is_heard((6.1, 0.632, 0), windows)
    assert not is_heard((6.1, 0.632, 1), windows)
