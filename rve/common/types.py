"""Types of arrays."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Floating-point array; its shape is stated where it is used."""
