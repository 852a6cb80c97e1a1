"""What one stage leaves for the next: planes, unit and header come back; rays of the readout; a frame's metadata."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.readout_state import flat_state

from csstsim.base.errors import InputError
from csstsim.base.release import release
from csstsim.io.frames import load_frame, save_frame
from csstsim.stages.parts.stage_frames import frame_meta, state_before
from csstsim.stages.readout import save_cosmic_rays

RECIPE = {"camera": "c" * 16, "campaign": "a" * 16, "layers": "b" * 16, "exposure": "d" * 16, "csstsim": release()}
WINDOW = 100, 106, 40, 44


def run_of(folder, stages=("render",)):
    return SimpleNamespace(
        has_stage=lambda pointing, stage: stage in stages,
        paths=SimpleNamespace(stage=lambda obsid, chip, name: folder / f"{obsid}_{chip}_{name}"),
        recipe=lambda job, stage="level0": RECIPE | {"layers": stage.rjust(16)},
    )


@pytest.fixture
def job(camera):
    exposure = replace(flat_state(camera, window=WINDOW).exposure, mask=True)
    return SimpleNamespace(
        exposure=exposure, key=("10100000001", 9), obsid="10100000001", chip=exposure.chip, window=exposure.window,
        pointing=exposure.pointing, wcs=exposure.wcs,
    )  # fmt: skip


def written(folder, job, **changes):
    """Write a frame of the render stage as the next one finds it; return its planes."""
    ramp = np.arange(24).reshape(4, 6)
    planes = {"image": ramp.astype(np.float32), "counted": (3 * ramp).astype(np.int32), "mask": (ramp % 5).astype("u1")}
    planes = {name: changes.pop(name, plane) for name, plane in planes.items()}
    meta = {"recipe": RECIPE | {"layers": "render".rjust(16)}, "stage": "render", "unit": "DN", "header": {"a": 2}}
    path = run_of(folder).paths.stage(*job.key, "render.fits")
    save_frame(path, planes, {k: v for k, v in (meta | changes).items() if v is not None}, sparse=("counted",))
    return planes


def test_a_state_comes_back_with_all_its_planes(tmp_path, job):
    planes = written(tmp_path, job)
    state = state_before(run_of(tmp_path), job, "render")
    assert np.array_equal(state.image, planes["image"]) and state.image.dtype == np.float32
    assert np.array_equal(state.counted, planes["counted"]) and np.array_equal(state.mask, planes["mask"])
    assert (state.unit, state.header) == ("DN", {"a": 2}) and state.exposure is job.exposure


def test_an_unmarked_mask_is_blank_and_none_is_kept_if_none_is_asked_for(tmp_path, job):
    written(tmp_path, job, mask=None)
    assert state_before(run_of(tmp_path), job, "render").mask.tolist() == np.zeros((4, 6)).tolist()
    written(tmp_path, job)
    job.exposure = replace(job.exposure, mask=False)
    assert state_before(run_of(tmp_path), job, "render").mask is None


def test_an_exposure_without_the_stage_begins_dark(tmp_path, job):
    state = state_before(run_of(tmp_path, ()), job, "render")
    assert state.image.shape == (4, 6) and not state.image.any() and state.counted is None and state.unit == "electron"


@pytest.mark.parametrize(("changes", "words"), [
    ({"image": None}, "damaged: it lacks the plane image"), ({"unit": None}, "damaged"), ({"header": None}, "damaged"),
    ({"stage": "readout"}, "stage"), ({"recipe": RECIPE}, "made with other layers|layers"),
])  # fmt: skip
def test_a_frame_that_does_not_fit_is_refused(tmp_path, job, changes, words):
    written(tmp_path, job, **changes)
    with pytest.raises(InputError, match=words):
        state_before(run_of(tmp_path), job, "render")


def test_a_frame_says_of_which_exposure_and_window_it_is(tmp_path, job):
    state = flat_state(job.exposure.camera, window=WINDOW)
    state.header = {"stages": [["select", 1.0, 1.0], ["render", 2.0, 2.0]]}
    meta = frame_meta(run_of(tmp_path), job, state)
    assert (meta["stage"], meta["unit"], meta["recipe"]["layers"]) == ("render", "electron", "render".rjust(16))
    logged = meta["exposure"]
    pointing = job.pointing
    wanted = {
        "OBSID": "10100000001", "FILETYPE": "SCIE", "DETECTOR": "09", "FILTER": "r", "EXPTIME": pointing.exptime,
        "RA_OBJ": pointing.ra, "DEC_OBJ": pointing.dec, "POS_ANG0": pointing.pa, "POSKIND": "APPARENT",
        "FLDDIST": job.wcs.distortion is not None, "CAMHASH": RECIPE["camera"], "READX0": 101, "READX1": 106,
        "READY0": 41, "READY1": 44,
    }  # fmt: skip
    assert {key: logged[key] for key in wanted} == wanted and logged.keys() - wanted.keys() == job.wcs.header().keys()


def test_rays_are_written_as_a_plane_and_an_old_one_is_taken_away(tmp_path, job):
    path, state = tmp_path / "rays.fits", flat_state(job.exposure.camera, window=WINDOW)
    state.cosmic_rays = np.array([1, 8, 23]), np.array([7, 30000, 2])
    save_cosmic_rays(path, state, RECIPE)
    planes, meta = load_frame(path)
    assert {tuple(p): int(planes["cosmic"][tuple(p)]) for p in np.argwhere(planes["cosmic"])} == {
        (0, 1): 7, (1, 2): 30000, (3, 5): 2,
    }  # fmt: skip
    assert meta["unit"] == "electron" and meta["recipe"] == RECIPE and state.cosmic_rays is None
    save_cosmic_rays(path, state, RECIPE)
    assert not path.exists()
