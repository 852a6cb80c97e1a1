"""A whole campaign small enough for a test: tiny chips, a thinned universe or a catalogue of known stars."""

import shutil
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from astropy.table import Table
from build_distortion import build

from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ab_photon_density
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject
from csstsim.instrument.filter import GRID
from support.mini import mini_camera

HEADER = "obsid,type,ra,dec,pa,time,exptime"
POINTINGS = (
    "10100000001,SCIE,60.15,-40.0,-113.4333,2027-11-20T01:08:00,150",
    "10100000002,SCIE,60.1505,-40.0003,20.0,2027-11-20T01:12:00,150",
    "10300000001,BIAS,0,0,0,2027-11-20T02:00:00,0",
)
THIN = 20.0  # galaxies per arcmin2, instead of 552
# Drawing the cosmic field of a brick takes ten times its thin objects' time
SKY = {"lensing": {"field": "none"}, "structure": "none"}


def write_campaign(folder, pointings=POINTINGS, geometry=None, **changes):
    """Write a campaign on tiny chips (128 x 128 active pixels unless `geometry` says otherwise); return its file."""
    folder = Path(folder)
    geometry = {"nx": 128, "ny": 128, "channel_nx": 16, "channel_ny": 64} | (geometry or {})
    instrument = mini_camera(folder, **geometry)
    (instrument / "distortion.fits").write_bytes(_distortion(tuple(geometry.items())))
    universe = shutil.copytree(SHIPPED / "universe", folder / "universe", dirs_exist_ok=True)
    (universe / "galaxies.yaml").write_text(_thin_galaxies())
    (folder / "table.csv").write_text("\n".join([HEADER, *pointings]) + "\n")
    campaign = {
        "schema_version": 1, "name": "mini", "seed": 3,
        "survey_table": str(folder / "table.csv"), "output": str(folder / "out"),
        "instrument": str(instrument), "universe": str(universe),
        "select": {"types": ["SCIE"], "chips": [9]}, "psf": {"grid": 2},
    }  # fmt: skip
    if "kind" not in changes.get("catalog", {}):
        changes["catalog"] = SKY | changes.get("catalog", {})
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(campaign | changes))
    return path


@cache
def _distortion(geometry):
    """Return the file fitted to a geometry, once in a process: the shipped one fits the real layout only."""
    with tempfile.TemporaryDirectory() as folder:
        instrument = mini_camera(folder, **dict(geometry))
        build(instrument, nodes=8, margin=300.0)
        return (instrument / "distortion.fits").read_bytes()


@cache
def _thin_galaxies():
    galaxies = yaml.safe_load((SHIPPED / "universe" / "galaxies.yaml").read_text())
    galaxies["density"]["value"] = THIN
    return yaml.safe_dump(galaxies)


def write_scene(folder, kind, x, y, mag, chip=9, pointing=POINTINGS[0], **changes):
    """Write a campaign of one exposure whose catalogue (`kind`, a class below) has objects at pixels x, y of a chip."""
    from csstsim.campaign.opened import OpenCampaign

    changes = {"select": {"types": ["SCIE"], "chips": [chip]}} | changes
    job = OpenCampaign(write_campaign(folder, [pointing], **changes)).job(pointing.split(",")[0], chip)
    ra, dec = icrs(*job.wcs.pixel_to_world(np.asarray(x, float), np.asarray(y, float)), job.observer)
    options = {"ra": ra.tolist(), "dec": dec.tolist(), "mag": [float(mag)] * len(ra)}
    return write_campaign(
        folder, [pointing], catalog={"kind": f"support.mini_campaign:{kind}", "options": options}, **changes
    )


class Stars(CatalogBase):
    """Stars of constant AB magnitude at given places: options ra, dec, mag (lists)."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        places = zip(self.options["ra"], self.options["dec"], self.options["mag"], strict=True)
        self.objs = [MockObject(id=i, type="star", ra=ra, dec=dec, mag=mag) for i, (ra, dec, mag) in enumerate(places)]

    def load_sed(self, obj):
        return Table({"WAVELENGTH": GRID, "FLUX": ab_photon_density(GRID, obj.mag)})

    def load_norm_filt(self, obj):
        return None


class Emitters(Stars):
    """A star, and a small galaxy with [OII] of PHOTONS / s / m2."""

    Z, PHOTONS = 0.35, 20.0

    def _load(self):
        super()._load()
        one, other = self.objs
        galaxy = {"z": self.Z, "size_disk": 0.1, "mag": other.mag}
        self.objs = [one, MockObject(id=1, type="galaxy", ra=other.ra, dec=other.dec, **galaxy)]

    def load_sed(self, obj):
        flux, off = ab_photon_density(GRID, obj.mag), GRID - 3728.48 * (1 + self.Z)
        if obj.type == "galaxy":
            flux = flux + self.PHOTONS * np.exp(-0.5 * off**2) / np.sqrt(2 * np.pi)
        return Table({"WAVELENGTH": GRID, "FLUX": flux})


class Hungry(Stars):
    """Takes `mb` of memory for three seconds before it loads (option mb)."""

    def _load(self):
        ballast = np.ones((self.options["mb"], 2**20), np.uint8)
        time.sleep(3.0)
        del ballast
        super()._load()


class Movers(Stars):
    """Every other star moves, faster than a merge follows for half a year, and is near."""

    def _load(self):
        super()._load()
        moving = {"pmra": 250.0, "pmdec": -150.0, "parallax": 12.0, "rv": 40.0}
        self.objs = [MockObject(type="star", **obj.values, **(moving if obj.id % 2 else {})) for obj in self.objs]


class Spectra(Stars):
    """Three stars with spectra that differ: flat in frequency, a 4000 K black body, a power law with a line."""

    def load_sed(self, obj):
        return Table({"WAVELENGTH": GRID, "FLUX": spectrum(obj.id)})


class Pair(Stars):
    """A star (the first place) and galaxies (the others): bulge and disk, elliptical, lensed."""

    def _load(self):
        star, *rest = zip(self.options["ra"], self.options["dec"], self.options["mag"], strict=True)
        shape = {
            "size_disk": 0.4,
            "size_bulge": 0.25,
            "bulge_frac": 0.3,
            "e1": 0.2,
            "e2": -0.1,
            "gamma1": 0.03,
            "kappa": 0.05,
        }
        self.objs = [MockObject(id=0, type="star", ra=star[0], dec=star[1], mag=star[2])] + [
            MockObject(id=i, type="galaxy", ra=ra, dec=dec, mag=mag, **shape)
            for i, (ra, dec, mag) in enumerate(rest, 1)
        ]


class Twins(Pair):
    """A star and galaxies, one of a magnitude more, the others of 3.5, so faint that electrons are drawn one by one.

    The last two have one id.
    """

    def _load(self):
        super()._load()
        for i, obj in enumerate(self.objs):
            kind = "star" if i == 0 else "galaxy"
            changes = {"mag": obj.mag + (0.0, 1.0, 3.5, 3.5)[i], "id": min(i, len(self.objs) - 2)}
            self.objs[i] = MockObject(type=kind, **(obj.values | changes))


def spectrum(kind):
    """Photon density [photon / s / m2 / angstrom] on GRID of one of the three spectra."""
    if kind == 0:
        return ab_photon_density(GRID, 18.0)
    if kind == 1:
        return 60.0 * (GRID / 6000) ** -4 / np.expm1(1.438777e8 / (GRID * 4000.0))
    return 2.0 * (GRID / 6000) ** -1.2 + 5.0 * np.exp(-0.5 * ((GRID - 6300.0) / 15.0) ** 2)
