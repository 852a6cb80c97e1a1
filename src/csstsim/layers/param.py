"""Base of the parameters (obs_param) of all layers. Their names are those of the paper's Appendix B."""

from csstsim.base.model import Model

EXPTIME = "exposure time [s], of the whole exposure: one for all layers of a list; null = the pointing's"


class LayerParam(Model):
    """Base of every layer's Param: frozen, typed, and an unknown key is an error."""
