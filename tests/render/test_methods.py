"""The registers of drawing methods: what each method must have so that the policy and the truth table can use it."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from render.test_error_model import drawing_of, lit, scene

from csstsim.base.errors import InputError
from csstsim.render.imaging.register import METHODS as IMAGING
from csstsim.render.method import NOT_RENDERED, Targets, names_of
from csstsim.render.policy import choose
from csstsim.render.settings import FILE, load_cost, load_numbers
from csstsim.render.slitless.register import METHODS as SLITLESS

REGISTERS = pytest.mark.parametrize("methods", [IMAGING, SLITLESS], ids=["imaging", "slitless"])


def modules():
    """Return the modules of all methods."""
    return {sys.modules[method.draw.__module__] for method in (*IMAGING, *SLITLESS)}


@REGISTERS
def test_codes_and_names_tell_methods_apart(methods):
    codes, names = [m.code for m in methods], [m.name for m in methods]
    assert len(set(codes)) == len(set(names)) == len(methods)
    assert all(NOT_RENDERED < code < 128 for code in codes) and all(0 < len(name) <= 10 for name in names)
    assert names_of(np.array([NOT_RENDERED, *codes]), methods).tolist() == ["none", *names]


def test_codes_and_names_of_the_truth_table():
    assert {m.code: m.name for m in IMAGING} == {1: "unresolved", 2: "photons", 3: "stamp"}
    assert {m.code: m.name for m in SLITLESS} == {2: "photons", 3: "slabs"}


@REGISTERS
@pytest.mark.parametrize("count", [0, 3])
def test_functions_return_a_value_for_each_object(methods, count, disperser):
    objects = lit(scene(np.ones(count), 0.3), np.full(count, 1e3))
    targets = Targets(objects, drawing_of(), 1.1, disperser if methods is SLITLESS else None)
    for method in methods:
        for function in (method.allowed, method.cost, method.error):
            assert function(targets).shape == (count,), (method.name, function)
        assert method.allowed(targets).dtype == bool and (method.cost(targets) > 0).all()


@REGISTERS
@pytest.mark.parametrize("fidelity", ["preview", "standard", "noise_free"])
def test_some_method_may_render_each_object(methods, fidelity, disperser):
    """A star and a galaxy, faint and bright, of a PSF with negative weights."""
    objects = lit(scene([0.0, 1.0, 0.0, 1.0], 0.3), [1.0, 1.0, 1e12, 1e12])
    targets = Targets(objects, drawing_of(fidelity, convex=False), 1.0, disperser if methods is SLITLESS else None)
    assert np.any([method.allowed(targets) for method in methods if not method.preferred], axis=0).all()


def test_each_constant_of_the_file_is_of_a_method():
    costs = [module.Cost for module in modules() if hasattr(module, "Cost")]
    assert {name for cost in costs for name in cost.model_fields} == load_numbers().cost.keys()
    for cost in costs:
        assert load_cost(cost).model_dump() == {name: load_numbers().cost[name] for name in cost.model_fields}


def test_a_constant_that_is_missing_is_named(tmp_path):
    file = tmp_path / "render.yaml"
    file.write_text(FILE.read_text(encoding="utf-8").replace("photon_star:", "photon_stars:"), encoding="utf-8")
    cost = sys.modules["csstsim.render.imaging.methods.photons"].Cost
    with pytest.raises(InputError, match=r"render\.yaml.*cost\.photon_star"):
        load_cost(cost, file)


def of(name, code, cost, error, allowed=True, preferred=False):
    """Return a method for the policy whose functions return constants, one for each of two objects."""
    cost, error, allowed = (np.broadcast_to(value, 2).copy() for value in (cost, error, allowed))
    return SimpleNamespace(
        name=name, code=code, preferred=preferred,
        allowed=lambda _: allowed, cost=lambda _: cost, error=lambda _: error,
    )  # fmt: skip


def test_the_policy_takes_the_cheapest_method_that_is_accurate_enough():
    targets = Targets(lit(scene([0.0, 0.0], 0.0), [100.0, 100.0]), drawing_of())  # eps is 0.1

    def chosen(*methods):
        choice = choose(targets, methods)
        return choice.method.tolist(), choice.error.tolist()

    cheap, exact = of("cheap", 5, 1.0, [0.05, 0.2]), of("exact", 6, 9.0, 0.01)
    assert chosen(cheap, exact) == chosen(exact, cheap) == ([5, 6], [0.05, 0.01])
    assert chosen(cheap, of("worse", 7, 9.0, 0.15)) == ([5, 5], [0.05, 0.2])  # within three times the smallest error
    assert chosen(of("limited", 7, 0.5, 0.0, [False, True]), cheap) == ([5, 7], [0.05, 0.0])
    assert chosen(of("first", 7, 1.0, 0.0), of("last", 8, 1.0, 0.0))[0] == [8, 8]  # of equal cost
    assert chosen(of("preferred", 7, 99.0, 3.0, [True, False], preferred=True), cheap) == ([7, 5], [3.0, 0.2])
    dark = Targets(lit(scene([0.0, 0.0], 0.0), [0.0, 100.0]), drawing_of())
    assert choose(dark, [of("all", 7, 1.0, 0.0, preferred=True), cheap]).method.tolist() == [NOT_RENDERED, 7]
