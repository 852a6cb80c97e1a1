"""Types of arrays and paths. Shapes and units are in docstrings: (n,), (rows, columns), [deg], [e-]."""

import os
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.floating[Any]]
IntArray: TypeAlias = NDArray[np.integer[Any]]
BoolArray: TypeAlias = NDArray[np.bool_]
ComplexArray: TypeAlias = NDArray[np.complexfloating[Any, Any]]
AnyArray: TypeAlias = NDArray[Any]  # numbers of any type, or text
Floats: TypeAlias = float | FloatArray  # a number or an array; the result has the same shape
PathLike: TypeAlias = str | os.PathLike[str]
