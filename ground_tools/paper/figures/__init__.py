"""Modules that recompute the published figures of the paper.

For each figure, `report` returns a `ground_tools.paper.report.Report` with the paper's statements and numbers
next to ours, and `draw` writes the picture. `delay_rate`, `packet_loss` and `fixed_modes` show the fixed
modes by the channel model's equations. `convergence`, `system_delay` and `uav_delay` show the learning
algorithms from stored training runs next to methods that are measured anew. `decision_time` times one
decision of each policy file. `dmuca`, `dmuca_flights` and `dmuca_picture` together show the avoidance flights
of two figures. Start reading with `delay_rate`, which is one of the simplest.
"""
