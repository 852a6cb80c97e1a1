"""Every product of an output folder, with its check, in the order in which they are checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.delivery import campaign_checks, frame_checks
from csstsim.delivery.checked_files import CheckedFiles
from csstsim.delivery.contents import MAYBE, NO, YES
from csstsim.io.paths import CAT, COSMIC, ORDERS, TRUTH
from csstsim.measure.bricks.hats import ABOUT

if TYPE_CHECKING:
    from csstsim.delivery.contents import Contents, ExpectedFrame


@dataclass(frozen=True)
class Product:
    """One file: what it is, whether it must exist (YES or MAYBE), and how it is checked.

    `check()` yields faults in words, or raises InputError or OSError; it is called if the file and all of `requires`
    exist. None: it is enough that it exists.
    """

    kind: str
    path: Path
    need: str
    check: Callable[[], Iterator[str]] | None
    requires: tuple[Path, ...] = ()


def products(contents: Contents) -> list[Product]:
    """Return the list of Product of a contents.Contents: those of frames, then what they share."""
    checked = CheckedFiles()
    found = [product for frame in contents.frames for product in _of_frame(contents, frame, checked)]
    found += [*_inputs(contents, checked), *_bricks(contents, checked), *_report(contents, checked)]
    found += [Product(title, path, YES, None) for path, title in contents.others.items()]
    return [product for product in found if product.need != NO]


def _of_frame(contents: Contents, frame: ExpectedFrame, checked: CheckedFiles) -> Iterator[Product]:
    paths = contents.paths
    recipe = contents.measure_recipe(frame)
    orders = frame.companion(ORDERS)
    cosmic = frame.companion(COSMIC)
    measured = paths.measure(*frame.key)
    spectra = paths.spectra(*frame.key)
    calibrated = paths.calibrated(*frame.key)
    picture = spectra.with_suffix(".png")
    yield Product("Level-0", frame.level0, YES, partial(frame_checks.level0, frame, checked))
    yield Product("truth", frame.companion(TRUTH), YES, partial(frame_checks.truth, frame, checked))
    text = frame.companion(CAT)
    yield Product(
        "truth as text", text, contents.cat, partial(frame_checks.cat, text, frame, checked), (frame.companion(TRUTH),)
    )
    if frame.catalogue not in (None, text):
        check = partial(frame_checks.cat, frame.catalogue, frame, checked)
        yield Product("truth as text", frame.catalogue, YES, check, (frame.companion(TRUTH),))
    yield Product("truth of orders", orders, frame.extracted, partial(frame_checks.orders, orders, frame))
    yield Product("cosmic rays", cosmic, frame.cosmic, partial(frame_checks.cosmic, cosmic, frame))
    need = NO if frame.measured == NO else contents.calibrated
    yield Product("calibrated", calibrated, need, partial(frame_checks.calibrated, calibrated, frame))
    yield Product(
        "measured", measured, frame.measured, partial(frame_checks.measured, measured, frame, recipe, checked)
    )
    residual = paths.residual(*frame.key)
    need = NO if frame.measured == NO else contents.joint
    yield Product("residual", residual, need, partial(frame_checks.residual, residual, recipe))
    yield Product("spectra", spectra, frame.extracted, partial(frame_checks.spectra, spectra, recipe))
    lines = paths.lines(*frame.key)
    yield Product("line fluxes", lines, frame.extracted, partial(frame_checks.lines, lines, recipe))
    yield Product("figure of spectra", picture, frame.extracted, partial(campaign_checks.picture, picture))


def _inputs(contents: Contents, checked: CheckedFiles) -> Iterator[Product]:
    paths = contents.paths
    for path, recipe in contents.light.items():
        yield Product("light of a chip", path, YES, partial(frame_checks.light, path, recipe))
    for chip, record in contents.masters.items():
        yield Product(
            "masters", paths.masters(chip), YES, partial(campaign_checks.masters, paths.masters(chip), record)
        )
    for chip, frame in contents.psf.items():
        made = paths.psf(chip)
        tables = paths.psf_tables(chip)
        if not made.is_relative_to(paths.output):  # a variant: of the base
            continue
        yield Product("PSF set", made, YES, partial(campaign_checks.psf, made, frame, checked))
        yield Product("PSF tables", tables, YES, partial(campaign_checks.psf_tables, tables, made, frame), (made,))
    for pix, record in contents.truth.items():
        yield Product(
            "truth brick", paths.truth(pix), YES, partial(campaign_checks.truth_brick, paths.truth(pix), record)
        )
    for name in ABOUT if contents.truth else ():  # the report writes them if all bricks exist
        path = paths.truth_catalogue / name
        check = partial(campaign_checks.partition, path, contents.truth) if path.suffix == ".csv" else None
        yield Product("truth catalogue", path, MAYBE, check)


def _bricks(contents: Contents, checked: CheckedFiles) -> Iterator[Product]:
    paths = contents.paths
    known = {frame.key: frame for frame in contents.frames}
    for pix, recipe in contents.bricks.items():
        merged = paths.merge(pix)
        yield Product("merged brick", merged, YES, partial(campaign_checks.merged, merged, pix, recipe, known, checked))
    if contents.bricks:
        folder = paths.merge_catalogue
        about = [folder / "dataset" / n for n in ("_metadata", "_common_metadata")]
        listed = folder / "partition_info.csv"
        yield Product("merged catalogue", listed, YES, partial(campaign_checks.partition, listed, contents.bricks))
        yield from (Product("merged catalogue", path, YES, None) for path in about)
        check = partial(campaign_checks.catalogue, folder, contents.bricks, checked)
        yield Product("merged catalogue", folder / "hats.properties", YES, check, tuple(about))
    for pix, recipe in contents.bricks.items():
        path = paths.validate(pix)
        yield Product("validation", path, YES, partial(campaign_checks.validation, path, pix, recipe, checked))
        picture = path.with_suffix(".png")
        yield Product("figure of validation", picture, YES, partial(campaign_checks.picture, picture))


def _report(contents: Contents, checked: CheckedFiles) -> Iterator[Product]:
    page = contents.paths.report
    verdict = page.with_name("verdict.json")
    yield Product("report", page, contents.report, partial(campaign_checks.page, page))
    variants = contents.paths.variants_page
    yield Product("comparison of variants", variants, MAYBE, partial(campaign_checks.page, variants))
    yield Product(
        "verdict", verdict, contents.report, partial(campaign_checks.verdict, verdict, contents.bricks, checked)
    )
