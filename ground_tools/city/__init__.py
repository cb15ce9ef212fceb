"""Many aircraft over a city, each flying the law's own kernel and choosing its own transports.

Start reading with `simulation.py`, which drives everything. `flights` holds the planned flights, `tables` the
state of the aircraft in the air, `links` finds who can receive whom, `tracks` holds what each aircraft knows
of the others, and `loop` is the compiled loop over the steps. `radio` applies the channel equations and
chooses transports. `traffic` draws flights, or reads them from files of other projects. docs/city.md
describes what is modelled and how it was checked.
"""
