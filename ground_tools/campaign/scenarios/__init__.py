"""Encounters beyond those of `generators`: intruders on missions, and scenarios that are hard for the law.

`missions` draws the paths of intruders that fly missions and avoid nobody. `layouts` draws scenarios of
everyday traffic in which the law deviates too far, or in which aircraft do not arrive. `files` makes flights
from files of other projects, which `bluesky` and `metropolis` read. `surroundings` adds crewed traffic and
fences. `ground_tools.campaign.scenario_measures` measures these flights.
"""
