"""What a flood of received frames may cost."""
