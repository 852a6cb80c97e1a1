"""What the parameters (obs_param) of every layer share. The paper's Appendix B names them."""

from csstsim.base.model import Model

EXPTIME = "exposure time [s], of the whole exposure: one for all layers of a list; null = the pointing's"


class LayerParam(Model):
    """Base of every layer's Param: frozen, typed, and an unknown key is an error."""
