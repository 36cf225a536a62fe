"""Cameras of people: corners that a detector calls not found, lenses that the readings do not cover."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Case = Callable[[str], Path]
Metrocli = Callable[..., Any]


def test_corners_that_mrgingham_did_not_find(case: Case, metrocli: Metrocli) -> None:
    """The reader of mrcal skips them; the truth is f = 1761.2 px."""
    case("06-vnl-level-skip")
    ran = metrocli("import", "corners.vnl", "--from", "vnl")
    assert ran.code == 0 and "5 corners that the file calls not found are left out" in ran.err
    assert metrocli("calibrate-camera", "job.yaml").code == 0
    f = json.loads(metrocli("show", "r.h5", "--json").out)["estimates"]["f"]
    assert abs(f["value"] - 1761.2) < 2 * f["std"]


def test_rational_terms_of_boards_in_the_middle(case: Case, metrocli: Metrocli) -> None:
    """Readings cover 6 % of the image; in a corner the lens is off by 130 px."""
    case("10-rational-uncovered")
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 6 and "readings span 6 % of the image, up to 23 % of its radius" in ran.out
