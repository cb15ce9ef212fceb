# %% [markdown]
# # A campaign with a law of one's own
#
# A law is a class of another distribution that is found by its entry point
# ([plug-ins.md](../plug-ins.md)). Usually it is a project that `pip install` installs, such as
# `docs/examples/plugin-law`. Here its module and the metadata that pip would leave are written to a
# folder.

# %%
import sys
import tempfile
from pathlib import Path

folder = Path(tempfile.mkdtemp())
(folder / "right_turn.py").write_text(
    """
import math


class RightTurn:
    def __init__(self, avoidance):
        self.avoidance = avoidance

    def choose(self, situation, follow, limits):
        north, east, down = follow.wanted_ned_mps
        if not follow.conflict:
            return north, east, down
        turn = math.radians(60.0)
        return (
            north * math.cos(turn) - east * math.sin(turn),
            north * math.sin(turn) + east * math.cos(turn),
            down,
        )
"""
)
(folder / "right_turn-1.0.dist-info").mkdir()
(folder / "right_turn-1.0.dist-info" / "METADATA").write_text(
    "Metadata-Version: 2.1\nName: right-turn\nVersion: 1.0\n"
)
(folder / "right_turn-1.0.dist-info" / "entry_points.txt").write_text(
    "[dmuca.laws]\nright-turn = right_turn:RightTurn\n"
)
sys.path.insert(0, str(folder))

# %% [markdown]
# A cell of a campaign is one kind of encounter, flown by one law. The seeds decide everything that is
# drawn, so that every law flies the same encounters: here two aircraft whose paths cross in one place,
# with messages that are one to two seconds old.

# %%
from ground_tools.campaign.cells import SEPARATION_M, Cell, fly

for law in ("none", "right-turn", "dmuca"):
    rows = fly(Cell(generator="S2", aircraft=2, delay_s=(1.0, 2.0), law=law), seeds=range(1, 6))
    lost = sum(row.separation_m < SEPARATION_M for row in rows)
    print(f"{law}: {lost} of {len(rows)} below {SEPARATION_M:.0f} m")

# %% [markdown]
#     none: 5 of 5 below 10 m
#     right-turn: 0 of 5 below 10 m
#     dmuca: 0 of 5 below 10 m
#
# Five encounters say nothing of a law: [safety.md](../safety.md) flies thousands, and says how.
