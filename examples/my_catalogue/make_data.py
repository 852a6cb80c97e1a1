"""Make the data of the example: python make_data.py [FOLDER]. Stands in for a table and spectra of your own.

Ten stars and ten galaxies (r = 19 to 23 in the SDSS system) around the field of the demo campaign, a quasar, and a star
whose spectrum is absolute.
"""

import sys
from pathlib import Path

import numpy as np

CENTRE = 60.1172, -40.0330  # deg
HALF_SIDE = 15.0 / 3600  # deg
WAVE = np.geomspace(500.0, 12000.0, 2000)  # angstrom
COLUMNS = "id,type,ra,dec,z,mag_norm,filter,spectrum,size_disk,size_bulge,bulge_frac,e1,e2"


def black_body(kelvin):
    """f_lambda of a black body, 1e-15 erg / s / cm2 / A at 5500 A."""
    shape = [w**-5.0 / np.expm1(1.438777e8 / (w * kelvin)) for w in (WAVE, 5500.0)]
    return 1e-15 * shape[0] / shape[1]


def main(folder):
    """Write objects.csv and its spectra into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    line = np.exp(-0.5 * ((WAVE - 2800.0) / 30.0) ** 2)
    spectra = {
        "sun.csv": black_body(5772.0),
        "dwarf.csv": black_body(3500.0),
        "old.csv": black_body(4500.0) * np.where(WAVE < 4000.0, 0.5, 1.0),
        "young.csv": 1e-15 * (WAVE / 5500.0) ** -1.5,
        "quasar.csv": 1e-15 * (WAVE / 5500.0) ** -1.6 * (1 + 2 * line),
    }
    for name, flux in spectra.items():
        np.savetxt(folder / name, np.stack([WAVE, flux], 1), "%.6g", ",", header="wavelength,f_lambda", comments="")
    rng = np.random.default_rng(1)
    rows = [COLUMNS]
    for i in range(1, 23):
        ra, dec = (c + d for c, d in zip(CENTRE, rng.uniform(-HALF_SIDE, HALF_SIDE, 2), strict=True))
        place = f"{ra:.7f},{dec:.7f}"
        mag, (e1, e2) = rng.uniform(19.0, 23.0), rng.normal(0.0, 0.15, 2)
        if i <= 10:
            rows.append(f"{i},star,{place},,{mag:.3f},sdss2010_r.csv,{('sun', 'dwarf')[i % 2]}.csv,,,,,")
        elif i <= 20:
            shape = f"{rng.uniform(0.2, 0.8):.3f},{rng.uniform(0.1, 0.3):.3f},{rng.uniform():.3f},{e1:.3f},{e2:.3f}"
            kind = ("old", "young")[i % 2]
            rows.append(f"{i},galaxy,{place},{rng.uniform(0.1, 1.5):.4f},{mag:.3f},sdss2010_r.csv,{kind}.csv,{shape}")
        elif i == 21:
            rows.append(f"{i},quasar,{place},1.8,20.5,sdss2010_r.csv,quasar.csv,,,,,")
        else:
            rows.append(f"{i},star,{place},,,,sun.csv,,,,,")
    (folder / "objects.csv").write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "data")
