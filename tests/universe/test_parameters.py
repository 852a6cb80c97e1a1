"""The numbers of a universe folder of one's own: what is missing, no number, or does not fit the spectra is refused."""

import copy
import shutil
from functools import reduce
from operator import getitem

import healpy
import pytest
from support.embedded_sky import shipped

from csstsim.base.errors import InputError
from csstsim.base.healpix import NSIDE
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import Lensing
from csstsim.catalog.truth_bricks import make_brick
from csstsim.universe.changing.numbers import KINDS, digest_of, file_of, number_error, numbers_of
from csstsim.universe.parameters import Universe, load_universe


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("virial", None, r"virial: missing"),
        ("line_scatter", float("nan"), r"line_scatter: must be a number"),
        ("line_scatter", "x", r"line_scatter: must be a number"),
        ("dust.scatter", float("inf"), r"dust.scatter: must be a number"),
        ("dust.cubic", [0.345, float("nan"), 0.0, 0.0], r"dust.cubic\[1\]: must be a number"),
        ("dust.max", -1.0, r"dust.max: impossible"),
        ("dust", 1.0, r"dust: must be a mapping"),
        ("lines.strength", 0.9, r"lines.strength: galaxy_spectra.fits has other lines.*0.21"),
    ],
)
def test_wrong_numbers_are_refused(key, value, message):
    universe = shipped()[0]
    numbers = copy.deepcopy(universe.numbers)
    *way, last = key.split(".")
    inner = reduce(getitem, way, numbers["galaxies"])
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    with pytest.raises(InputError, match=rf"galaxies.yaml: {message}"):
        Universe(universe.folder, numbers).check()


def test_the_shipped_numbers_pass():
    shipped()[0].check()


def test_a_brick_with_too_many_stars_names_the_own_folder(tmp_path):
    universe, camera = shipped()
    numbers = copy.deepcopy(universe.numbers)
    numbers["stars"]["limits"][1] = 40.0
    pix = int(healpy.ang2pix(NSIDE, 266.4, -29.0, nest=True, lonlat=True))  # the Galactic centre
    with pytest.raises(InputError, match=rf"{tmp_path}/stars.yaml: limits: brick {pix} would hold .* stars"):
        make_brick(1, pix, Universe(tmp_path, numbers), camera, Lensing(), "none")


def changed(key, value):
    """The shipped universe with another number at `key`, whose first word is the file."""
    universe = shipped()[0]
    numbers = copy.deepcopy(universe.numbers)
    *way, last = key.split(".")
    reduce(getitem, way, numbers)[last] = value
    return Universe(universe.folder, numbers)


@pytest.mark.parametrize("key", [
    "dust.r_v", "dust.sfd_scale", "dust.height", "dust.reach", "dust.optical_depth.per_tau", "stars.sun.r0",
    "galaxies.density", "galaxies.virial", "galaxies.dust.max", "galaxies.mass_function.z_max",
    "lensing.stretch_max", "occupation.stellar_to_halo.scatter", "occupation.satellites.concentration",
    "occupation.satellites.dispersion", "occupation.satellites.axis_ratio", "occupation.surviving.most",
    "occupation.quenching.most", "lensing.shells", "cosmology.h0", "cosmology.omega_m",
])  # fmt: skip
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_numbers_that_must_be_above_zero(key, value):
    part, _, inside = key.partition(".")
    with pytest.raises(InputError, match=rf"{part}\.yaml: {inside}: impossible .*allowed: above 0"):
        changed(key, value).check()


@pytest.mark.parametrize("key, value, message", [
    ("stars.limits", [28.0, 28.0], "two rising numbers"), ("quasars.redshift", [6.0, 0.1], "two rising numbers"),
    ("quasars.m1450", [-18.0, -31.0], "two rising numbers"), ("dust.sfd_scale", 10.1, "up to 10"),
    ("galaxies.mass_function.z_max", 20.1, "up to 20"), ("occupation.satellites.axis_ratio", 1.01, "up to 1"),
    ("occupation.surviving.most", 1.01, "up to 1"), ("occupation.quenching.most", 1.01, "up to 1"),
    ("stars.laws.young", [1.0], "numbers"), ("stars.laws.disc", [5.0, 0.0], "lengths above 0 kpc"),
    ("stars.laws.thick", [2.5, -0.8, 0.4], "lengths above 0 kpc"), ("stars.laws.young", [5.0, 0.0], "lengths above 0"),
    ("stars.laws.flare", [9.5, 10.1], "a growth from 0 to 10"), ("stars.laws.flare", [8.4, 0.1], "a radius from 8.5"),
    ("galaxies.lines.dust", 9.0, "build it again"),
    ("cosmology.omega_m", 1.2, r"cosmology\.yaml: omega_m: impossible .got 1.2.; allowed: above 0, up to 1"),
    ("cosmology.omega_lambda", 0.9, r"cosmology\.yaml: omega_lambda: impossible .got 0.9.; allowed: 1 - omega_m = 0"),
])  # fmt: skip
def test_numbers_beyond_their_limits(key, value, message):
    with pytest.raises(InputError, match=message):
        changed(key, value).check()


def test_numbers_at_their_limits_pass():
    universe = changed("dust.sfd_scale", 10.0)
    universe.numbers["occupation"]["quenching"]["most"], universe.numbers["stars"]["laws"]["flare"] = 1.0, [8.5, 0.0]
    universe.check()


def test_the_digest_is_of_the_folder_and_of_the_dust(tmp_path):
    """Another number, and another map, wherever it lies."""
    folder = shutil.copytree(SHIPPED / "universe", tmp_path / "universe")
    first = load_universe(folder).digest
    assert load_universe(SHIPPED / "universe").digest == first == load_universe(folder).digest and len(first) == 16
    text = (folder / "dust.yaml").read_text()
    (folder / "dust.yaml").write_text(text.replace("map: sfd", f"map: {tmp_path / 'other.fits'}"))
    shutil.copy(SHIPPED / "universe" / "dust_map.fits", tmp_path / "other.fits")
    moved = load_universe(folder).digest
    assert moved != first
    with open(tmp_path / "other.fits", "ab") as file:
        file.write(b" ")
    assert load_universe(folder).digest not in (first, moved)


def test_faults_name_the_file_of_this_universe(tmp_path):
    universe = Universe(tmp_path, shipped()[0].numbers)
    with pytest.raises(InputError) as caught, universe.faults_of("stars"):
        raise InputError("too many", file="elsewhere", key="limits", value=3, allowed="less")
    error = caught.value
    assert (error.message, error.key, error.value, error.allowed) == ("too many", "limits", 3, "less")
    assert str(error).startswith(f"{tmp_path}/stars.yaml")


def test_fields_are_made_once_for_a_seed(tmp_path):
    universe = shipped()[0]
    assert universe.r_v == 3.1 and universe.extinction.shape == (18001,)
    for part, make in (("lensing", "lensing_field"), ("structure", "matter_field")):
        broken = changed("lensing.z_max", -1.0)
        with pytest.raises(InputError, match=rf"{part}\.yaml: no "):
            getattr(broken, make)(1)


def test_numbers_of_what_changes_are_the_folder_s_own_or_the_shipped(tmp_path):
    """A file of one's own for one kind; the others as shipped, each with its own digest."""
    own = tmp_path / "asteroids.yaml"
    own.write_text("faintest: {value: 20.0, source: own, confidence: E}\n")
    assert file_of(tmp_path, "asteroids") == own and numbers_of(tmp_path, "asteroids") == {"faintest": 20.0}
    assert file_of(tmp_path, "satellites") == SHIPPED / "changing" / "satellites.yaml"
    assert numbers_of(tmp_path, "satellites")["growth"] == 1.0
    assert KINDS == ("variable_stars", "variable_quasars", "asteroids", "satellites")
    changed, shipped = (digest_of(folder, KINDS) for folder in (tmp_path, SHIPPED / "universe"))
    assert [kind for kind in KINDS if changed[kind] != shipped[kind]] == ["asteroids"]
    assert len(set(changed.values())) == 4
    assert digest_of(tmp_path, ("asteroids",)) == {"asteroids": changed["asteroids"]}
    assert (
        str(number_error(tmp_path, "asteroids", KeyError("a"))) == f"{own}: a number is missing or wrong: KeyError 'a'"
    )
