"""Checks that involve several files of a campaign. run: campaign.opened.OpenCampaign; all raise InputError."""

from __future__ import annotations

from stat import S_ISDIR
from typing import TYPE_CHECKING, cast

from csstsim.base.errors import BlockedError, InputError
from csstsim.base.files.output_folder import nearest_existing_parent
from csstsim.base.help_page import explained
from csstsim.base.plural import number_of
from csstsim.base.process.progress import progress
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import PixelWindow
from csstsim.instrument.maps.chip_maps import STAGES
from csstsim.optics.throughput import shutter

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from csstsim.base.types import PathLike
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.sim_steps import SimSteps
    from csstsim.simulation.state import State


def check_file(run: OpenCampaign, key: str, path: Path) -> None:
    """Check that the file named by a key of the campaign (survey_table, or one of observations) can be read."""
    try:
        fault = "it is a folder" if S_ISDIR(path.stat().st_mode) else None
    except OSError as exc:
        fault = exc.strerror
    if fault:
        with explained("survey table" if key == "survey_table" else "observation"):
            raise InputError(
                f"cannot read the file: {fault}",
                file=run.file,
                key=key,
                value=str(path),
                allowed="a file; paths are relative to the folder of the campaign file",
            )


@explained("campaign")
def check_selection(run: OpenCampaign) -> None:
    """Check that exposures, chips, filters, window and PSF library of the campaign file exist."""
    select = run.config.select
    unknown: list[str] | list[int] = sorted(set(select.obsids or ()) - set(run.pointings))
    if unknown:
        raise InputError(
            "not in the survey table",
            file=run.file,
            key="select.obsids",
            value=unknown[0],
            allowed=f"the {number_of(len(run.pointings), 'obsid')} of {run.table}",
        )
    unknown = [] if isinstance(select.chips, str) else sorted(set(select.chips) - set(run.camera.chips))
    if unknown:
        raise InputError(
            "no such chip",
            file=run.file,
            key="select.chips",
            value=unknown[0],
            allowed=", ".join(map(str, run.camera.chips)),
        )
    unknown = sorted(set(select.filters or ()) - set(run.camera.filters))
    if unknown:
        raise InputError(
            "unknown filter",
            file=run.file,
            key="select.filters",
            value=unknown[0],
            allowed=", ".join(run.camera.filters),
        )
    chips = {chip.id for chip in run.camera.chips.values()}
    for name, reason in select.missing.items():
        obsid, _, chip = name.partition("_")
        if obsid not in run.pointings or not chip.isdigit() or int(chip) not in chips:
            raise InputError(
                "no pair of an exposure and a chip",
                file=run.file,
                key="select.missing",
                value=name,
                allowed="OBSID_CHIP, as in file names: 10100000004_09",
            )
        if not reason.strip():
            raise InputError("the reason is missing", file=run.file, key=f"select.missing.{name}", value=reason)
    library = run.psf_library
    if library is not None and not library.is_dir():
        raise InputError("no such folder", file=run.file, key="psf.library", value=library)
    detector = run.camera.detector
    window = run.config.window
    if isinstance(window, PixelWindow) and (window.x1 > detector.nx or window.y1 > detector.ny):
        raise InputError(
            "extends beyond the chip's edge",
            file=run.file,
            key="window",
            value=window.model_dump(),
            allowed=f"x1 <= {detector.nx}, y1 <= {detector.ny}",
        )


@explained("campaign")
def check_braces(run: OpenCampaign, scratch: PathLike | None) -> None:
    """Check that no folder of the workflow has braces in its path, which Snakemake takes for a wildcard."""
    paths = {None: run.file.absolute(), "output": run.paths.output, "share": run.config.share, "scratch": scratch}
    for key, path in paths.items():
        if set("{}") & set(str(path or "")):
            message = "a path with braces, which Snakemake takes for a wildcard"
            raise InputError(message, file=run.file, key=key, value=str(path), allowed="a path without { and }")


@explained("campaign")
def check_share(run: OpenCampaign) -> None:
    """Check that products in the shared folder, if there is one, can be linked into the output folder."""
    share = run.config.share
    output = run.paths.output
    if share is None:
        return
    if share.is_symlink() and not share.exists():
        raise InputError("a link to nothing", file=run.file, key="share", value=share)
    if share.exists() and not share.is_dir():
        raise InputError("not a folder", file=run.file, key="share", value=share)
    if output.resolve() in (share.resolve(), *share.resolve().parents):
        raise InputError("inside the output folder", file=run.file, key="share", value=share)
    if nearest_existing_parent(share).stat().st_dev != nearest_existing_parent(output).stat().st_dev:
        raise InputError("not on the file system of the output folder", file=run.file, key="share", value=share)


@explained("campaign")
def check_universe(run: OpenCampaign) -> None:
    """Check that the folder of the campaign's universe exists, also with a catalogue of objects that needs none."""
    universe = run.config.universe
    if universe is not None and not universe.is_dir():
        raise InputError("no such folder", file=run.file, key="universe", value=str(universe))


@explained("instrument")
def check_maps(chips: Iterable[Chip], *, read: bool = False) -> None:
    """Check the headers of the laboratory maps of these Chips and, if `read`, all their pixels."""
    maps = [lab_map for chip in chips for lab_map in chip.maps.of(STAGES.values()).values()]
    for lab_map in progress(maps, "laboratory maps") if read and maps else ():
        lab_map.check()


@explained("instrument")
def check_header(run: OpenCampaign, chip: Chip) -> None:
    """Check level0_keywords.yaml of a user's camera: it may name only known quantities. chip: one of the campaign."""
    from types import SimpleNamespace

    from csstsim.io.keywords import header_cards, header_values

    camera = run.camera
    file = run.camera.files.path("level0_keywords")
    users_layers = not all(steps.shipped for steps in run.steps.values())  # they may add quantities
    if users_layers or camera.files.folder.resolve() == (SHIPPED / "instrument").resolve():
        return
    state = cast(
        "State",
        SimpleNamespace(
            header={},
            mask=None,
            pointing=next(iter(run.pointings.values())),
            chip=chip,
            window=chip.full_window,
            telescope=camera.telescope,
            wcs=SimpleNamespace(distortion=None),
        ),
    )
    for hdu in (0, 1):
        header_cards(camera.keywords, header_values(state, {}, "channels"), hdu, file)


@explained("campaign")
def check_photons(run: OpenCampaign) -> None:
    """Check that the layer poisson_and_dark, which adds sampled photons to the image, is present if it is needed."""
    samples_photons = run.config.fidelity in ("preview", "standard")
    for steps in run.steps.values():
        if samples_photons and steps.step("scie_obs") and not steps.step("poisson_and_dark"):
            raise InputError(
                f"fidelity {run.config.fidelity} samples photons, but no layer adds them to the image",
                file=steps.file,
                key="layers",
                allowed="poisson_and_dark in the list, or fidelity noise_free or reference",
            )


@explained("survey table")
def check_layers(run: OpenCampaign, exposures: Mapping[str, Pointing]) -> None:
    """Check that the layers can be applied with the camera to each of the exposures {obsid: Pointing}."""
    blocked = {}
    for obsid, pointing in exposures.items():
        try:
            run.steps[pointing.type].check(run.camera, pointing)
        except BlockedError as error:
            blocked[obsid] = error
    if not blocked:
        return
    first = next(iter(blocked))
    more = len(blocked) - 1
    others = f" ({number_of(more, 'more exposure')} of {len(exposures)}, too)" if more else ""
    pointing = exposures[first]
    from_model_orbit = pointing.sat_position == run.camera.orbit.state(pointing.time).position
    remedy = "a corrected state of the spacecraft"
    if from_model_orbit:  # the table has no state
        remedy = "the spacecraft's states in the table (sat_x ... sat_vz), which now come from the model orbit"
    raise InputError(
        f"{blocked[first]}{others}",
        file=run.table,
        key=f"obsid {first}",
        allowed=f"{remedy}; or a table without these rows; or the constant sky, enable_straylight_model: false in "
        f"{run.steps[pointing.type].file}",
    )


@explained("campaign")
def check_shutter(steps: SimSteps, exptime: float, chips: Iterable[Chip]) -> None:
    """Check that an exposure [s] of these SimSteps is not shorter than the shutter allows, on any of the chips."""
    for chip in chips if steps.losses.shutter else ():
        try:
            shutter.check(chip, exptime)
        except InputError as exc:
            raise InputError(f"{exc}; or turn shutter_effect off", file=steps.file) from None


@explained("campaign")
def check_masters(run: OpenCampaign, chips: Iterable[int]) -> None:
    """Check that the master frames for the calibration of these chips (numbers) exist."""
    for chip_id in sorted(chips) if run.config.measurement.calibration == "frames" else ():
        path = run.masters(chip_id)
        if not path.is_file():
            raise InputError(
                f"no {path}",
                file=run.file,
                key="measurement.masters",
                allowed="output of a finished campaign of bias, dark and flat exposures (config/calibration.yaml)",
            )


@explained("campaign")
def check_keep(run: OpenCampaign, chips_as: str, scratch: bool) -> None:
    """Check that `keep: light` is possible: only with separate stages, whose files are in the output folder."""
    if run.config.keep == "light" and (chips_as != "stages" or scratch):
        message = "needs chips in stages, with all files in the output folder"
        raise InputError(
            message,
            file=run.file,
            key="keep",
            value="light",
            allowed="--config chips=stages without scratch; otherwise keep: nothing",
        )
