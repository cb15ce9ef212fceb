"""The closed-loop experiment: from the choice of transports through the radio channel to the separation.

The paper draws message delays from fixed intervals. This experiment, `ground-tools paper closed-loop`, lets
them result from the transport policy and the simulated packets. `flights` builds and flies one run: a
`Flight` names condition, method and seeds, and each encounter yields a `Row`. `cells` stores the rows, so
that an interrupted experiment can be continued. `table` computes the measures with their intervals, and
`command` plans, flies and shows everything. Start reading with `command.run` and `flights.rows_of`.
"""
