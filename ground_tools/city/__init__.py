"""Many aircraft over a city, each flying the law's own kernel and choosing its own transports.

Start with `simulation.py`, which drives everything. `flights` is what is to be flown, `tables` holds the
state of the aircraft in the air, `links` says who can receive whom, `tracks` is what each aircraft knows of
others, and `loop` is the compiled loop over the steps. `radio` applies the channel equations and
chooses transports. `traffic` draws flights and reads those of others. docs/city.md
describes what is modelled and how it was checked.
"""
