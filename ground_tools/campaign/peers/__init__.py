"""Other avoidance laws in the campaign's world, as a measure of what the companion's own law is worth.

`laws` names them with their parameters. `orca` is ORCA as published, or with other radii; `mvp` is the
Modified Voltage Potential of the BlueSky simulator, and `fly_away` the rule of ArduPilot's AP_Avoidance.
`common` holds what they share: each follows the timed path as the companion's law does where it has nothing
to avoid, hears the same messages, and its velocity passes the same limits. `flown` says what the name of a
law means for a flight. `ground_tools.campaign.peer_comparison` compares the laws.
"""
