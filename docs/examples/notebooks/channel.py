# %% [markdown]
# # Delay and loss on the air
#
# The published equations give the delay and the loss of each mode on each link of a fleet. `all_links`
# makes a link of every pair and needs the propagation alone. `near_links`, for thousands of aircraft,
# needs all parameters, because they say how far any mode reaches.

# %%
import numpy as np

from companion.shipped import shipped
from sitl_mocks.channel import Analytic, all_links, draw_positions, fixed_mode, load_parameters

parameters = load_parameters(shipped("config/channel/standard.toml"))
for aircraft in (5, 50, 200):
    rng = np.random.default_rng(1)
    positions_m = draw_positions(1, aircraft, 1000.0, rng)  # one fleet in a square of 1 km
    links = all_links(positions_m, parameters.propagation, rng)
    for rate in (1, 10):
        found = Analytic(parameters).evaluate(links, fixed_mode(aircraft, "wifi", rate, parameters, rng))
        delay_s, loss = (float(np.nanmedian(values[:, 2])) for values in (found.delay_s, found.loss))
        print(f"{aircraft} aircraft, {rate} a second: {delay_s:.2f} s, {loss:.1%} lost")

# %% [markdown]
#     5 aircraft, 1 a second: 2.59 s, 0.0% lost
#     5 aircraft, 10 a second: 0.26 s, 0.0% lost
#     50 aircraft, 1 a second: 2.59 s, 0.0% lost
#     50 aircraft, 10 a second: 0.39 s, 6.6% lost
#     200 aircraft, 1 a second: 2.66 s, 0.4% lost
#     200 aircraft, 10 a second: 11.75 s, 96.0% lost
#
# The columns of `delay_s` and `loss` are BLE 4, BLE 5 and Wi-Fi, in seconds and as a share; NaN where a
# mode does not reach. Which rate is best depends on how many aircraft send: [atmc.md](../atmc.md).
