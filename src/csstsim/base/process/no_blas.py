"""Prevents numba's import of scipy.linalg, which takes 0.12 s per process, if imported before the first kernel runs.

numba imports scipy.linalg to test for a BLAS library. No kernel of csstsim needs BLAS; kernels of users can use it.
"""

import numba.np.linalg

numba.np.linalg.ensure_blas = lambda: None
