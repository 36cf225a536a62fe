"""What a simulated camera sees."""

from __future__ import annotations

import numpy as np

from metrocli.tasks.shared.images.simulation import SimulatedCamera, sights
from metrocli.tasks.shared.images.target_list import TargetCoordinates

LENS = {"f": 2790.0, "cx": 1296.0, "cy": 972.0, "k1": 0.26, "k2": -0.13}


def test_a_target_far_outside_the_image_is_not_seen_where_the_distortion_folds_over() -> None:
    """At 1.3 and 1.95 of the plane Z = 1, of which the image has 0.46: by the polynomial alone the second is at 0.21."""
    beside = np.array([0.1, 1.3, 1.95])
    points = np.column_stack([beside, np.zeros(3), np.ones(3)]) * 500.0
    targets = TargetCoordinates(("in", "out", "folded"), points, np.zeros((3, 3)), np.full(3, np.nan))
    radial = beside * (1 + LENS["k1"] * beside**2 + LENS["k2"] * beside**4)
    assert radial[2] * LENS["f"] < LENS["cx"] < radial[1] * LENS["f"]
    seen = sights([SimulatedCamera(LENS, (2592, 1944), ("one",), np.zeros((1, 6)), targets)])
    assert seen.target.tolist() == [0]
