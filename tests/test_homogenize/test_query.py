"""Answers for the command line: which loads are tensile, and which are not by a little."""

from pathlib import Path

import numpy as np
import pytest

from homogenize.io import DEFAULT_LAW, default_law
from homogenize.query.answers import support_answer
from rve.common.errors import InputError

LAW = DEFAULT_LAW


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_a_load_of_one_direction_is_tensile_and_one_that_pushes_by_a_little_is_not(size, angle):
    """Rounding of the components is forgiven, whatever the units; a compression of 1e-10 of the load is not."""
    c, s = np.cos(angle), np.sin(angle)
    along, across = np.array([c * c, c * s, s * s]), np.array([s * s, -c * s, c * c])
    answer = support_answer(LAW, size * along)
    assert answer["h"] == pytest.approx(size * default_law().support(along[None])[0], rel=1e-12)
    assert support_answer(LAW, size * (along - 1e-14 * across))["h"] == pytest.approx(answer["h"], rel=1e-9)
    with pytest.raises(InputError, match="not tensile"):
        support_answer(LAW, size * (along - 1e-10 * across))


def test_no_load_is_not_tensile():
    for S in (np.zeros(3), np.array([-1.0, 0.0, -1.0]), np.array([1.0, 0.0, -1.0])):
        with pytest.raises(InputError, match="not tensile"):
            support_answer(Path(LAW), S)
