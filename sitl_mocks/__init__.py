"""What stands in for hardware: a MAVLink vehicle, the radio channel, the air between aircraft."""
