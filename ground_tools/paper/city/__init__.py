"""The figure over density: the effect of communication on the safety of hundreds of aircraft over a city.

`command` is `ground-tools paper city`. `grid` defines the cities and their computing cost, `runs` flies them
and stores the results, `numbers` gives values with intervals, `verdict` finds the density at which a method
stops meeting the target, and `table` and `picture` show the results. docs/city.md describes the study.
"""
