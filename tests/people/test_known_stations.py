"""Points from distances to known stations: any start, one point, equal readings, a delay that all share."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Case = Callable[[str], Path]
Metrocli = Callable[..., Any]
TRUTH = {"P": (5.10, -1.20, 7.10), "Q": (4.20, -3.10, 5.30), "R": (6.20, -2.20, 8.10), "S": (3.30, -4.10, 9.20)}
"""Places of the tag that the ranges were drawn from [m]"""


def points(metrocli: Metrocli, *more: str, job: str = "job.yaml", code: int = 0) -> dict[str, Any]:
    ran = metrocli("multilaterate", job, *more, "--force")
    assert ran.code == code, ran.err
    folder = Path(job).parent
    table = metrocli("export", folder / "r.h5", "--to", "csv", "--out", "out", "--force", "--accept-doubtful")
    assert table.code == 0, table.err
    rows = [line.split(",") for line in Path("out/points.csv").read_text().splitlines() if not line.startswith("#")]
    return {row[0]: np.array(row[1:4], dtype=float) for row in rows[1:]}


def test_one_point_from_four_stations(case: Case, metrocli: Metrocli) -> None:
    case("01-one-point")
    assert np.abs(points(metrocli)["P"] - [5350, -1870, 7150]).max() < 10


def test_one_point_in_a_plane(case: Case, metrocli: Metrocli) -> None:
    case("01-one-point")
    files = [f"inputs.{name}={name}2d.csv" for name in ("points", "tracers", "lengths")]
    found = points(metrocli, *(part for file in files for part in ("--set", file)))
    assert np.abs(found["U"] - [2091333, 1136241, 0]).max() < 1.0


def test_equal_distances_are_a_warning(case: Case, metrocli: Metrocli) -> None:
    case("02-equal-ranges")
    assert np.abs(points(metrocli)["P"] - [5350, -1870, 7160]).max() < 10
    assert "all lengths are equal" in metrocli("show", "r.h5").err


@pytest.mark.alike
@pytest.mark.parametrize("start", ["points", "points_prior", "points_same"])
def test_any_start_leads_to_the_points(case: Case, metrocli: Metrocli, start: str) -> None:
    case("03-rough-starts")
    found = points(metrocli, "--set", f"inputs.points={start}.csv")
    assert max(np.abs(found[name] - np.multiply(1e3, place)).max() for name, place in TRUTH.items()) < 80


def test_thirty_points_from_one_start(case: Case, metrocli: Metrocli) -> None:
    case("03-rough-starts")
    assert len(points(metrocli, job="eight/job.yaml")) == 30


def test_lists_are_not_blamed_for_a_delay(case: Case, metrocli: Metrocli) -> None:
    """All distances are 150 mm too short: the lists of places are right and not named."""
    case("05-offset-blamed-on-list")
    ran = metrocli("multilaterate", "job.yaml", "--json")
    assert ran.code == 6 and "list is wrong" not in ran.out
    extended = points(metrocli, "--set", "effects=[{name: length-offset}]")
    assert len(extended) == 30
    figures = json.loads(metrocli("show", "r.h5", "--json").out)
    (offset,) = [one for name, one in figures["estimates"].items() if "offset" in name]
    assert abs(offset["value"] + 150) < 5


def test_the_delay_is_named_and_no_file(case: Case, metrocli: Metrocli) -> None:
    case("05-offset-blamed-on-list")
    ran = metrocli("diagnose", "job.yaml", "--json")
    found = json.loads(ran.out)
    assert (found["verdict"], found["mistake"]) == ("explained", None)
    (offset,) = [one for one in found["effects"] if one["name"] == "length-offset"]
    assert abs(next(iter(offset["parameters"].values()))["value"] + 150) < 5
