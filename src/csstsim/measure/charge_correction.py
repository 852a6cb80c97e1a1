"""Charge that the detector moved is put back, by iteration of the forward model.

    guess <- guess + (electrons - forward(guess)),   guess = electrons at first

(Bristow 2003; Massey et al. 2010, MNRAS 401, 371; Anderson & Bedin 2010). What is read differs from what was there by a
tenth at most, and each pass leaves a tenth of the error or less. The electrons of a trap that lets go later than the
last row read are put back, too. Read noise was never in the silicon, but is taken for charge that was: a pixel's noise
grows a little with charge transfer undone (docs/calibration.md).
"""


def corrected(electrons, forward, passes):
    """Return the charge (ny, nx) that `forward` (an image, changed in place) makes into `electrons`, after `passes`."""
    guess = electrons.copy()
    for _ in range(passes):
        moved = guess.copy()
        forward(moved)
        guess += electrons - moved
    return guess
