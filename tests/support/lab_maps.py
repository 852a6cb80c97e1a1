"""Laboratory maps for tests, written as docs/lab_maps.md says."""

import numpy as np
import yaml
from astropy.io import fits

SOURCE = {"source": "made up for tests", "confidence": "E"}
NAMES = {
    "led_flats": "maps/led_{led}_{chip}.fits", "prnu": "maps/prnu_{chip}.fits",
    "bad_pixels": "maps/bad_{chip}.fits", "bias": "maps/bias_{chip}.fits",
}  # fmt: skip


def name_maps(instrument, *kinds, **more):
    """Write maps.yaml of an instrument folder, with some kinds; more: {kind: {key: value}} in addition."""
    entries = {kind: {"files": NAMES[kind]} | SOURCE | more.get(kind, {}) for kind in kinds}
    (instrument / "maps.yaml").write_text(yaml.safe_dump(entries))


def write_map(path, values, **keywords):
    """Write a map as a user would: astropy, checksum=True, DATAMAX; keywords: further ones, None to leave one out."""
    path.parent.mkdir(exist_ok=True)
    hdu = fits.PrimaryHDU(values)
    hdu.header["DATAMAX"] = float(np.max(values[np.isfinite(values)]))
    for name, value in keywords.items():
        if value is None:
            del hdu.header[name]
        else:
            hdu.header[name] = value
    hdu.writeto(path, checksum=True, overwrite=True)


def map_path(instrument, kind, chip, led=0):
    return instrument / NAMES[kind].format(chip=f"{chip:02d}", led=f"{led:g}")


def response(shape, seed=1, rms=0.02):
    """Return float32 (ny, nx): 1 + rms z, clipped to 4 sigma; its mean is within the contract."""
    z = np.random.default_rng(seed).standard_normal(shape)
    return (1 + rms * np.clip(z, -4, 4)).astype(np.float32)
