"""Base of the parameters (obs_param) of all layers. Their names are those of the paper's Appendix B."""

from csstsim.base.model import Model

EXPTIME = "exposure time [s], of the whole exposure: one for all layers of a list; null = the pointing's"


class LayerParam(Model):
    """Base of every layer's Param, a pydantic model: frozen, typed, and an unknown key is an error.

    Parameters
    ----------
    **data : object
        {parameter: value}; the others have their default.

    Examples
    --------
    >>> from pydantic import Field
    >>> from csstsim.layers.param import LayerParam
    >>> class Param(LayerParam):
    ...     peak: float = Field(100.0, ge=0.0, description="maximum of the trail [electron]")
    >>> Param(peak=50.0).peak
    50.0
    """
