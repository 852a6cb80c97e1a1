"""Notes on a campaign's selection and pointings, for `csstsim check`, `plan` and `aim`. They are not errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.optics.sky.bodies import angles_at_ends

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from csstsim.campaign.opened import OpenCampaign
    from csstsim.instrument.pointing import Pointing
    from csstsim.instrument.telescope import Telescope

LISTED = 5  # chips or exposures that a line names
LIMB_MIN = 0.0  # deg: below it the Earth covers the boresight, by the definition of the angle


def notes(run: OpenCampaign) -> list[str]:
    """Return lines on parts of `select` that select nothing, and on exposures near the Sun or towards the Earth."""
    science = {obsid: jobs[0].pointing for obsid, jobs in run.science_exposures.items()}
    note = pointing_note(science, run.camera.telescope)
    return [*selection_notes(run), *([note] if note else [])]


def pointing_note(exposures: Mapping[str, Pointing], telescope: Telescope) -> str:
    """Return a line that counts the exposures {obsid: Pointing} with a `pointing_fault` and names the first; or ""."""
    faults = {obsid: fault for obsid, p in exposures.items() if (fault := pointing_fault(p, telescope))}
    if not faults:
        return ""
    first = next(iter(faults))
    return (
        f"exposures too near the Sun or towards the Earth: {len(faults)} of {len(exposures)}; "
        f"obsid {first}: {faults[first]}"
    )


def pointing_fault(pointing: Pointing, telescope: Telescope) -> str:
    """Return which limits a boresight violates, with the angles of the header (SUNANGLn, LIMBANGn); "" for none.

    The angle to the Sun must reach the Telescope's `sun_angle_min`, and the Earth must not cover the boresight, at the
    start and at the end of the exposure.
    """
    angles = angles_at_ends(pointing)
    sun, limb = (min(angles[f"{name}_angle_{end}"] for end in ("start", "end")) for name in ("sun", "limb"))
    faults = []
    if sun < telescope.sun_angle_min:
        faults.append(f"angle to the Sun {sun:.1f} deg (limit: {telescope.sun_angle_min:g})")
    if limb < LIMB_MIN:
        faults.append(f"angle from the Earth's limb {limb:.1f} deg (limit: {LIMB_MIN:g})")
    return ", ".join(faults)


def selection_notes(run: OpenCampaign) -> list[str]:
    """Return a line for each reason why chips or obsids that `select` lists select no pixels.

    Chips of a group such as `all` are not listed. Pairs in `select.missing` have their own reasons.
    """
    return [*_idle_chips(run), *_idle_exposures(run)]


def _idle_chips(run: OpenCampaign) -> list[str]:
    """Return the lines on the chips that select.chips lists by number."""
    select = run.config.select
    if isinstance(select.chips, str):
        return []
    listed = sorted(set(select.chips))
    behind = {chip.id for chip in run.chips}
    science = [obsid for obsid, pointing in run.exposures.items() if pointing.type == "SCIE"]
    made = {job.chip.id for job in run.science_jobs}
    missed = [
        chip
        for chip in listed
        if chip in behind - made and any((obsid, chip) not in run.declared_missing for obsid in science)
    ]
    return [
        *_line("chip", [chip for chip in listed if chip not in behind], "not behind one of select.filters"),
        *_line("chip", missed, "no selected exposure has the region on it"),
    ]


def _idle_exposures(run: OpenCampaign) -> list[str]:
    """Return the lines on the exposures that select.obsids lists."""
    listed = list(dict.fromkeys(run.config.select.obsids or ()))
    made = {job.obsid for job in run.jobs}
    missed = [
        obsid
        for obsid in listed
        if obsid in run.exposures
        and obsid not in made
        and any((obsid, chip.id) not in run.declared_missing for chip in run.chips)
    ]
    other_types = [obsid for obsid in listed if obsid not in run.exposures]
    return [
        *_line("exposure", other_types, "not of one of select.types"),
        *_line("exposure", missed, "the region is on none of the selected chips"),
    ]


def _line(word: str, names: Iterable[int | str], reason: str) -> list[str]:
    """Return [the line of these names and the reason], or [] without names."""
    texts = list(map(str, names))
    if not texts:
        return []
    more = f" and {len(texts) - LISTED} more" if len(texts) > LISTED else ""
    return [f"{word if len(texts) == 1 else word + 's'} {', '.join(texts[:LISTED])}{more}: {reason}"]
