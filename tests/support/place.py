"""Where the tests fly: at the home of the simulated vehicles."""

from sitl_mocks.vehicle.options import HOME

__all__ = ["HOME"]
