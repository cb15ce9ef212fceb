"""Measures what the scenarios of `ground_tools.campaign.scenarios` are about, and the command for it."""
