"""Measured ranges against surveyed beacons (skipped where the data are absent)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks import ranges

FIRST, *MORE = ranges.DRIVES
DRIVES = pytest.mark.parametrize("drive", [FIRST, *(pytest.param(one, marks=pytest.mark.slow) for one in MORE)])
pytestmark = pytest.mark.skipif(not ranges.DATA.is_dir(), reason=f"no measured data at {ranges.DATA}")


@DRIVES
def test_beacons_are_where_they_were_surveyed(drive: str) -> None:
    """Within the stated uncertainty with the common scale in the model: each, and all eight coordinates together."""
    found = ranges.adjusted(drive)
    share = found.error / found.std
    assert np.abs(share).max() < 2.6
    assert (share**2).sum() < chi2.ppf(0.99, share.size)
    scale = found.estimates["length-scale.scale"]
    assert scale["value"] == pytest.approx(0.069, abs=3e-3) and scale["std"] < 1e-3


@pytest.mark.slow
@DRIVES
def test_without_the_scale_they_are_not(drive: str) -> None:
    """Or the test above would pass without the effect; sigma0 tells that the model is wrong."""
    found = ranges.adjusted(drive, "[]")
    assert np.abs(found.error / found.std).max() > 20
    assert np.linalg.norm(found.error, axis=1).max() > 2000
    assert found.statistics["sigma0"] > 2
