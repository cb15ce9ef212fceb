"""Flights towards things that transmit nothing: poles, walls and aircraft that only an onboard sensor sees.

`scene` draws what stands or flies in the way. `flight` flies the companion's own core towards it, with the
mock vehicle's sensor and the link's own readers of its frames. `cells` stores the outcomes, and `command` is
`ground-tools campaign sensed`.
"""
