"""Which objects of a catalogue are known under spectra, whose entries they are, and what their light is."""

import numpy as np
import pytest
from support.commands import command
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.table import ASTEROID, GALAXY, QUASAR, SATELLITE, STAR, ObjectTable
from csstsim.measure.spectra.extract import Sources
from csstsim.measure.spectra.line_profile import Shapes
from csstsim.stages.parts.contamination import catalogued_light, check_contamination

OBSID, CHIP = "10100000001", 29
EDGES = np.arange(6000.0, 10500.0, 25.0)
BANDS = "nuv", "u", "g", "r", "i", "z", "y"


def opened(folder, **contamination):
    select = {"types": ["SCIE"], "chips": [CHIP]}
    measurement = {"contamination": {"known_from": "catalogue"} | contamination}
    return OpenCampaign(write_campaign(folder, [POINTINGS[0]], select=select, measurement=measurement))


def light_of(run, truth, orders):
    sources = Sources(Shapes.points(len(truth)), None, EDGES)
    settings = run.config.measurement.contamination
    return catalogued_light(run, run.job(OBSID, CHIP), truth, sources, orders, "MODEL", settings)


def test_known_are_fixed_objects_whose_brightest_band_is_within_the_depth(tmp_path):
    """A spectrum of one band is flat in frequency: its photons are those of an AB magnitude, in closed form."""
    run = opened(tmp_path, depth=22.0)
    kinds = [STAR, GALAXY, QUASAR, STAR, ASTEROID, SATELLITE, GALAXY]
    truth = ObjectTable({"obj_type": np.array(kinds)} | {f"mag_{band}": np.full(len(kinds), np.nan) for band in BANDS})
    truth["mag_i"][:] = 21.0, 22.5, 22.0, 22.01, 15.0, 10.0, np.nan
    truth["mag_r"][1] = 21.9  # in its brightest band
    rows = np.repeat(np.arange(len(kinds)), 2)
    orders = ObjectTable({"row": rows, "order": np.tile([0, 1], len(kinds)), "id": 100 - rows})
    light = light_of(run, truth, orders)
    assert light.owner.tolist() == [0, 1, 2, -1, -1, -1, -1]
    assert light.orders["row"].tolist() == [0, 0, 1, 1, 2, 2] and light.orders["order"].tolist() == [0, 1] * 3
    assert light.model == "MODEL" and light.sources.edges is EDGES
    middle = 0.5 * (EDGES[1:] + EDGES[:-1])
    for row, mag in ((0, 21.0), (2, 22.0)):
        photons = light.sources.spectra(np.array([row]), EDGES)[0]
        np.testing.assert_allclose(photons, ab_photon_density(middle, mag), rtol=1e-4)


def test_a_catalogue_whose_objects_are_all_too_faint_is_refused(tmp_path):
    run = opened(tmp_path, depth=20.0)
    truth = ObjectTable({"obj_type": np.array([STAR])} | {f"mag_{band}": np.array([20.5]) for band in BANDS})
    with pytest.raises(InputError, match=r"no object whose light reaches the chip \(got 'truth to 20 mag'\)"):
        light_of(run, truth, ObjectTable({"row": np.array([0, 0])}))


def test_a_table_of_neighbours_is_opened_by_check(tmp_path):
    """Without spectra, it is not read."""
    for text, said in ((None, "no such file"), ("id,ra\n1,10\n", "dec")):
        if text:
            (tmp_path / "known.csv").write_text(text)
        with pytest.raises(InputError, match=said):
            check_contamination(opened(tmp_path, table=str(tmp_path / "known.csv")))
        found = command("check", tmp_path / "campaign.yaml")
        assert found.exit_code == 2 and said in found.stderr
    check_contamination(opened(tmp_path, depth=20.0))
    measurement = {"contamination": {"known_from": "catalogue", "table": str(tmp_path / "known.csv")}}
    check_contamination(OpenCampaign(write_campaign(tmp_path, [POINTINGS[0]], measurement=measurement)))


def test_an_object_owns_the_entry_of_a_table_within_0_3_arcsec(tmp_path):
    """Entries that are not rendered have no light, and none of the others takes their place."""
    x, y = np.array([20.3, 90.1, 60.0, 110.0]), np.array([30.2, 70.6, 110.0, 20.5])
    job = opened(tmp_path).job(OBSID, CHIP)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    kinds = ["star,,0.0"] * 4
    kinds[1] = "galaxy,0.3,1.5"  # no thin shear
    lines = [f"{k + 1},{ra[k]:.9f},{dec[k]:.9f},18,{kinds[k]}" for k in range(4)]
    (tmp_path / "known.csv").write_text("\n".join(["id,ra,dec,mag_i,type,size,kappa", *lines]) + "\n")
    run = opened(tmp_path, table=str(tmp_path / "known.csv"))
    reach = 0.3 / run.camera.telescope.pixel_scale  # px
    nearly = np.array([0.9, 0.0, 1.1, -0.6]) * reach
    truth = ObjectTable({
        "x": np.append((x + nearly)[::-1], np.nan), "y": np.append(y[::-1], 30.2), "obj_type": np.full(5, STAR),
    })  # fmt: skip
    light = light_of(run, truth, ObjectTable({"row": np.zeros(0, int)}))
    assert (light.owner >= 0).tolist() == [True, False, False, True, False]
    for object_row, entry in ((0, 3), (3, 0)):
        mine = light.orders["row"] == light.owner[object_row]
        assert mine.any() and np.abs(light.orders["x"][mine] - x[entry]).max() < 1e-2
        assert np.abs(light.orders["y"][mine] - y[entry]).max() < 1e-2
    assert len(set(zip(light.orders["x"].round(1), light.orders["y"].round(1), strict=True))) == 3
    photons = light.sources.spectra(light.owner[[0]], EDGES)[0]
    np.testing.assert_allclose(photons, ab_photon_density(0.5 * (EDGES[1:] + EDGES[:-1]), 18.0), rtol=1e-4)
