"""Tracks of other aircraft, from Remote ID messages and the autopilot's ADS-B receiver.

This is the paper's "orient": received data is converted to our local frame and clock, assigned to tracks,
checked for plausibility, and handed to the avoidance law as `Neighbour`s. All received data is untrusted:
doubts raise flags for the log and the pilot, but a doubtful aircraft is still avoided. `tracks.Traffic` is
the table of `track.Track`s from Remote ID, `fix.Fix` is one converted Location, `doubts.Judge` raises the
`plausibility.Flag`s, and `adsb.AdsbTraffic` is the table for ADS-B. `own_flight` recognises our own messages,
`signatures` verifies what senders sign, `right_of_way` ranks aircraft, and `senders.reception` measures rates
and losses for `companion.atmc`. `sensed` tracks obstacles and aircraft that sensors aboard see. This room may
import the rooms before it in `ROOMS` of tests/test_imports.py. Start with `tracks.py`, then `track.py` and
`fix.py`.
"""

from companion.traffic.adsb import AdsbTraffic
from companion.traffic.plausibility import Flag
from companion.traffic.right_of_way import rank_of, share_of
from companion.traffic.track import Track
from companion.traffic.tracks import Traffic, TrafficCounts

__all__ = [
    "AdsbTraffic",
    "Flag",
    "Track",
    "Traffic",
    "TrafficCounts",
    "rank_of",
    "share_of",
]
