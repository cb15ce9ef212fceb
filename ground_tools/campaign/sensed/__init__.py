"""Flights towards what sends nothing: poles, walls and aircraft that only a sensor aboard sees.

`scene` draws what stands or flies in the way, `flight` flies the companion's own core towards it with the
mock vehicle's sensor, whose frames the link's own readers read. `cells` keeps the outcomes, and `command` is
`ground-tools campaign sensed`.
"""
