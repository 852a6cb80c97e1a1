"""The contract test of your own layer; the code is in csstsim.simulation.layer_contract."""

from csstsim.simulation.layer_contract import *  # noqa: F403
