"""Avoidance laws of other projects in the campaign's world, for comparison with the companion's own law.

`laws` lists them with their parameters. `orca` is ORCA as published, or with other radii; `mvp` is the
Modified Voltage Potential of the BlueSky simulator, and `fly_away` the rule of ArduPilot's AP_Avoidance.
`common` holds what they share: each follows the timed path like the companion's law when there is nothing to
avoid, receives the same messages, and has the same velocity limits. `flown` resolves the name of a law.
`ground_tools.campaign.peer_comparison` compares the laws.
"""
