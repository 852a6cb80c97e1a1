"""The blinded budget: frames whose shear only a key file has, and the score of an answer.

The key has the shear of each field, a seed of the frames, and a salt. The frames' folder has the seal, the SHA-256 of
these. So the key cannot be changed after an answer, and the frames do not reveal it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.output_folder import output_folder
from csstsim.base.files.text_file import read_json
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.base.types import FloatArray, PathLike
from csstsim.studies.budget.answer import answer_number, answer_rows
from csstsim.studies.budget.shear.blind_readme import readme, zeropoint
from csstsim.studies.budget.shear.frames import Field, start_simulation
from csstsim.studies.budget.shear.plan import ALL, BASE, load_plan
from csstsim.studies.budget.shear.printed import PRINTED, pair

if TYPE_CHECKING:
    from csstsim.studies.budget.shear.plan import Setting

SEAL = "seal.json"
README = "README.md"
COLUMNS = "field", "g1", "g2", "g1_err", "g2_err"
STEPS = 10_000  # a component is a multiple of twice the plan's shear over this


@one_thread
def blind(
    file: PathLike | None,
    key: PathLike,
    output: PathLike,
    log: Callable[[str], object],
    *,
    count: int | None = None,
    whole: bool = False,
) -> None:
    """Write a key file, and a folder of frames with its shears: README.md, a FITS file per field of the first sample.

    whole: with all effects of the sum; otherwise the base. HDUs of a frame: IMAGE (electrons, background subtracted),
    PSF (n, s, s), GALAXIES (x, y: 0-based pixels of IMAGE; jacobian d(x, y)/d(east, north) [px / arcsec]). Raises
    InputError for a file that exists. If anything fails, no file is left.
    """
    plan = load_plan(file, fields=count)
    key = Path(key)
    folder = output_folder(output)
    output_folder(key.parent, "--blind")
    _check_apart(key, folder)
    frames = [folder / f"field_{number:03d}.fits" for number in range(plan.fields)]
    paths = [*frames, folder / README, key, folder / SEAL]
    for path in paths:
        if path.exists():
            raise InputError("exists already, and nothing was written; name another folder, or key", file=path)
    rng = secrets.SystemRandom()
    shears = [[2 * plan.shear * rng.randint(-STEPS, STEPS) / STEPS for _ in range(2)] for _ in range(plan.fields)]
    content = {"shears": shears, "seed": rng.randrange(2**62), "salt": secrets.token_hex(16)}
    hidden = plan.model_copy(update={"seed": content["seed"]})
    name = next(iter(plan.samples))
    setting = plan.setting(ALL if whole else BASE)
    simulation, band = start_simulation(hidden)
    with _all_or_none(paths):
        for number, (path, (g1, g2)) in enumerate(progress(list(zip(frames, shears, strict=True)), "fields")):
            field = Field(simulation, hidden, band, name, number)
            _write(path, field, setting, complex(g1, g2))
        with atomic_path(folder / README) as temporary:
            temporary.write_text(readme(plan, field))
        with atomic_path(key) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n")
        with atomic_path(folder / SEAL) as temporary:
            temporary.write_text(json.dumps({"seal": _seal(content), "fields": plan.fields}, indent=1) + "\n")
    log(f"{folder}: {plan.fields} frames, the seal, README.md; {key}: the key, not to be opened before the answer")


def _check_apart(key: Path, folder: Path) -> None:
    """Raise InputError for a key in the folder of the frames, or a parent of it, also by way of links."""
    key_path = key.resolve()
    frames_folder = folder.resolve()
    if key_path.is_relative_to(frames_folder) or frames_folder.is_relative_to(key_path):
        raise InputError(
            "the key would lie in the folder that is given away, or be a folder on the way to it",
            key="--blind",
            value=str(key),
            allowed=f"a folder outside the output folder, {folder}",
        )


@contextmanager
def _all_or_none(paths: Sequence[Path]) -> Iterator[None]:
    """Remove these new files and their empty folders if the body of the `with` statement fails."""
    new = {path.parent for path in paths if not path.parent.exists()}
    try:
        yield
    except BaseException:  # Ctrl-C, too
        for path in paths:
            path.unlink(missing_ok=True)
        for folder in new:
            with suppress(OSError):  # never made, or not empty
                folder.rmdir()
        raise


def _seal(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps([content["shears"], content["seed"], content["salt"]]).encode()).hexdigest()


def _write(path: Path, field: Field, setting: Setting, g: complex) -> None:
    from astropy.io import fits

    window = field.job(False).window
    x = field.galaxies.x - window.x0
    y = field.galaxies.y - window.y0
    jacobian = field.jacobian(setting)
    columns = [
        fits.Column("x", "D", unit="pixel", array=x),
        fits.Column("y", "D", unit="pixel", array=y),
        fits.Column("jacobian", "4D", unit="pixel/arcsec", dim="(2,2)", array=jacobian),
    ]
    hdus = fits.HDUList(
        [
            fits.PrimaryHDU(),
            fits.ImageHDU(field.arm(setting, g).astype(np.float32), name="IMAGE"),
            fits.ImageHDU(np.ascontiguousarray(field.psf(setting), np.float32), name="PSF"),
            fits.BinTableHDU.from_columns(columns, name="GALAXIES"),
        ]
    )
    hdus["IMAGE"].header.update(
        {
            "BUNIT": ("electron", "background subtracted"),
            "EXPTIME": (field.job(False).exposure.exptime, "s"),
            "GAIN": (1.0, "electrons per unit of the image"),
            "FILTER": field.band,
            "ZP_AB": (zeropoint(field), "AB magnitude of one electron"),
        }
    )
    hdus["PSF"].header["BUNIT"] = ("", "fractions of the flux: each stamp has a sum of 1")
    with atomic_path(path) as temporary:
        hdus.writeto(temporary, overwrite=True)


def reveal(
    key: PathLike, answer: PathLike, log: Callable[[str], object], folder: PathLike | None = None
) -> dict[str, float]:
    """Score an answer, a CSV of COLUMNS, against a key; return fields, chi2, and m, m_err, c, c_err by component.

    folder: of the frames, whose seal must be the key's. m and c are fitted to answer = (1 + m) g + c, weighted by the
    answer's errors; chi2 is that of the answer against the key, over both components of all fields. Raises InputError.
    """
    content = _read_key(key)
    if folder is not None:
        sealed = _read_json(Path(folder) / SEAL, ("seal",))["seal"]
        if sealed != _seal(content):
            raise InputError("the key is not the one that was sealed", file=key, key="seal", value=_seal(content)[:16])
    true = np.array(content["shears"], float)
    value, error = _read_answer(answer, len(content["shears"]))
    score = {"fields": len(true), "chi2": float((((value - true) / error) ** 2).sum())}
    for axis in range(2):
        design = np.stack([true[:, axis], np.ones(len(true))], axis=1) / error[:, axis, None]
        if len(true) < 2 or np.linalg.matrix_rank(design) < 2:
            continue
        covariance = np.linalg.inv(design.T @ design)
        slope, offset = covariance @ design.T @ (value[:, axis] / error[:, axis])
        m_err, c_err = np.sqrt(np.diag(covariance))
        for name, number in ((f"m{axis + 1}", slope - 1), (f"c{axis + 1}", offset)):
            score[name] = float(number)
        score |= {f"m{axis + 1}_err": float(m_err), f"c{axis + 1}_err": float(c_err)}
    for name in ("m1", "m2", "c1", "c2"):
        if name in score:
            unit = PRINTED[name] if name in ("c1", "c2") else 1.0
            words = pair(score[name] / unit, score[f"{name}_err"] / unit)
            log(f"{name} = {words}" if unit == 1.0 else f"{name} = ({words}) 1e-4")
    log(f"chi2 = {score['chi2']:.1f} of {true.size} numbers")
    return score


def _read_json(path: PathLike, names: Sequence[str]) -> dict[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict) or any(name not in content for name in names):
        raise InputError("not a key, nor a seal, of a blinded budget", file=path, allowed=", ".join(names))
    return content


def _read_key(path: PathLike) -> dict[str, Any]:
    """Return the content of a key. Raises InputError, also for shears that are not two numbers each, below 1."""
    content = _read_json(path, ("shears", "seed", "salt"))
    pairs = content["shears"] if isinstance(content["shears"], list) and content["shears"] else [None]
    for number, shear in enumerate(pairs):
        is_pair = isinstance(shear, list) and len(shear) == 2
        if not is_pair or any(type(g) not in (int, float) or not abs(g) < 1 for g in shear):
            raise InputError(
                "not a shear", file=path, key=f"shears.{number}", value=shear, allowed="two numbers, each below 1"
            )
    return content


def _read_answer(path: PathLike, count: int) -> tuple[FloatArray, FloatArray]:
    """Return values and errors (fields, 2) of an answer. Raises InputError."""
    rules = {
        "field": (range(count).__contains__, f"0 to {count - 1}"),
        **dict.fromkeys(("g1", "g2"), (lambda g: abs(g) < 1, "a shear, between -1 and 1")),
        **dict.fromkeys(("g1_err", "g2_err"), (lambda error: 1e-9 <= error <= 1e9, "1e-9 to 1e9")),
    }
    rows = [
        [answer_number(path, line, row, name, *rules[name]) for name in COLUMNS]
        for line, row in answer_rows(path, COLUMNS)
    ]
    numbers = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    order = np.argsort(numbers["field"])
    if numbers["field"][order].tolist() != list(range(count)):
        raise InputError("must have each field once", file=path, key="field", allowed=f"0 to {count - 1}")
    value = np.stack([numbers["g1"], numbers["g2"]], axis=1)
    error = np.stack([numbers["g1_err"], numbers["g2_err"]], axis=1)
    return value[order], error[order]
