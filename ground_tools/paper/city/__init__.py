"""The figure over density: what communication decides among hundreds of aircraft in one air.

`command` is `ground-tools paper city`. `grid` says which cities are flown and what they cost, `runs` flies
and keeps them, `numbers` gives values with intervals, `verdict` the density at which a method stops keeping
the target, `table` and `picture` show them. docs/city.md describes the study.
"""
