"""What the parameters (obs_param) of every layer share. The paper's Appendix B names them."""

from csstsim.model import Model


class LayerParam(Model):
    """Base of every layer's Param: frozen, typed, and an unknown key is an error."""
