"""A cubic through rows that is monotone wherever these are."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def find_cubic_slopes(x: Array, e: Array) -> Array:
    """Slopes at the rows of a cubic that is monotone wherever the rows are (Fritsch and Butland, SIAM J. Sci. Stat.
    Comput. 5, 300, 1984): a weighted harmonic mean of the two secants, 0 where they have different signs."""
    lengths, secants = np.diff(x), np.diff(e) / np.diff(x)
    slopes = np.zeros_like(x)
    slopes[0], slopes[-1] = secants[0], secants[-1]
    for k in range(1, len(x) - 1):
        secant, next_secant = secants[k - 1], secants[k]
        if secant * next_secant > 0:
            first, second = 2 * lengths[k] + lengths[k - 1], lengths[k] + 2 * lengths[k - 1]
            slopes[k] = (first + second) / (first / secant + second / next_secant)
    return slopes
