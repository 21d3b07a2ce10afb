"""Load directions: grids, files, and angles as a user types them."""

from typing import NamedTuple

import numpy as np

from rve.common import AnyPath, Array, InputError, checked, read_as, read_columns, shown
from rve.geometry.weave import FOUR_IN_ONE, Weave

MOST_VALUES = 100_000
"""Load directions of one table: more take hours, and a typing error asks for billions."""
MOST_DEGREES = 360.0


def parse_angles(text: str, name: str) -> Array:
    """Angles in degrees from "first:last:step" (both ends included) or a list "7.5,12.5"; raises InputError.

    >>> parse_angles("0:45:15", "--alpha")
    array([ 0., 15., 30., 45.])
    """
    told, is_range = f"{name} = {shown(text)}", ":" in text
    try:
        values = np.array([float(part) for part in text.split(":" if is_range else ",")])
    except ValueError:
        values = np.empty(0)
    if not len(values) or (is_range and len(values) != 3) or not (np.abs(values) <= MOST_DEGREES).all():
        most = f"{-MOST_DEGREES:g} to {MOST_DEGREES:g}"
        raise InputError(f"{told}: write first:last:step or a list such as 7.5,12.5 with degrees from {most}")
    if not is_range:
        return values
    first, last, step = values
    count = np.floor((last - first) / step + 1e-9) + 1 if step else 0.0
    if not 1 <= count <= MOST_VALUES:
        raise InputError(f"{told}: the step must lead from the first to the last value, in {MOST_VALUES} steps at most")
    return np.asarray(first + step * np.arange(int(count)))


class LoadDirections(NamedTuple):
    """Principal angles alpha_deg (n,) and ratio angles beta_deg (n,) of n line loads, in degrees."""

    alpha_deg: Array
    beta_deg: Array


@checked
def grid(step: float = 5.0, weave: Weave = FOUR_IN_ONE) -> LoadDirections:
    """The paper's grid: alpha from 0 to 45 and beta from 0 to 90 degrees in steps of `step`, beta running fastest.

    A weave that is not its own mirror image needs negative alpha as well, from -45 degrees on; (-45, beta) is
    (45, 90 - beta) and appears once. InputError for a step that is not between 0.1 and 45 degrees, or leads to neither
    end.

    >>> len(grid(5.0).alpha_deg)
    190
    """
    if not 0.1 <= step <= 45.0 or abs(round(45.0 / step) * step - 45.0) > 1e-9:
        raise InputError(f"step = {step}: must divide 45 degrees and lie between 0.1 and 45")
    count = round(45.0 / step)
    return product(_all_round(np.linspace(0.0, 45.0, count + 1), weave), np.linspace(0.0, 90.0, 2 * count + 1))


def _all_round(alpha: Array, weave: Weave) -> Array:
    """Principal angles from 0 to 45 degrees, and their negatives for a weave that is not its own mirror image."""
    return alpha if weave.is_mirrored else np.concatenate([-alpha[-2:0:-1], alpha])


def product(alpha: Array, beta: Array) -> LoadDirections:
    """All combinations of angles in degrees, beta running fastest; InputError for too many."""
    if alpha.size * beta.size > MOST_VALUES:
        raise InputError(f"{alpha.size} x {beta.size} load directions are more than {MOST_VALUES}; take larger steps")
    a, b = np.meshgrid(alpha, beta, indexing="ij")
    return LoadDirections(a.ravel(), b.ravel())


@checked
def graded_grid(weave: Weave = FOUR_IN_ONE) -> LoadDirections:
    """403 load directions, close where the strain changes fast: beta near 0 and 90, alpha beyond 30 degrees.

    There it moves by 0.05 within half a degree of beta; elsewhere the steps are 5 degrees, as in the paper. For a weave
    that is not its own mirror image there are 744, with negative alpha.
    """
    near = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0])
    far = np.array([82.5, 85.0, 86.0, 87.0, 88.0, 88.5, 89.0, 90.0])
    alpha = np.concatenate([np.arange(0.0, 30.0, 5.0), np.arange(30.0, 46.0, 2.5)])
    return product(_all_round(alpha, weave), np.concatenate([near, np.arange(10.0, 81.0, 5.0), far]))


def read_loads(path: AnyPath) -> LoadDirections:
    """Load directions from the columns alpha_deg, beta_deg of a CSV file; raises InputError."""
    with read_as("list of loads", path):
        columns = read_columns(path, LoadDirections._fields, LoadDirections._fields)
    known = [True] * len(columns.places)
    if len(known) > MOST_VALUES:
        raise InputError(f"{path}: has {len(known)} load directions, at most {MOST_VALUES} are allowed")
    return LoadDirections(*(columns.numbers(name, MOST_DEGREES, known) for name in LoadDirections._fields))
