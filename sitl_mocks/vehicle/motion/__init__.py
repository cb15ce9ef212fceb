"""How the vehicle flies: flight controller, guidance, motion, and the errors of its navigation.

`flight.Flight` is the flight controller. `guidance` leads it along missions and home, `setpoints` reads what
a companion commands, `dynamics.Body` moves, and `navigation` adds the errors of its own position.
"""
