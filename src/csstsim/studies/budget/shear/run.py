"""Runs the plan's fields: each in every Setting, in both arms, through every estimator; one file of shapes a field.

A field that has its file is not made again, so a run that was stopped goes on. Settings that differ in the analysis
alone share a frame, which is rendered once.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias
from zipfile import BadZipFile, ZipFile

import numpy as np

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.base.release import release
from csstsim.base.types import AnyArray, FloatArray
from csstsim.measure.light.moments import on_sky, reduced
from csstsim.studies.budget.shear.estimators import Shapes, Stamps, check_installed, estimator, psf_shapes
from csstsim.studies.budget.shear.frames import Field, noise_of, opened
from csstsim.studies.budget.shear.plan import ALL, BASE, OTHER_SEED
from csstsim.studies.budget.shear.sample import RING

if TYPE_CHECKING:
    from csstsim.studies.budget.shear.plan import Setting, ShearPlan

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
    plan: ShearPlan, folder: Path, log: Callable[[str], object], *, first: int | None = None
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
    complete = {path for _, number, path in todo if is_complete(path, contents(plan, number))}
    simulation, band = opened(plan)
    paths: dict[str, list[Path]] = {name: [] for name in plan.samples}
    for name, number, path in progress(todo, "fields"):
        field = Field(simulation, plan, band, name, number)
        if path not in complete and not is_complete(path, contents(plan, number)):  # another run may have made it
            start = time.process_time()
            arrays: dict[str, Any] = measured(field, log if number == 0 else None)
            with atomic_path(path) as temporary:
                np.savez(temporary, **arrays)
            log(f"{name} {number}: {len(field.galaxies)} galaxies, {time.process_time() - start:.0f} CPU-s")
        paths[name].append(path)
    return paths


def contents(plan: ShearPlan, number: int) -> dict[str, str]:
    """Return {name: words} of the arrays of `measured`: their kind and shape, as _words has them."""
    n = plan.cells**2 // RING * RING
    found = {"psf": _words("c", (n,)), "ring": _words("i", (n,)), "sign": _words("f", ())}
    for name in names(plan, number):
        found |= {f"{name}|used": _words("b", (2, n)), f"{name}|seconds": _words("f", ())}
        for kind in plan.estimators:
            found |= {f"{name}|{kind}|e": _words("c", (2, n)), f"{name}|{kind}|response": _words("f", (2, n, 2))}
            found |= {f"{name}|{kind}|other": _words("c", (n,))} if number == 0 else {}
    return found


def _words(kind: str, shape: tuple[int, ...]) -> str:
    return f"{KINDS.get(kind, kind)} {shape}"


def is_complete(path: Path, wanted: Mapping[str, str]) -> bool:
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
    wrong = next((name for name, of in wanted.items() if found.get(name) != of), None)
    if wrong is not None:
        raise InputError(
            "not the shapes of this window; remove the file, and they are measured again",
            file=path,
            key=wrong,
            value=found.get(wrong, "no array"),
            allowed=wanted[wrong],
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


class _Shape(NamedTuple):
    """The shape of one galaxy: e, and its response (2,)."""

    e: complex
    response: FloatArray


_StampsKey: TypeAlias = tuple[str, bytes, bytes]  # an estimator, and the digests of two stamps: galaxy and PSF


@dataclass
class _Made:
    """What of a field was made already, by what decides it."""

    images: dict[tuple[str, complex], FloatArray]
    psfs: dict[str, FloatArray]
    shapes: dict[tuple[str, int, str], Shapes]
    galaxies: dict[_StampsKey, _Shape]
    sigma: float = 0.0  # noise of a pixel of the base, for all Settings: what estimators add is the same in all


def measured(field: Field, log: Callable[[str], object] | None = None) -> dict[str, AnyArray]:
    """Return {name: array} of a field's shapes.

    `psf` (n,) complex; `ring` (n,); `sign`; SETTING|ESTIMATOR|e (2, n) complex, |response (2, n, 2); SETTING|used
    (2, n); SETTING|seconds of CPU time; in field 0, SETTING|ESTIMATOR|other (n,), the arm -g with another seed.
    log: is given a line for each SETTING.
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
                stamps = _stamps(field, setting, image, psf, made)
                on_pixels = _shapes(field, kind, stamps, (_key(setting, {"wcs", "detection"}), arm, kind), made)
                shapes = to_sky(on_pixels, jacobian, kind in ELLIPTICITIES)
                arrays.setdefault(f"{name}|{kind}|e", []).append(shapes.e)
                arrays.setdefault(f"{name}|{kind}|response", []).append(shapes.response)
        arrays[f"{name}|used"] = used
        arrays[f"{name}|seconds"] = np.array(time.process_time() - start)
        if name == BASE:
            arrays["psf"] = psf_shapes(psf)
        if field.number == 0:
            image = field.arm(setting, -field.shear, plan.seed + OTHER_SEED)
            for kind in plan.estimators:
                stamps = _stamps(field, setting, image, psf, made)
                shapes = estimator(kind)(stamps, field.rng(f"{kind} other"))
                arrays[f"{name}|{kind}|other"] = to_sky(shapes, jacobian, kind in ELLIPTICITIES).e
        if log:
            log(f"  {field.sample}, {name}: {time.process_time() - start:.1f} CPU-s")
    return {name: np.array(values) for name, values in arrays.items()}


def _stamps(field: Field, setting: Setting, image: FloatArray, psf: FloatArray, made: _Made) -> Stamps:
    scale = field.simulation._run.camera.telescope.pixel_scale
    return Stamps(field.stamps(image), psf, made.sigma if setting.noise else 0.0, scale)


def _key(setting: Setting, without: set[str]) -> str:
    return repr(setting.model_dump(exclude=without))


def _image(field: Field, setting: Setting, g: complex, made: _Made) -> FloatArray:
    key = _key(setting, ANALYSIS), g
    if key not in made.images:
        if len(made.images) > 3:  # of the base and of one more: 16 MB each
            of_base = list(made.images)[:2]
            made.images = {name: made.images[name] for name in of_base}
        made.images[key] = field.arm(setting, g)
    return made.images[key]


def _psf(field: Field, setting: Setting, made: _Made) -> FloatArray:
    """Return the stamps of the PSF; only one from stars depends on how frames are made."""
    without = {"wcs", "detection", "profile", "blended", "undetected", "neighbour_shear"}
    key = _key(setting, without) if setting.psf == "stars" else setting.psf
    if key not in made.psfs:
        made.psfs[key] = field.psf(setting)
    return made.psfs[key]


def _shapes(field: Field, kind: str, stamps: Stamps, key: tuple[str, int, str], made: _Made) -> Shapes:
    if key not in made.shapes:
        rng = field.rng(kind)
        alone = kind in ELLIPTICITIES  # shapes of stamp and PSF alone, without noise that is added
        made.shapes[key] = _once(made.galaxies, kind, stamps, rng) if alone else estimator(kind)(stamps, rng)
    return made.shapes[key]


def _once(known: dict[_StampsKey, _Shape], kind: str, stamps: Stamps, rng: np.random.Generator) -> Shapes:
    """Return Shapes; a galaxy whose stamps were seen before, as where no neighbour was added, is not measured again."""
    keys = [
        (kind, _digest_of(image), _digest_of(star)) for image, star in zip(stamps.galaxies, stamps.psf, strict=True)
    ]
    new = [k for k, key in enumerate(keys) if key not in known]
    if new:
        found = estimator(kind)(stamps.take(new), rng)
        known |= {keys[k]: _Shape(e, response) for k, e, response in zip(new, found.e, found.response, strict=True)}
    shapes = [known[key] for key in keys]
    return Shapes(np.array([shape.e for shape in shapes]), np.array([shape.response for shape in shapes]))


def _digest_of(stamp: FloatArray) -> bytes:
    return hashlib.sha256(np.ascontiguousarray(stamp).data).digest()


def to_sky(shapes: Shapes, jacobian: FloatArray, ellipticities: bool) -> Shapes:
    """Return Shapes on the axes east and north, of those on pixel axes; jacobian (n, 2, 2): d(x, y)/d(east, north).

    Ellipticities of galaxies are mapped exactly; of other shapes, the response to the map's shear is subtracted, to
    first order, and they are turned.
    """
    if ellipticities:
        with np.errstate(invalid="ignore"):  # NaN in, NaN out
            e = reduced(on_sky(2 * shapes.e / (1 + np.abs(shapes.e) ** 2), jacobian))
        return Shapes(e, shapes.response)
    circle: AnyArray = jacobian @ np.swapaxes(jacobian, -1, -2)  # moments of a circle on the sky, in pixels
    trace = circle[:, 0, 0] + circle[:, 1, 1]
    shear = reduced((circle[:, 0, 0] - circle[:, 1, 1] + 2j * circle[:, 0, 1]) / trace)
    turn = np.arctan2(jacobian[:, 1, 0] - jacobian[:, 0, 1], jacobian[:, 0, 0] + jacobian[:, 1, 1])
    by_map = shapes.response[:, 0] * shear.real + 1j * shapes.response[:, 1] * shear.imag
    return Shapes((shapes.e - by_map) * np.exp(-2j * turn), shapes.response)
