"""Contradictions between the keys of a plan of a budget of shear; each error names the key to change."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError
from csstsim.base.model import validate
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.simulation.observation import changed_layers
from csstsim.simulation.sim_steps import SimSteps

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.studies.budget.shear.plan import Setting, ShearPlan

LAYERS = SHIPPED / "observations" / "science.yaml"  # the list whose layers a Setting changes


def check_plan(plan: ShearPlan, file: PathLike, base: str, everything: str) -> None:
    """Raise InputError for the first fault of a plan.ShearPlan; base, everything: names that no effect can have."""
    _check_grid(plan, file)
    _check_chips(plan, file)
    _check_names(plan, file)
    _check_setting(plan, plan.base, {"layers": plan.base.layers}, file, "base")
    for name, effect in plan.effects.items():
        if name in (base, everything):
            raise InputError("an effect cannot have this name", file=file, key=f"effects.{name}", value=name)
        _check_against(plan, name, file, base)
        key = f"effects.{name}.change"
        if not isinstance(effect.change.get("layers", {}), dict | None):
            raise InputError("must be a mapping", file=file, key=f"{key}.layers", value=effect.change["layers"])
        setting = validate(type(plan.base), plan.changed(effect.change), file, (key,))
        _check_setting(plan, setting, effect.change, file, key)
    _check_sum(plan, file)
    validate(type(plan.base), plan.changed(plan.summed_change), file, ("effects, all of the sum at once",))


def check_bars(plan: ShearPlan, file: PathLike) -> None:
    """Raise InputError for a plan without a bar, or with an effect in the sum that is none; a blind run needs none."""
    if not plan.bars:
        allowed = "one or more that do not have bar: false"
        raise InputError("no effect is a bar", file=file, key="effects", value=list(plan.effects), allowed=allowed)
    for name in plan.summed:
        if name not in plan.bars:
            raise InputError(
                "an effect of the sum is no bar",
                file=file,
                key=f"effects.{name}.bar",
                value=False,
                allowed="true, or sum: false",
            )


def _check_grid(plan: ShearPlan, file: PathLike) -> None:
    if plan.stamp % 2 or plan.stamp > plan.spacing:
        raise InputError("cannot be", file=file, key="stamp", value=plan.stamp, allowed=f"even, at most {plan.spacing}")
    if plan.cells < 2:
        allowed = f"a side of two positions and more; spacing is {plan.spacing}"
        raise InputError("no room for a ring of four galaxies", file=file, key="size", value=plan.size, allowed=allowed)


def _check_chips(plan: ShearPlan, file: PathLike) -> None:
    """Raise InputError for chips that the camera lacks, chips of several bands, or windows larger than a chip."""
    camera = load_camera()
    chips = [camera.chips[number] for number in plan.chips if number in camera.chips]
    if len(chips) < len(plan.chips) or any(chip.kind != "imaging" or chip.filter != chips[0].filter for chip in chips):
        raise InputError(
            "the plan's chips are not imaging chips of one band",
            file=file,
            key="chips",
            value=list(plan.chips),
            allowed="as 9, 22 in r",
        )
    largest = min(camera.detector.nx, camera.detector.ny)
    if plan.size > largest:
        raise InputError(
            "a window larger than the chip", file=file, key="size", value=plan.size, allowed=f"to {largest}"
        )


def _check_names(plan: ShearPlan, file: PathLike) -> None:
    if len(set(plan.estimators)) < len(plan.estimators):
        raise InputError("an estimator is named twice", file=file, key="estimators", value=list(plan.estimators))
    for name in plan.samples:
        if not re.fullmatch(r"[\w-]+", name):  # it is part of the names of files
            raise InputError(
                "no name for a sample", file=file, key="samples", value=name, allowed="letters, digits, _-"
            )


def _check_against(plan: ShearPlan, name: str, file: PathLike, base: str) -> None:
    """Raise InputError for an effect against an unknown one, or in a circle of effects against each other."""
    chain = [name]
    while (other := plan.effects[chain[-1]].against) != base:
        key = f"effects.{chain[-1]}.against"
        if other not in plan.effects:
            allowed = ", ".join([base, *plan.effects])
            raise InputError("no such effect", file=file, key=key, value=other, allowed=allowed)
        if other in chain:
            circle = " against ".join([*chain[chain.index(other) :], other])
            raise InputError(
                f"a circle: {circle}", file=file, key=key, value=other, allowed=f"a way that ends in {base}"
            )
        chain.append(other)


def _check_setting(plan: ShearPlan, setting: Setting, change: Mapping[str, Any], file: PathLike, key: str) -> None:
    for kind in ("blended", "undetected"):
        if getattr(setting, kind) and kind not in plan.neighbours:
            raise InputError(
                f"needs neighbours.{kind}, which the plan lacks", file=file, key=f"{key}.{kind}", value=True
            )
        neighbours = plan.neighbours.get(kind)
        if (
            getattr(setting, kind)
            and setting.neighbour_shear == "by_redshift"
            and not (plan.lens and neighbours and neighbours.redshift)
        ):
            raise InputError(
                f"by_redshift needs lens and neighbours.{kind}.redshift, which the plan lacks",
                file=file,
                key=f"{key}.neighbour_shear",
                value=setting.neighbour_shear,
            )
    for layer, values in (change.get("layers") or {}).items():
        try:
            SimSteps(LAYERS, "SCIE", changed_layers({layer: values}, None, LAYERS))
        except InputError as exc:
            below = f"{key}.layers.{layer}"
            allowed = exc.allowed and str(exc.allowed).partition("; a list")[0]
            _, _, parameter = str(exc.key).rpartition(".")
            if isinstance(values, dict) and parameter in values:
                below += f".{parameter}"
            raise InputError(
                exc.message, file=file, key=below, value=exc.value, allowed=exc.allowed and allowed
            ) from None


def _check_sum(plan: ShearPlan, file: PathLike) -> None:
    """Raise InputError for effects of the sum that set one key, or one layer, to different values."""
    first_by_key: dict[str, tuple[str, Any]] = {}
    for name in plan.summed:
        change = plan.effects[name].change
        parts = {key: value for key, value in change.items() if key != "layers"}
        parts |= {f"layers.{layer}": values or {} for layer, values in (change.get("layers") or {}).items()}
        for key, value in parts.items():
            first_name, first_value = first_by_key.setdefault(key.lower(), (name, value))
            if first_value != value:
                raise InputError(
                    f"differs from the same key of {first_name}, and both are in the sum",
                    file=file,
                    key=f"effects.{name}.change.{key}",
                    value=value,
                    allowed=f"{first_value!r}, or sum: false",
                )
