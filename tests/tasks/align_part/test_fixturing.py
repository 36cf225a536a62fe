"""Raised supports make the part level: checked with the plane through them, and with drawn poses."""

from __future__ import annotations

import numpy as np
import pytest
from simulated.castings import turn

from metrocli.errors import InputError
from metrocli.table import Table
from metrocli.tasks.align_part.fixturing import corrections

PLACES = np.array([[0.0, 0], [1500, 50], [1400, 1000], [-20, 900]])
POSE = np.array([120.0, 80, 35, 2.1e-3, -1.3e-3, 0.4])


def supports(places: np.typing.NDArray[np.float64]) -> Table:
    names = np.array([f"S{n}" for n in range(len(places))])
    return Table({"support": names, "x": places[:, 0], "y": places[:, 1]}, {"x": "mm", "y": "mm"})


def heights(angles: np.typing.NDArray[np.float64]) -> np.typing.NDArray[np.float64]:
    """Height of the part's plane z = 0 over each support, by the line along z that meets it."""
    normal = turn(angles)[:, 2]
    return np.array([-(normal[0] * x + normal[1] * y) / normal[2] for x, y in PLACES])


def test_raised_supports_are_level_and_the_largest_comes_first() -> None:
    found = corrections(POSE, np.zeros((6, 6)), supports(PLACES))
    order = [int(name[1:]) for name in found.texts("support")]
    raised = heights(POSE[3:])[order] + found.numbers("raise")
    assert np.ptp(raised) < 1e-9
    assert found.numbers("raise").min() == 0 and (np.diff(found.numbers("raise")) <= 0).all()
    assert found.numbers("raise").max() > 1


def test_their_uncertainty_is_that_of_drawn_poses() -> None:
    covariance = np.diag([0.01, 0.01, 0.01, 2e-5, 3e-5, 1e-5]) ** 2
    found = corrections(POSE, covariance, supports(PLACES))
    order = [int(name[1:]) for name in found.texts("support")]
    drawn = np.random.default_rng(1).multivariate_normal(POSE, covariance, 4000)
    each = np.array([heights(one[3:])[order] for one in drawn])
    relative = each[:, -1:] - each  # to the support that stays
    assert np.allclose(relative.std(axis=0), found.numbers("raise_std"), rtol=0.05, atol=1e-12)


@pytest.mark.parametrize(
    ("places", "message"), [(PLACES[:2], "2 supports"), (PLACES[:1] + np.outer(range(4), [5, 7]), "one line")]
)
def test_supports_that_cannot_level(places: np.typing.NDArray[np.float64], message: str) -> None:
    with pytest.raises(InputError, match=message):
        corrections(POSE, np.zeros((6, 6)), supports(places))
