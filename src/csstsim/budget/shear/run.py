"""Runs the plan's fields: each in every Setting, in both arms, through every estimator; one file of shapes a field.

A field that has its file is not made again, so a run that was stopped goes on. A frame is drawn once for the Settings
that differ in the analysis alone.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.base.release import release
from csstsim.base.types import AnyArray, FloatArray
from csstsim.budget.shear.estimators import Shapes, check_installed, estimator, psf_shapes
from csstsim.budget.shear.frames import Field, noise_of, opened
from csstsim.budget.shear.plan import ALL, BASE, OTHER_SEED
from csstsim.budget.shear.sample import RING
from csstsim.measure.light.moments import on_sky, reduced

if TYPE_CHECKING:
    from csstsim.budget.shear.plan import Setting, ShearPlan

ELLIPTICITIES = "hsm", "own"  # estimators whose shapes are (a - b) / (a + b) of galaxies without the PSF
KINDS = {"b": "booleans", "i": "integers", "f": "floats", "c": "complex numbers"}  # of dtype.kind
ANALYSIS = {"psf", "wcs", "detection"}  # keys of a Setting that leave the frame as it is


def names(plan: ShearPlan, number: int = 0) -> list[str]:
    """Return the names of the Settings that window `number` is made in, in order: those whose bars have that many."""
    bars = [name for name in plan.bars if number < plan.windows(name)]
    whole = [ALL] if plan.summed and number < plan.windows(ALL) else []
    wanted = {setting_of(plan, name) for name in bars + [plan.effects[name].against for name in bars]}
    return [BASE, *(name for name in plan.effects if name in wanted), *whole]


def setting_of(plan: ShearPlan, name: str) -> str:
    """Return BASE for an effect that changes nothing, such as noise that is in the base, else its name."""
    return BASE if plan.setting(name) == plan.base else name


def fields(
    plan: ShearPlan, folder: Path, say: Callable[[str], object], *, first: int | None = None
) -> dict[str, list[Path]]:
    """Make the missing fields in a folder, or only the `first` few; return {sample: [path of a field's shapes]}.

    Raises InputError for estimators that cannot be used, and for files that are not of the fields.
    """
    check_installed(plan.estimators, None)
    todo = [
        (name, number, folder / "fields" / f"{name}_{number:05d}_{_digest(plan, name, number)}.npz")
        for number in range(first or plan.windows(BASE))
        for name in plan.samples
    ]
    there = {path for _, number, path in todo if kept(path, contents(plan, number))}
    simulation, band = opened(plan)
    paths: dict[str, list[Path]] = {name: [] for name in plan.samples}
    for name, number, path in progress(todo, "fields"):
        field = Field(simulation, plan, band, name, number)
        if path not in there and not kept(path, contents(plan, number)):  # another run may have made it
            start = time.process_time()
            arrays: dict[str, Any] = measured(field, say if number == 0 else None)
            with atomic_path(path) as temporary:
                np.savez(temporary, **arrays)
            say(f"{name} {number}: {len(field.galaxies)} galaxies, {time.process_time() - start:.0f} CPU-s")
        paths[name].append(path)
    return paths


def contents(plan: ShearPlan, number: int) -> dict[str, str]:
    """Return {name: words} of the arrays of `measured`: their kind and shape, as _words has them."""
    n = plan.cells**2 // RING * RING
    found = {"psf": ("c", (n,)), "ring": ("i", (n,)), "sign": ("f", ())}
    for name in names(plan, number):
        found |= {f"{name}|used": ("b", (2, n)), f"{name}|seconds": ("f", ())}
        for kind in plan.estimators:
            found |= {f"{name}|{kind}|e": ("c", (2, n)), f"{name}|{kind}|response": ("f", (2, n, 2))}
            found |= {f"{name}|{kind}|other": ("c", (n,))} if number == 0 else {}
    return {name: _words(*of) for name, of in found.items()}


def _words(kind: str, shape: tuple[int, ...]) -> str:
    return f"{KINDS.get(kind, kind)} {shape}"


def kept(path: Path, wanted: Mapping[str, str]) -> bool:
    """Whether a file of shapes exists and can be read to its end: one that is damaged is made again.

    wanted: of `contents`. Raises InputError for a sound file that lacks one of these arrays.
    """
    try:
        with ZipFile(path) as file:
            if file.testzip() is not None:
                return False
    except (OSError, ValueError, EOFError, BadZipFile, RuntimeError):
        return False
    found = _arrays_of(path)
    if wrong := [name for name, of in wanted.items() if found.get(name) != of]:
        raise InputError(
            "not the shapes of this window; remove the file, and they are measured again",
            file=path,
            key=wrong[0],
            value=found.get(wrong[0], "no array"),
            allowed=wanted[wrong[0]],
        )
    return True


def _arrays_of(path: Path) -> dict[str, str]:
    """Return {name: _words} of the arrays of an .npz file, up to the first that holds Python's objects."""
    found = {}
    with suppress(ValueError), np.load(path) as file:
        for name in file.files:
            values = np.asarray(file[name])
            found[name] = _words(values.dtype.kind, values.shape)
    return found


def _digest(plan: ShearPlan, sample: str, number: int) -> str:
    """Return the digest of all that decides a field's shapes, the release of csstsim among it.

    How many fields there are does not decide them, nor do the figure's words."""
    settings = {name: plan.setting(name).model_dump() for name in names(plan, number)}
    same = plan.model_dump(exclude={"fields", "whole", "samples", "effects", "base"})
    return digest([release(), same, plan.samples[sample].model_dump(), settings])


@dataclass
class _Made:
    """What of a field was made already, by what decides it."""

    images: dict[tuple[str, complex], FloatArray]
    psfs: dict[str, FloatArray]
    shapes: dict[tuple[str, int, str], Shapes]
    seen: dict[tuple[str | bytes, ...], tuple[complex, FloatArray]]
    sigma: float = 0.0  # noise of a pixel of the base, for all Settings: what estimators add is the same in all


def measured(field: Field, say: Callable[[str], object] | None = None) -> dict[str, AnyArray]:
    """Return {name: array} of a field's shapes.

    `psf` (n,) complex; `ring` (n,); `sign`; SETTING|ESTIMATOR|e (2, n) complex, |response (2, n, 2); SETTING|used
    (2, n); SETTING|seconds of CPU time; in field 0, SETTING|ESTIMATOR|other (n,), the arm -g with another seed.
    say: is given a line for each SETTING.
    """
    plan = field.plan
    made = _Made({}, {}, {}, {})
    arrays: dict[str, Any] = {"ring": field.galaxies.ring, "sign": np.array(field.sign)}
    for name in names(plan, field.number):
        setting = plan.setting(name)
        start = time.process_time()
        jacobian = field.jacobian(setting)
        psf = _psf(field, setting, made)
        used = []
        for arm, g in enumerate((field.shear, -field.shear)):
            image = _image(field, setting, g, made)
            made.sigma = made.sigma or noise_of(image)
            used.append(field.found(image) if setting.detection else np.ones(len(field.galaxies), bool))
            for kind in plan.estimators:
                shapes = to_sky(_shapes(field, setting, arm, image, psf, kind, made), jacobian, kind in ELLIPTICITIES)
                for key, values in (("e", shapes.e), ("response", shapes.response)):
                    arrays.setdefault(f"{name}|{kind}|{key}", []).append(values)
        arrays[f"{name}|used"] = used
        arrays[f"{name}|seconds"] = np.array(time.process_time() - start)
        if name == BASE:
            arrays["psf"] = psf_shapes(psf)
        if field.number == 0:
            image = field.arm(setting, -field.shear, plan.seed + OTHER_SEED)
            for kind in plan.estimators:
                sigma = made.sigma if setting.noise else 0.0
                arguments = field.stamps(image), psf, sigma, _scale(field), field.rng(f"{kind} other")
                arrays[f"{name}|{kind}|other"] = to_sky(estimator(kind)(*arguments), jacobian, kind in ELLIPTICITIES).e
        if say:
            say(f"  {field.sample}, {name}: {time.process_time() - start:.1f} CPU-s")
    return {name: np.array(values) for name, values in arrays.items()}


def _scale(field: Field) -> float:
    return field.simulation._run.camera.telescope.pixel_scale


def _key(setting: Setting, without: set[str]) -> str:
    return repr(setting.model_dump(exclude=without))


def _image(field: Field, setting: Setting, g: complex, made: _Made) -> FloatArray:
    key = _key(setting, ANALYSIS), g
    if key not in made.images:
        if len(made.images) > 3:  # of the base and of one more: 16 MB each
            kept = list(made.images)[:2]
            made.images = {name: made.images[name] for name in kept}
        made.images[key] = field.arm(setting, g)
    return made.images[key]


def _psf(field: Field, setting: Setting, made: _Made) -> FloatArray:
    """Return the stamps of the PSF; only one from stars depends on how frames are made."""
    without = {"wcs", "detection", "profile", "blended", "undetected", "neighbour_shear"}
    key = _key(setting, without) if setting.psf == "stars" else setting.psf
    if key not in made.psfs:
        made.psfs[key] = field.psf(setting)
    return made.psfs[key]


def _shapes(
    field: Field, setting: Setting, arm: int, image: FloatArray, psf: FloatArray, kind: str, made: _Made
) -> Shapes:
    key = _key(setting, {"wcs", "detection"}), arm, kind
    if key not in made.shapes:
        arguments = field.stamps(image), psf, made.sigma if setting.noise else 0.0, _scale(field), field.rng(kind)
        alone = kind in ELLIPTICITIES  # shapes of stamp and PSF alone, without noise that is added
        made.shapes[key] = _once(made.seen, kind, *arguments) if alone else estimator(kind)(*arguments)
    return made.shapes[key]


def _once(
    seen: dict[tuple[str | bytes, ...], tuple[complex, FloatArray]],
    kind: str,
    stamps: FloatArray,
    psf: FloatArray,
    *same: *tuple[float, float, np.random.Generator],
) -> Shapes:
    """Return Shapes; a galaxy whose stamps were seen before, as where no neighbour was added, is not measured again."""
    keys: list[tuple[str | bytes, ...]] = [
        (kind, *(hashlib.sha256(np.ascontiguousarray(of).data).digest() for of in two))
        for two in zip(stamps, psf, strict=True)
    ]
    new = [k for k, key in enumerate(keys) if key not in seen]
    if new:
        found = estimator(kind)(stamps[new], psf[new], *same)
        seen |= {keys[k]: (e, response) for k, e, response in zip(new, found.e, found.response, strict=True)}
    e, response = zip(*(seen[key] for key in keys), strict=True)
    return Shapes(np.array(e), np.array(response))


def to_sky(shapes: Shapes, jacobian: FloatArray, ellipticities: bool) -> Shapes:
    """Return Shapes on the axes east and north, of those on pixel axes; jacobian (n, 2, 2): d(x, y)/d(east, north).

    Ellipticities of galaxies are mapped exactly; of other shapes, the response to the map's shear is subtracted, to
    first order, and they are turned.
    """
    if ellipticities:
        with np.errstate(invalid="ignore"):  # NaN in, NaN out
            e = reduced(on_sky(2 * shapes.e / (1 + np.abs(shapes.e) ** 2), jacobian))
        return Shapes(e, shapes.response)
    round_one: AnyArray = jacobian @ np.swapaxes(jacobian, -1, -2)
    trace = round_one[:, 0, 0] + round_one[:, 1, 1]
    shear = reduced((round_one[:, 0, 0] - round_one[:, 1, 1] + 2j * round_one[:, 0, 1]) / trace)
    turn = np.arctan2(jacobian[:, 1, 0] - jacobian[:, 0, 1], jacobian[:, 0, 0] + jacobian[:, 1, 1])
    own = shapes.response[:, 0] * shear.real + 1j * shapes.response[:, 1] * shear.imag
    return Shapes((shapes.e - own) * np.exp(-2j * turn), shapes.response)
