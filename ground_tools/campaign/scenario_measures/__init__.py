"""Measures for the scenarios of `ground_tools.campaign.scenarios`: arrivals, time to clear, needless
deviation."""
