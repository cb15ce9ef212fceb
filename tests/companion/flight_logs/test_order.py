"""The order of time in onboard logs: late, doubtful and restarted clocks."""

from companion.event_record import Step
from companion.events import VehicleText
from companion.flight_logs.logged import About, TimeOrder, plain


def ordered(
    times: list[float], *, may_restart: bool = True, start_s: float | None = None
) -> tuple[list[tuple[float, str]], About]:
    """What becomes of texts with these time stamps, which name the place at which they were written."""
    about = About()
    order = TimeOrder(about, may_restart=may_restart, start_s=start_s)
    steps: list[Step] = []
    for number, time_s in enumerate(times):
        steps += order.add(time_s, VehicleText(severity=6, text=str(number)))
    steps += order.rest()
    return [(step.now_s, step.events[0].text) for step in steps], about  # type: ignore[union-attr]


def test_messages_that_are_a_little_out_of_order_are_sorted():
    found, about = ordered([0.0, 0.3, 0.1, 2.0, 1.9])
    assert found == [(0.0, "0"), (0.1, "2"), (0.3, "1"), (1.9, "4"), (2.0, "3")]
    assert about.counts.bad_values == about.counts.restarts == 0


def test_a_single_stamp_far_ahead_is_damage_and_a_confirmed_one_is_a_pause():
    found, about = ordered([0.0, 1.0, 90_000.0, 2.0, 3.0])
    assert [name for _, name in found] == ["0", "1", "3", "4"]
    assert about.counts.bad_values == 1
    found, about = ordered([0.0, 1.0, 500.0, 500.1])
    assert found == [(0.0, "0"), (1.0, "1"), (500.0, "2"), (500.1, "3")]
    assert about.counts.bad_values == 0


def test_after_a_restart_time_goes_on():
    found, about = ordered([100.0, 200.0, 200.1, 3.0, 4.0, 5.0])
    assert [name for _, name in found] == ["0", "1", "2", "3", "4", "5"]
    assert [time_s for time_s, _ in found][3:] == [200.1, 201.1, 202.1]
    assert about.counts.restarts == 1


def test_every_short_boot_is_a_restart():
    """Eight boots of 20 s each in one log."""
    found, about = ordered([float(t) for _ in range(8) for t in range(3, 24)])
    assert about.counts.restarts == 7
    assert about.counts.bad_values == 0
    assert [name for _, name in found] == [str(number) for number in range(8 * 21)]
    assert found[-1][0] == 3.0 + 8 * 20.0


def test_a_single_message_that_comes_late_is_no_restart_and_is_kept():
    found, about = ordered([100.0, 103.0, 106.0, 71.0, 106.1, 110.0, 72.0])
    assert [name for _, name in found] == ["0", "1", "3", "2", "4", "6", "5"]
    assert [time_s for time_s, _ in found] == [100.0, 103.0, 103.0, 106.0, 106.1, 106.1, 110.0]
    assert about.counts.restarts == about.counts.bad_values == 0


def test_a_last_stamp_that_nothing_confirms_is_counted():
    found, about = ordered([0.0, 1.0, 90_000.0])
    assert [name for _, name in found] == ["0", "1"]
    assert about.counts.bad_values == 1


def test_after_a_restart_stamps_are_shifted_as_the_steps_are():
    order = TimeOrder(About(), may_restart=True)
    for time_s in (150.0, 200.0, 3.0, 4.0):
        list(order.add(time_s, VehicleText(severity=6, text="")))
    assert order.shifted(3.0) == 200.0


def test_what_was_known_long_before_gets_the_time_at_which_it_was_written():
    found, about = ordered([5.0, 600.0, 600.1], may_restart=False, start_s=600.0)
    assert found == [(600.0, "0"), (600.0, "1"), (600.1, "2")]
    assert about.counts.restarts == about.counts.bad_values == 0


def test_colours_of_a_terminal_are_left_out_of_texts():
    assert plain("\x1b[32mReady for takeoff!\x1b[0m\t\0junk") == "Ready for takeoff!"
