"""A photogrammetric network of 115 images against the published adjustment (skipped where the data are absent).

The published model holds the affinity C1, C2 on the ideal image point, in mm with image y up, under a balanced radial
polynomial: `x = g xi (..) + C1 xi + C2 yi` with `g = 1 - A1 R0^2 - A2 R0^4`. Here `u = f (1 + aspect) (x' + skew y')`
with f = g c and v down, so aspect = C1 / g and skew = -C2 / g.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from places import SHARED

DATA = SHARED / "data" / "aicon-network"
Metrocli = Callable[..., Any]
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA}")

PIXEL = 35.968 / 8688
R0 = 13.488
A1, A2, C1, C2 = -1.096069e-4, 1.495660e-7, -7.00801e-5, -3.12627e-5
PUBLISHED = {"c": (28.78507, 2.513e-4), "x0": (0.01734892, 3.442e-4), "y0": (0.05668731, 3.263e-4)}
"""Value and standard deviation in mm"""
PUBLISHED_STD = {"A1": 2.979e-8, "A2": 7.656e-11, "B1": 1.191e-7, "B2": 1.0439e-7}
ESTIMATED = ("c", "x0", "y0", "A1", "A2", "B1", "B2")
"""Order of the correlations in the reference"""


@dataclass(frozen=True)
class Found:
    """The network as metrocli adjusts it."""

    result: Any
    published_points: Any

    def form(self, name: str) -> tuple[float, float]:
        """Return value and standard uncertainty of a photogrammetric parameter."""
        table = self.result.tables["conventions"]
        rows = zip(
            table.texts("form"), table.texts("parameter"), table.numbers("value"), table.numbers("std"), strict=True
        )
        return next(
            (v, s) for form, parameter, v, s in rows if form.startswith("photogrammetric") and parameter == name
        )


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Found]:
    from metrocli.cli.commands import run
    from metrocli.formats import csv, hdf5

    job = tmp_path_factory.mktemp("network") / "network.yaml"
    g = 1 - A1 * R0**2 - A2 * R0**4
    files = ", ".join(f"{name}: {DATA / name}.csv" for name in ("observations", "targets", "scale_bars"))
    job.write_text(
        f"metrocli: 1\njob: calibrate-camera\nrig: network\ninputs: {{{files}}}\nnoise: estimated\n"
        f"camera:\n  image_size: [8688, 5792]\n  pixel_size: {PIXEL * 1e3!r} um\n  reference_radius: {R0} mm\n"
        f"  aspect: {C1 / g!r}\n  skew: {-C2 / g!r}\n  estimate: [f, cx, cy, k1, k2, p1, p2]\noutput: network.h5\n"
    )
    assert run(["calibrate-camera", str(job), "--quiet"]) == 0
    points = csv.read(DATA / "published_points.csv", _points())
    yield Found(hdf5.read(job.parent / "network.h5")[0], points)


def _points() -> Any:
    from metrocli.table import TEXT, Column, Columns

    return Columns((Column("target", TEXT), *(Column(axis, "length") for axis in "xyz")), ("target",), "points")


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLISHED)
def test_interior_orientation_is_the_published_one(name: str, found: Found) -> None:
    value, std = PUBLISHED[name]
    ours = found.form(name)
    assert abs(ours[0] - value) < 0.1 * std
    assert ours[1] == pytest.approx(std, rel=0.01)


@pytest.mark.parametrize("name", PUBLISHED_STD)
def test_standard_deviations_of_distortion_are_the_published_ones(name: str, found: Found) -> None:
    assert found.form(name)[1] == pytest.approx(PUBLISHED_STD[name], rel=0.01)


def test_the_held_affinity_is_the_published_one(found: Found) -> None:
    assert found.form("C1")[0] == pytest.approx(C1, rel=1e-4)
    assert found.form("C2")[0] == pytest.approx(C2, rel=1e-4)


def test_correlations_are_those_of_an_independent_adjustment(found: Found) -> None:
    reference = json.loads((DATA / "reference.json").read_text())["models"]["A1A2B1B2/forward"]
    table = found.result.tables["conventions"]
    names = [
        name
        for form, name in zip(table.texts("form"), table.texts("parameter"), strict=True)
        if form.startswith("photogrammetric")
    ]
    at = [names.index(name) for name in ESTIMATED]
    covariance = found.result.arrays["photogrammetric_covariance"][np.ix_(at, at)]
    std = np.sqrt(np.diag(covariance))
    assert std == pytest.approx([found.form(name)[1] for name in ESTIMATED])
    assert covariance / std[:, None] / std == pytest.approx(np.array(reference["correlation"]), abs=0.005)


def test_the_residuals_are_those_of_an_independent_adjustment(found: Found) -> None:
    reference = json.loads((DATA / "reference.json").read_text())["models"]["A1A2B1B2/forward"]
    statistics = found.result.statistics
    assert statistics["rms"]["px"] == pytest.approx(reference["rms_px_point"], rel=1e-3)
    assert statistics["sigma0"] * PIXEL == pytest.approx(reference["s0_mm"], rel=1e-3)
    assert statistics["dof"] == reference["redundancy"]
    assert (statistics["observations"], statistics["unknowns"]) == (19945, 1147)


def test_object_points_are_the_published_ones(found: Found) -> None:
    from metrocli.geometry import poses

    there = dict(zip(found.published_points.texts("target"), found.published_points.stacked("xyz"), strict=True))
    points = found.result.tables["points"]
    common = [name in there for name in points.texts("point")]
    ours = points.stacked("xyz")[common]
    theirs = np.array([there[name] for name in points.texts("point") if name in there])
    assert len(ours) > 140
    difference = poses.apply(poses.fit_pose(ours, theirs), ours) - theirs
    assert np.sqrt((difference**2).mean()) < 0.02


def test_targets_that_no_image_shows_are_named(found: Found) -> None:
    assert any("7 targets of the list seen in no image: 1017, 1075" in line for line in found.result.warnings)
