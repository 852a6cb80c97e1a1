"""Import this before the first kernel runs, and numba does not import scipy.linalg: an eighth of a second a process.

numba imports it to learn whether there is a BLAS. No kernel here needs one; that of a user still finds it.
"""

import numba.np.linalg

numba.np.linalg.ensure_blas = lambda: None
