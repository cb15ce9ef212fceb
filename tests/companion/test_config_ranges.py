"""Values of a configuration with which no aircraft can fly safely are refused."""

from __future__ import annotations

import re

import pytest

from companion import config as configuration
from companion.errors import ConfigError

ABOVE = "allowed: 5 to 10000; where aircraft fly below home, set floor_height_m as well"
NAME = "allowed: 1 to 100 printable characters without /"


@pytest.mark.parametrize(
    ("section", "line", "message"),
    [
        ("limits", "ceiling_height_m = -1000", "-1000: expected a number, -500 to 10000"),
        ("limits", "ceiling_height_m = -40", f"-40: {ABOVE}"),
        ("limits", "ceiling_height_m = 4.9", f"4.9: {ABOVE}"),
        ("limits", "floor_height_m = -1e9", "-1000000000.0: expected a number, -500 to 10000"),
        ("limits", "max_speed_mps = 1e-9", "1e-09: expected a number, 0.5 to 50"),
        ("limits", "max_climb_mps = 1e-9", "1e-09: expected a number, 0.1 to 20"),
        ("limits", "max_descent_mps = 1e-9", "1e-09: expected a number, 0.1 to 20"),
        ("limits", "max_acceleration_mps2 = 1e-9", "1e-09: expected a number, 0.2 to 20"),
        ("flight", "mission_speed_mps = 1e-9", "1e-09: expected a number, 0.2 to 100"),
        ("flight", "start_within_m = 1e-9", "1e-09: expected a number, 1 to 10000"),
        ("avoidance", "conflict_radius_m = 1e-9", "1e-09: expected a number, 0.5 to 1000"),
        ("avoidance", "horizon_s = 1e-9", "1e-09: expected a number, 1 to 120"),
        ("avoidance", "recovery_time_s = 1e-9", "1e-09: expected a number, 1 to 120"),
        ("avoidance", "regained_m = 1e-9", "1e-09: expected a number, 0.5 to 1000"),
        ("avoidance", "crewed_horizontal_m = 1e-9", "1e-09: expected a number, 10 to 5000"),
        ("avoidance", "crewed_vertical_m = 1e-9", "1e-09: expected a number, 5 to 1000"),
        ("traffic", "max_speed_mps = 1e-9", "1e-09: expected a number, 10 to 400"),
        ("traffic", "expire_after_s = 1e-9", "1e-09: expected a number, 3 to 15"),
        ("record", "sync_period_s = 1e-9", "1e-09: expected a number, 0.01 to 60"),
        ("record", 'name = "../../x"', f"'../../x': {NAME}"),
        ("record", 'name = "/etc/x"', f"'/etc/x': {NAME}"),
        ("record", 'name = "a\\nb"', f"'a\\nb': {NAME}"),
        ("record", 'name = ""', f"'': {NAME}"),
    ],
)
def test_a_value_out_of_range_is_named_with_the_range(tmp_path, section, line, message):
    path = tmp_path / "c.toml"
    path.write_text(f'[identity]\nuas_id = "A1"\n[{section}]\n{line}\n')
    key = f"{section}.{line.partition(' ')[0]}"
    with pytest.raises(ConfigError, match=f"^{re.escape(f'{path}: {key}: {message}')}$"):
        configuration.load(path)


def test_a_ceiling_below_home_goes_with_a_floor(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text('[identity]\nuas_id = "A1"\n[limits]\nfloor_height_m = -80\nceiling_height_m = -40\n')
    assert configuration.load(path).limits.ceiling_height_m == -40
