"""The binding of the paper's charge transfer code: compiled with cc, called in its own signature.

The real code is not part of the repository. A stand-in of ours has its signature and returns what it was given; where
CSSTSIM_MCTI names a checkout of github.com/ZunLuo/MCTI, the real one is compared with ours.
"""

import os
import shutil

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.parameters import TrapKeys
from csstsim.studies.bench.readout.cti import DENSITY, KEYS, PARTS, TAU, TRAPS, WELL
from csstsim.studies.bench.readout.mcti import Mcti

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

STAND_IN = r"""
#include <stdio.h>
void CTI_simul(double **image, int nx, int ny, int noverscan, int nsp, double *rho, double *t, double beta, double w,
  double c, int nmax, int oversample, int *traps, int release, double *share, int capture, double **out, int inject,
  double **current, int dark, double tdark, double tpix, int seed) {
  printf("chatter\n");
  for (int k = 0; k < nx; k++) for (int i = 0; i < ny + noverscan; i++) out[k][i] = i < ny ? image[k][i] : 1000 * k + i;
  out[0][0] = nsp; out[0][1] = rho[2]; out[0][2] = t[0]; out[0][3] = beta; out[0][4] = w; out[0][5] = c;
  out[0][6] = oversample; out[0][7] = share[1]; out[0][8] = inject + dark + tdark + tpix + seed;
  out[0][9] = traps[0] < 0 && traps[1] < 0 && traps[2] < 0 && release < 0 && capture < 0;
}
"""


def test_arguments_and_columns_arrive(tmp_path, capfd):
    (tmp_path / "any_name.c").write_text(STAND_IN)
    image = np.arange(36.0).reshape(12, 3)
    out = Mcti(tmp_path).transfer(image, DENSITY, TAU, WELL, overscan=2)
    assert out.shape == (14, 3)
    np.testing.assert_array_equal(out[:12, 1:], image[:, 1:])
    np.testing.assert_array_equal(out[12:, 2], [2012, 2013])
    np.testing.assert_array_equal(out[:10, 0], [3, DENSITY[2], TAU[0], *WELL[:2], 0, 1, 1, 0, 1])
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("code", [None, "int x = ;", "int other(void) { return 1; }"])
def test_what_is_not_the_code_is_an_input_error(tmp_path, code):
    if code is not None:
        (tmp_path / "some.c").write_text(code)
    with pytest.raises(InputError, match="--mcti"):
        Mcti(tmp_path)


def test_a_notch_is_refused(tmp_path):
    (tmp_path / "any_name.c").write_text(STAND_IN)
    with pytest.raises(ValueError, match="notch"):
        Mcti(tmp_path).transfer(np.ones((12, 1)), DENSITY, TAU, (0.5, 9e4, 10.0))


@pytest.mark.skipif("CSSTSIM_MCTI" not in os.environ, reason="CSSTSIM_MCTI names no checkout of MCTI")
def test_the_papers_code_agrees():
    """Loss and trails of a spot of 5000 e- at row 700: 5 sigma of the scatter of ten batches, which is 2% to 5%."""
    mcti, found = Mcti(os.environ["CSSTSIM_MCTI"]), ([], [])
    rng = np.random.default_rng(5)
    image = rng.poisson(40, (901, 1000)).astype(np.float32)
    image[700:703] = 5000
    for batch, part in enumerate(np.array_split(image, 10, axis=1)):
        ours = part.copy()
        transfer(ours, TRAPS, TrapKeys(KEYS.traps + np.uint64(batch), KEYS.releases))
        for lines, moved in zip(found, (ours, mcti.transfer(part, DENSITY, TAU, WELL, seed=batch + 1)), strict=True):
            change = (moved - part).mean(1, dtype=float)
            lines.append([change[700 + a : 700 + b].sum() for a, b in PARTS])
    ours, theirs = np.array(found[0]), np.array(found[1])
    sigma = np.hypot(ours.std(0), theirs.std(0)) / np.sqrt(9)
    assert (abs(ours.mean(0) - theirs.mean(0)) < 5 * sigma).all()
    assert (sigma < 0.05 * abs(ours.mean(0))).all()
