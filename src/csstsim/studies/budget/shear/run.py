"""Runs the plan's fields: each in every Setting and both arms, with every estimator; one file of shapes per field.

A field whose file exists is not simulated again, so a stopped run continues. Settings that differ only in the analysis
share a frame, which is rendered once.
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
from csstsim.studies.budget.shear.frames import Field, noise_of, start_simulation
from csstsim.studies.budget.shear.plan import ALL, BASE, OTHER_SEED
from csstsim.studies.budget.shear.sample import RING

if TYPE_CHECKING:
    from csstsim.studies.budget.shear.plan import Setting, ShearPlan

ELLIPTICITIES = "hsm", "own"  # estimators whose shapes are (a - b) / (a + b) of galaxies without the PSF
KINDS = {"b": "booleans", "i": "integers", "f": "floats", "c": "complex numbers"}  # of dtype.kind
ANALYSIS = {"psf", "wcs", "detection"}  # keys of a Setting that do not change the frame


def setting_names(plan: ShearPlan, number: int = 0) -> list[str]:
    """Return the names of the Settings of window `number`, in order: those whose bars have more windows than that."""
    bars = [name for name in plan.bars if number < plan.windows(name)]
    all_effects = [ALL] if plan.summed and number < plan.windows(ALL) else []
    effects = {setting_of(plan, name) for name in bars + [plan.effects[name].against for name in bars]}
    return [BASE, *(name for name in plan.effects if name in effects), *all_effects]


def setting_of(plan: ShearPlan, name: str) -> str:
    """Return BASE for an effect that changes nothing, such as noise that is in the base, otherwise its name."""
    return BASE if plan.setting(name) == plan.base else name


def run_fields(
    plan: ShearPlan, folder: Path, log: Callable[[str], object], *, first: int | None = None
) -> dict[str, list[Path]]:
    """Simulate the missing fields in a folder, or only the `first` ones; return {sample: [path of a field's shapes]}.

    Raises InputError for estimators that cannot be used, and for files that are not of the fields.
    """
    check_installed(plan.estimators, None)
    jobs = [
        (name, number, folder / "fields" / f"{name}_{number:05d}_{_digest(plan, name, number)}.npz")
        for number in range(first or plan.windows(BASE))
        for name in plan.samples
    ]
    complete = {path for _, number, path in jobs if is_complete(path, expected_arrays(plan, number))}
    simulation, band = start_simulation(plan)
    paths: dict[str, list[Path]] = {name: [] for name in plan.samples}
    for name, number, path in progress(jobs, "fields"):
        field = Field(simulation, plan, band, name, number)
        # Another run may have made it in the meantime
        if path not in complete and not is_complete(path, expected_arrays(plan, number)):
            start = time.process_time()
            arrays: dict[str, Any] = measure_field(field, log if number == 0 else None)
            with atomic_path(path) as temporary:
                np.savez(temporary, **arrays)
            log(f"{name} {number}: {len(field.galaxies)} galaxies, {time.process_time() - start:.0f} CPU-s")
        paths[name].append(path)
    return paths


def expected_arrays(plan: ShearPlan, number: int) -> dict[str, str]:
    """Return {name: _array_type} of the arrays of `measure_field`."""
    n = plan.cells**2 // RING * RING
    types = {"psf": _array_type("c", (n,)), "ring": _array_type("i", (n,)), "sign": _array_type("f", ())}
    for name in setting_names(plan, number):
        types |= {f"{name}|used": _array_type("b", (2, n)), f"{name}|seconds": _array_type("f", ())}
        for kind in plan.estimators:
            types[f"{name}|{kind}|e"] = _array_type("c", (2, n))
            types[f"{name}|{kind}|response"] = _array_type("f", (2, n, 2))
            if number == 0:
                types[f"{name}|{kind}|other"] = _array_type("c", (n,))
    return types


def _array_type(kind: str, shape: tuple[int, ...]) -> str:
    return f"{KINDS.get(kind, kind)} {shape}"


def is_complete(path: Path, wanted: Mapping[str, str]) -> bool:
    """Whether a file of shapes exists and can be read completely: a damaged one is made again.

    wanted: of `expected_arrays`. Raises InputError for a sound file that lacks one of these arrays.
    """
    try:
        with ZipFile(path) as file:
            if file.testzip() is not None:
                return False
    except (OSError, ValueError, EOFError, BadZipFile, RuntimeError):
        return False
    types = _array_types(path)
    differing = next((name for name, type_ in wanted.items() if types.get(name) != type_), None)
    if differing is not None:
        raise InputError(
            "not the shapes of this window; remove the file, and they are measured again",
            file=path,
            key=differing,
            value=types.get(differing, "no array"),
            allowed=wanted[differing],
        )
    return True


def _array_types(path: Path) -> dict[str, str]:
    """Return {name: _array_type} of the arrays of an .npz file, up to the first one of Python objects."""
    types = {}
    with suppress(ValueError), np.load(path) as file:
        for name in file.files:
            values = np.asarray(file[name])
            types[name] = _array_type(values.dtype.kind, values.shape)
    return types


def _digest(plan: ShearPlan, sample: str, number: int) -> str:
    """Return the digest of everything that determines a field's shapes, including the release of csstsim.

    The number of fields and the words of the figure do not change them.
    """
    settings = {name: plan.setting(name).model_dump() for name in setting_names(plan, number)}
    shared = plan.model_dump(exclude={"fields", "whole", "samples", "effects", "base"})
    return digest([release(), shared, plan.samples[sample].model_dump(), settings])


class _Shape(NamedTuple):
    """The shape of one galaxy: e, and its response (2,)."""

    e: complex
    response: FloatArray


_StampsKey: TypeAlias = tuple[str, bytes, bytes]  # an estimator, and the digests of two stamps: galaxy and PSF


@dataclass
class _Cache:
    """Results for a field, by what determines them."""

    images: dict[tuple[str, complex], FloatArray]
    psfs: dict[str, FloatArray]
    shapes: dict[tuple[str, int, str], Shapes]
    galaxies: dict[_StampsKey, _Shape]
    sigma: float = 0.0  # noise of a pixel of the base, for all Settings: what estimators add is the same in all


def measure_field(field: Field, log: Callable[[str], object] | None = None) -> dict[str, AnyArray]:
    """Return {name: array} of a field's shapes.

    `psf` (n,) complex; `ring` (n,); `sign`; SETTING|ESTIMATOR|e (2, n) complex, |response (2, n, 2); SETTING|used
    (2, n); SETTING|seconds of CPU time; in field 0, SETTING|ESTIMATOR|other (n,), the arm -g with another seed.
    log: gets a line for each SETTING.
    """
    plan = field.plan
    cache = _Cache({}, {}, {}, {})
    arrays: dict[str, Any] = {"ring": field.galaxies.ring, "sign": np.array(field.sign)}
    for name in setting_names(plan, field.number):
        setting = plan.setting(name)
        start = time.process_time()
        jacobian = field.jacobian(setting)
        psf = _psf(field, setting, cache)
        used = []
        for arm, g in enumerate((field.shear, -field.shear)):
            image = _image(field, setting, g, cache)
            cache.sigma = cache.sigma or noise_of(image)
            used.append(field.detected(image) if setting.detection else np.ones(len(field.galaxies), bool))
            for kind in plan.estimators:
                stamps = _stamps(field, setting, image, psf, cache)
                on_pixels = _shapes(field, kind, stamps, (_key(setting, {"wcs", "detection"}), arm, kind), cache)
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
                stamps = _stamps(field, setting, image, psf, cache)
                shapes = estimator(kind)(stamps, field.rng(f"{kind} other"))
                arrays[f"{name}|{kind}|other"] = to_sky(shapes, jacobian, kind in ELLIPTICITIES).e
        if log:
            log(f"  {field.sample}, {name}: {time.process_time() - start:.1f} CPU-s")
    return {name: np.array(values) for name, values in arrays.items()}


def _stamps(field: Field, setting: Setting, image: FloatArray, psf: FloatArray, cache: _Cache) -> Stamps:
    scale = field.simulation._run.camera.telescope.pixel_scale
    return Stamps(field.stamps(image), psf, cache.sigma if setting.noise else 0.0, scale)


def _key(setting: Setting, without: set[str]) -> str:
    return repr(setting.model_dump(exclude=without))


def _image(field: Field, setting: Setting, g: complex, cache: _Cache) -> FloatArray:
    key = _key(setting, ANALYSIS), g
    if key not in cache.images:
        if len(cache.images) > 3:  # those of the base and of one more Setting: 16 MB each
            images_of_base = list(cache.images)[:2]
            cache.images = {name: cache.images[name] for name in images_of_base}
        cache.images[key] = field.arm(setting, g)
    return cache.images[key]


def _psf(field: Field, setting: Setting, cache: _Cache) -> FloatArray:
    """Return the stamps of the PSF; only a PSF from stars depends on how frames are made."""
    irrelevant = {"wcs", "detection", "profile", "blended", "undetected", "neighbour_shear"}
    key = _key(setting, irrelevant) if setting.psf == "stars" else setting.psf
    if key not in cache.psfs:
        cache.psfs[key] = field.psf(setting)
    return cache.psfs[key]


def _shapes(field: Field, kind: str, stamps: Stamps, key: tuple[str, int, str], cache: _Cache) -> Shapes:
    if key not in cache.shapes:
        rng = field.rng(kind)
        if kind in ELLIPTICITIES:  # these depend only on the stamps, because no noise is added
            cache.shapes[key] = _measure_new(cache.galaxies, kind, stamps, rng)
        else:
            cache.shapes[key] = estimator(kind)(stamps, rng)
    return cache.shapes[key]


def _measure_new(known: dict[_StampsKey, _Shape], kind: str, stamps: Stamps, rng: np.random.Generator) -> Shapes:
    """Return Shapes; a galaxy with known stamps, for example where no neighbour was added, is not measured again."""
    pairs = zip(stamps.galaxies, stamps.psf, strict=True)
    keys = [(kind, _stamp_digest(image), _stamp_digest(star)) for image, star in pairs]
    new = [k for k, key in enumerate(keys) if key not in known]
    if new:
        measured = estimator(kind)(stamps.take(new), rng)
        shapes = zip(new, measured.e, measured.response, strict=True)
        known |= {keys[k]: _Shape(e, response) for k, e, response in shapes}
    of_stamps = [known[key] for key in keys]
    return Shapes(np.array([shape.e for shape in of_stamps]), np.array([shape.response for shape in of_stamps]))


def _stamp_digest(stamp: FloatArray) -> bytes:
    return hashlib.sha256(np.ascontiguousarray(stamp).data).digest()


def to_sky(shapes: Shapes, jacobian: FloatArray, ellipticities: bool) -> Shapes:
    """Return Shapes on pixel axes as those on axes east and north; jacobian (n, 2, 2): d(x, y)/d(east, north).

    Ellipticities are mapped exactly; for other shapes, the response to the shear of the map is subtracted to first
    order, and the rotation is applied.
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
