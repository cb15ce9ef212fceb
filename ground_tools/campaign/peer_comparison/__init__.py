"""Compares the laws of `ground_tools.campaign.peers` with the companion's own law, in the campaign's world.

`search` finds the parameters of each law with an equal budget, `table` and `pareto` compare the laws, and
`command` is the command line.
"""
