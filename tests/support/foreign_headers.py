"""Headers of others' images, drawn by hypothesis: valid WCS of any frame, order of axes, projection and parity."""

import numpy as np
from astropy.io.fits import Header
from hypothesis import strategies as st

FRAMES = {
    "icrs": ("RA--", "DEC-", {"RADESYS": "ICRS"}),
    "fk5": ("RA--", "DEC-", {"RADESYS": "FK5", "EQUINOX": 2000.0}),
    "fk5 of 1975": ("RA--", "DEC-", {"RADESYS": "FK5", "EQUINOX": 1975.0}),
    "fk4": ("RA--", "DEC-", {"RADESYS": "FK4", "EQUINOX": 1950.0, "MJD-OBS": 40000.0}),
    "galactic": ("GLON", "GLAT", {}),
    "unsaid": ("RA--", "DEC-", {}),
}
PROJECTIONS = "TAN", "SIN", "ARC", "ZEA", "STG", "CAR", "AIT", "TAN-SIP"
SIDE = 400.0


@st.composite
def headers(draw):
    lon, lat, more = FRAMES[draw(st.sampled_from(sorted(FRAMES)))]
    projection = draw(st.sampled_from(PROJECTIONS))
    names = [f"{lon}-{projection}"[:12], f"{lat}-{projection}"[:12]]
    at = [draw(st.floats(0, 359)), draw(st.floats(-88, 88))]
    if projection in ("CAR", "AIT"):
        at[1] = 0.0  # a reference off the equator turns the whole sphere
    scale, turn = draw(st.floats(0.03, 2.0)) / 3600, np.radians(draw(st.floats(0, 360)))
    parity = draw(st.sampled_from([-1, 1]))
    matrix = scale * np.array([[parity * np.cos(turn), np.sin(turn)], [-parity * np.sin(turn), np.cos(turn)]])
    swapped = draw(st.booleans()) and not projection.endswith("SIP")
    order = [1, 0] if swapped else [0, 1]
    header = Header({"NAXIS": 2, "NAXIS1": int(SIDE), "NAXIS2": int(SIDE), **more})
    for k, which in enumerate(order, 1):
        header[f"CTYPE{k}"], header[f"CRVAL{k}"] = names[which], at[which]
        header[f"CRPIX{k}"] = draw(st.floats(-2000, 2000))
        for j in (1, 2):
            header[f"CD{k}_{j}"] = matrix[which, j - 1]
    if projection.endswith("SIP"):
        header["A_ORDER"], header["B_ORDER"], header["A_2_0"], header["B_1_1"] = 2, 2, 1e-6, -2e-6
    return header
