"""Examinations of the companion under faults, judged from outside.

`rule_judge.Judge` checks rules on the bytes at the vehicle's end and on the pilot's choices, without using
the companion's internal state. `faults.Fault` is one entry of a schedule of faults, and `world.World` is one
vehicle with one companion in virtual time, with a `modelled_link.ModelledLink` between them. `soak` flies
missions for hours with random faults (`flights`), and `takeover` flies many short cases around a pilot's mode
selection. `takeover.real_cases` and `swarm` do the same with real processes, through the router in
`processes`. Schedules that break a rule are shortened (`shrink`, `takeover.cases.shortest`) and kept
(`schedule_file`). Start reading with `rule_judge.py` and `world.py`.
"""
