"""`csstsim shear` gives m and c of the reduced shear, gamma / (1 - kappa)."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.stages import shear as shear_stage

KAPPA = 0.2


def shapes(gamma, turn, n=4000):
    """{galaxy: (e1, e2)} in a frame: intrinsic shapes, turned by 90 degrees if `turn` is -1, under g exactly."""
    rng = np.random.default_rng(8)
    source = turn * 0.2 * (rng.normal(size=n) + 1j * rng.normal(size=n))
    source = source[abs(source) < 0.8]
    g = gamma / (1 - KAPPA)
    seen = (source + g) / (1 + np.conj(g) * source)
    return [dict(enumerate(np.stack([seen.real, seen.imag], axis=1)))]


def test_convergence_is_in_the_shear_that_shapes_are_compared_with(tmp_path, monkeypatch):
    """m is 0 to 0.01, as pairs leave the square of a shape; it would be 0.25 if gamma were taken for g."""
    gammas = [(0.03, 0.0), (-0.03, 0.0), (0.0, 0.03), (0.0, -0.03)]
    lensings = [(KAPPA, *gamma) for gamma in gammas]
    run = SimpleNamespace(file="a.yaml", config=SimpleNamespace(validation=ValidateConfig()))
    monkeypatch.setattr(shear_stage, "OpenCampaign", lambda file: run)
    monkeypatch.setattr(
        shear_stage, "_twins", lambda runs: {key: [(complex(*key[1:]), turn) for turn in (1, -1)] for key in lensings}
    )
    monkeypatch.setattr(shear_stage, "_shapes_on", lambda twin: shapes(*twin))
    logged = []
    assert shear_stage.shear(["a.yaml"], tmp_path / "out.json", logged.append)
    number = len(shapes(0.0, 1)[0])
    assert f"g = +0.0375, +0.0000: {number} galaxies in both twins" in logged
    fits = json.loads((tmp_path / "out.json").read_text())["fits"]
    assert [fit["m"] for fit in fits] == pytest.approx([0.0, 0.0], abs=0.01)


def twin(name, shapes, gamma=(0.01, 0.03), field="constant", seed=1):
    lensing = SimpleNamespace(field=field, kappa=0.1, gamma1=gamma[0], gamma2=gamma[1])
    catalog = SimpleNamespace(lensing=lensing, shapes=shapes)
    return SimpleNamespace(file=name, config=SimpleNamespace(catalog=catalog), seed=seed)


def test_twins_are_paired_by_their_shear_and_the_turned_one_is_second(monkeypatch):
    monkeypatch.setattr(shear_stage, "_but_shapes", lambda run: run.seed)
    runs = [twin("b", "rotated90"), twin("c", "normal", (0.03, 0.01)), twin("a", "normal"),
            twin("d", "rotated90", (0.03, 0.01))]  # fmt: skip
    found = shear_stage._twins(runs)
    assert {key: [run.file for run in pair] for key, pair in found.items()} == {
        (0.1, 0.01, 0.03): ["a", "b"], (0.1, 0.03, 0.01): ["c", "d"],
    }  # fmt: skip


@pytest.mark.parametrize(("others", "words"), [
    ([], "a: catalog.shapes: has no twin"),
    ([twin("b", "normal")], "b: catalog.shapes: has the same shear and shapes as a"),
    ([twin("b", "rotated90", seed=2)], "a: catalog.shapes: has no twin of the same seed"),
    ([twin("b", "rotated90", (0.03, 0.01))], "a: catalog.shapes: has no twin"),
    ([twin("b", "rotated90", field="none")], r"b: catalog.lensing.field: the shear is not constant \(got 'none'\)"),
])  # fmt: skip
def test_campaigns_that_are_no_twins_are_refused(monkeypatch, others, words):
    monkeypatch.setattr(shear_stage, "_but_shapes", lambda run: run.seed)
    with pytest.raises(InputError, match=words):
        shear_stage._twins([twin("a", "normal"), *others])


@pytest.mark.parametrize(("limits", "passes"), [((1e-2, 1e-2), True), ((None, None), True), ((1e-2, None), True)])
def test_each_value_has_its_own_error_and_what_is_not_evaluated_does_not_fail(tmp_path, monkeypatch, limits, passes):
    """The second axis is noisier than the first: shapes along it are measured with fifty times the noise."""
    gammas = [(0.03, 0.0), (-0.03, 0.0), (0.0, 0.03), (0.0, -0.03)]
    config = ValidateConfig(shear_m_max=limits[0], shear_c_max=limits[1])
    run = SimpleNamespace(file="a.yaml", config=SimpleNamespace(validation=config))
    monkeypatch.setattr(shear_stage, "OpenCampaign", lambda file: run)
    twins = {(KAPPA, *gamma): [(complex(*gamma), turn) for turn in (1, -1)] for gamma in gammas}
    monkeypatch.setattr(shear_stage, "_twins", lambda runs: twins)

    def seen(twin):
        noise = np.random.default_rng(int(1e4 * abs(twin[0] + 1)) + twin[1]).normal(size=(4000, 2)) * (0.001, 0.05)
        return [{k: e + noise[k] for k, e in shapes(*twin)[0].items()}]

    monkeypatch.setattr(shear_stage, "_shapes_on", seen)
    logged = []
    assert shear_stage.shear(["a.yaml"], tmp_path / "out.json", logged.append) is passes
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["fits"][1]["m_err"] > 3 * found["fits"][0]["m_err"]
    said = {line.split(" = ")[0]: line for line in logged if "+-" in line}
    values = {f"{name}{axis + 1}": fit for axis, fit in enumerate(found["fits"]) for name in "mc"}
    assert len(said) == len([gate for gate in found["gates"] if gate["value"] is not None]) > 0
    for name, line in said.items():
        fit = values[name.split()[1]]
        assert f" +- {fit[name.split()[1][0] + '_err']:.4f}, " in line


def test_twins_are_equal_in_all_but_their_shapes(tmp_path):
    """Real campaigns: of another universe, seed or pointing they are no twins; the name of the output is no matter."""
    lensing = {"field": "constant", "gamma1": 0.02}

    def opened(name, shapes, galaxies=None, rows=POINTINGS[:1], **changes):
        catalog = {"lensing": lensing, "structure": "none", "shapes": shapes}
        file = write_campaign(tmp_path / name, rows, catalog=catalog, **changes)
        if galaxies:
            path = tmp_path / name / "universe" / "galaxies.yaml"
            path.write_text(path.read_text().replace(*galaxies))
        return OpenCampaign(file)

    normal, rotated = opened("a", "normal"), opened("b", "rotated90")
    assert list(shear_stage._twins([rotated, normal]).values()) == [(normal, rotated)]
    others = [
        opened("c", "rotated90", galaxies=("value: 20.0", "value: 21.0")), opened("d", "rotated90", seed=4),
        opened("e", "rotated90", rows=POINTINGS[1:2]),
    ]  # fmt: skip
    for other in others:
        with pytest.raises(InputError, match="has no twin of the same seed"):
            shear_stage._twins([normal, other])
