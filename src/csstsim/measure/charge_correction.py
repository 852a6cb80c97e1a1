"""Corrects charge transfer and the brighter-fatter effect: moves charge back by iterating the forward model.

    guess <- guess + (electrons - forward(guess)),   guess = electrons at first

(Bristow 2003; Massey et al. 2010, MNRAS 401, 371; Anderson & Bedin 2010). The detector moves a tenth of a pixel's
charge at most, and each pass leaves a tenth of the error or less. Electrons that a trap releases after the last row was
read are restored, too. Read noise is treated as charge, though it never was in the silicon: the correction of charge
transfer raises a pixel's noise a little (docs/calibration.md).
"""


def corrected(electrons, forward, passes):
    """Return the charge (ny, nx) that `forward` (an image, changed in place) makes into `electrons`, after `passes`."""
    guess = electrons.copy()
    for _ in range(passes):
        moved = guess.copy()
        forward(moved)
        guess += electrons - moved
    return guess
