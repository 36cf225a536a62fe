"""Scatter of repeated sets: drawn estimates, points in frames of their own, and lengths, against numpy."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.castings import turn

from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.record import Record
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.uncertainty.repeated_sets import repetition

RNG = np.random.default_rng(12)
PLACES = RNG.uniform(0, 1000, (40, 3))
NAMES = np.array([f"T{n}" for n in range(40)])


def one_set(kind: str = "calibrate-camera", moved: bool = True) -> Result:
    """A set with its own noise, in a frame of its own if it is moved."""
    places = PLACES + RNG.normal(size=PLACES.shape) * [0.01, 0.02, 0.03]
    if moved:
        places = places @ turn(RNG.normal(size=3) * 1e-4).T + RNG.normal(size=3) * 0.1
    columns = {"point": NAMES, **dict(zip("xyz", places.T, strict=True))}
    columns |= {f"s{axis}": np.full(40, std) for axis, std in zip("xyz", (0.01, 0.02, 0.015), strict=True)}
    lengths = Table(
        {
            "from": NAMES[:1],
            "to": NAMES[1:2],
            "measured": np.array([500 + RNG.normal() * 0.01]),
            "std": np.array([0.01]),
        }
    )
    estimates = (Estimate("f", 2800 + RNG.normal() * 0.2, 0.1, "px"),)
    return Result(kind, "", estimates, np.eye(1) * 0.01, {}, {"points": Table(columns), "length_errors": lengths}, {})


def test_scatter_over_many_sets() -> None:
    sets = [one_set() for _ in range(30)]
    found = {one.name: one for one in repetition(sets).quantities}
    values = np.array([one.estimates[0].value for one in sets])
    assert found["f"].sigma == pytest.approx(values.std(ddof=1)) and found["f"].mean == pytest.approx(values.mean())
    assert found["f"].ratio == pytest.approx(values.std(ddof=1) / 0.1)
    sizes = np.array([one.tables["length_errors"].numbers("measured")[0] for one in sets])
    assert found["T0 - T1"].sigma == pytest.approx(sizes.std(ddof=1))
    for axis, sigma, std in zip("xyz", (0.01, 0.02, 0.03), (0.01, 0.02, 0.015), strict=True):
        one = found[f"{axis} of 40 points"]
        # the fit takes a little from what is stated, as from the scatter
        assert one.sigma == pytest.approx(sigma, rel=0.1) and 0.96 * std < one.std < std


def test_what_points_have_in_common_is_not_stated_of_sets_laid_onto_each_other() -> None:
    """Points of 0.01 mm in a frame that a given datum holds within 0.1 mm and 0.1 mrad, drawn anew in each set."""
    centred = PLACES - PLACES.mean(axis=0)
    motions = np.concatenate(
        [np.broadcast_to(np.eye(3), (40, 3, 3)), np.cross(np.eye(3), centred[:, None]).swapaxes(1, 2)], axis=2
    )
    core = np.diag([0.1] * 3 + [1e-4] * 3) ** 2
    own = np.broadcast_to(1e-4 * np.eye(3), (40, 3, 3))
    whole = own + motions @ core @ motions.swapaxes(1, 2)
    sets = []
    for _ in range(30):
        places = PLACES + 0.01 * RNG.normal(size=PLACES.shape) + motions @ (np.sqrt(core) @ RNG.normal(size=6))
        columns = {"point": NAMES, **dict(zip("xyz", places.T, strict=True))}
        columns |= {f"s{axis}": np.sqrt(whole[:, k, k]) for k, axis in enumerate("xyz")}
        arrays = {"points_covariance": whole, "points_common": motions, "points_core": core}
        sets.append(Result("multilaterate", "", (), np.zeros((0, 0)), {}, {"points": Table(columns)}, arrays))
    ratios = [one.ratio for one in repetition(sets).quantities]
    assert len(ratios) == 3 and ratios == pytest.approx(np.ones(3), abs=0.1)


def test_points_in_a_machine_are_not_laid_onto_each_other() -> None:
    sets = [one_set("align-part") for _ in range(4)]
    one = next(one for one in repetition(sets).quantities if one.name.startswith("x of"))
    x = np.array([result.tables["points"].numbers("x") for result in sets])
    assert one.sigma == pytest.approx(np.sqrt((x.std(axis=0, ddof=1) ** 2).mean())) and one.sigma > 0.03


def test_the_command_and_what_it_refuses(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    files = []
    for n in range(3):
        files.append(tmp_path / f"{n}.h5")
        hdf5.write(files[-1], one_set(), Record("", (), "0", "2026-01-01T00:00:00Z"))
    ran = metrocli("compare", "--sets", *files, "--json", "--require", "max_ratio < 0.001")
    summary = json.loads(ran.out)
    assert ran.code == 6 and summary["sets"] == 3 and set(summary["points"]) == {f"{a} of 40 points" for a in "xyz"}
    assert "sigma/stated" in metrocli("compare", "--sets", *files).out
    assert metrocli("compare", "--sets", *files, "--require", "max_en < 1").code == 2
    equal = metrocli("compare", "--sets", *files[:1] * 3).out
    assert "0 um" in equal and "e-" not in equal  # rounding of the mean was stated with 17 digits
    with pytest.raises(InputError, match="different kinds"):
        repetition([one_set(), one_set(), replace(one_set(), kind="multilaterate")])
