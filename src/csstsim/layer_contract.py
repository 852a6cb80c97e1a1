"""The contract test of a layer of your own; its home is csstsim.simulation.layer_contract."""

from csstsim.simulation.layer_contract import *  # noqa: F403
