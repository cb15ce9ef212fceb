"""The channel equations of the paper: mean delay and loss of every link of a fleet.

`analytic.Analytic` evaluates a `Fleet` on a set of links and returns an `Evaluation`, vectorised over all
links. `reception` holds the matching sets, `delay` the mean delays and `collision` the collision products,
each for one section of the paper. `carrier_sense` and `half_duplex` add effects that the paper leaves out.
`air_analytic.AnalyticChannel` applies the equations frame by frame in the simulated air. Start reading with
`analytic.py`.
"""
