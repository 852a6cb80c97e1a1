"""placeholder"""

import numpy as np


def predicted(method, scene, reach, snr, numbers):
    return np.full(len(scene), 1e-6) * snr
