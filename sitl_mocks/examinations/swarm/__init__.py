"""What `sitl-mocks swarm --faults` adds to a swarm: schedules of faults, their injection, and the verdict.

`examination` disturbs and judges one aircraft, `schedule` draws and reads its faults, and `verdict` prints
what was found.
"""
