"""Simulated networks: calibrated lengths are right between the true places, so that sets of images can be repeated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images.small_jobs import network

from metrocli.errors import InputError
from metrocli.formats import csv, hdf5
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.settings import TEST_LENGTHS
from metrocli.tasks.calibrate_camera.simulation import with_lengths
from metrocli.tasks.multilaterate.settings import POINTS
from metrocli.tasks.shared.images.target_list import TargetCoordinates

Metrocli = Callable[..., Any]
TRUTH = "simulation: {lens: {f: 2813 px, k1: 0.2, k2: -0.1}, images: 8, distance: 500 mm, tilt: 40 deg}\n"


class Centred:
    """Random numbers that are all 0: every drawn value is the listed one."""

    def normal(self, mean: float, std: float, size: Any) -> Any:
        return np.zeros(size)


def lengths(*rows: tuple[str, str, float, float]) -> Table:
    one, other, length, sigma = zip(*rows, strict=True)
    columns = {"from": np.array(one), "to": np.array(other), "length": np.array(length), "sigma": np.array(sigma)}
    return Table(columns, {"length": "mm", "sigma": "mm"})


def targets(points: list[list[float]], sigma: list[float]) -> TargetCoordinates:
    names = tuple("ABCDEFG"[: len(points)])
    return TargetCoordinates(
        names,
        np.array(points, dtype=float),
        np.repeat(np.array(sigma)[:, None], 3, axis=1),
        np.full(len(names), np.nan),
    )


def test_sets_that_are_simulated_from_a_rough_list_keep_their_test_lengths(tmp_path: Path, metrocli: Metrocli) -> None:
    job = network(tmp_path)
    places = [row.split(",") for row in (tmp_path / "targets.csv").read_text().splitlines()]
    rough = [[row[0], *(f"{round(float(value) / 5) * 5:g}" for value in row[1:4]), ""] for row in places[1:]]
    (tmp_path / "targets.csv").write_text("\n".join(map(",".join, [places[0], *rough])) + "\n")
    (tmp_path / "bars.csv").write_text("from,to,length_mm,sigma_mm\nT0,T4,241.3,0.005\n")
    tests = ["T5,T9,238.5,0.004", "T5,T8,180.7,0.004", "T0,T19,303.3,0.004"]
    (tmp_path / "tests.csv").write_text("\n".join(["from,to,length_mm,sigma_mm", *tests, ""]))
    job.write_text(job.read_text().replace("bars.csv}", "bars.csv, test_lengths: tests.csv}") + TRUTH)
    for seed in ("1", "2"):
        out = tmp_path / seed
        assert metrocli("simulate", job, "--seed", seed, "--out", out).code == 0
        truth = csv.read(out / "true_points.csv", POINTS)
        place = dict(zip(truth.texts("point"), truth.stacked("xyz"), strict=True))
        known = csv.read(tmp_path / "tests.csv", TEST_LENGTHS)
        for a, b, size in zip(known.texts("from"), known.texts("to"), known.numbers("length"), strict=True):
            assert np.linalg.norm(place[b] - place[a]) == pytest.approx(size, abs=0.02)
        seen = ["--set", f"inputs.observations={seed}/observations.csv", "--output", tmp_path / f"{seed}.h5"]
        assert metrocli("calibrate-camera", job, *seen).code == 0
        assert hdf5.read(tmp_path / f"{seed}.h5")[0].statistics["length_max_en"] < 2


def test_places_and_lengths_give_way_by_their_uncertainties() -> None:
    """Between two places on a line the length is the weighted mean; all else stays."""
    listed = targets([[0, 0, 0], [100, 0, 0], [50, 70, 0]], [0.3, 0.4, 0.0])
    found = with_lengths(listed, [("bar", lengths(("A", "B", 101.0, 1.2)))], Centred())  # type: ignore[arg-type]
    variance = np.array([0.3, 0.4, 1.2]) ** 2
    shares = variance / variance.sum()
    assert np.allclose(found.points, [[-shares[0], 0, 0], [100 + shares[1], 0, 0], [50, 70, 0]], atol=1e-9)


def test_the_places_minimise_the_weighted_squares() -> None:
    from scipy.optimize import least_squares

    rng = np.random.default_rng(3)
    listed = targets((rng.normal(size=(5, 3)) * 400).tolist(), [2.0, 0.5, 5.0, 0.0, 1.0])
    rows = [("A", "B", 3.0, 0.5), ("A", "C", -4.0, 0.2), ("B", "D", 1.0, 0.01), ("C", "E", 2.0, 0.4)]
    place = {name: k for k, name in enumerate(listed.names)}
    true = {(a, b): np.linalg.norm(listed.points[place[b]] - listed.points[place[a]]) for a, b, *_ in rows}
    table = lengths(*((a, b, float(true[a, b]) + more, std) for a, b, more, std in rows))
    found = with_lengths(listed, [("bar", table)], Centred())  # type: ignore[arg-type]

    def misfit(scaled: Any) -> Any:
        points = listed.points + scaled.reshape(5, 3) * listed.sigma
        now = np.array([np.linalg.norm(points[place[b]] - points[place[a]]) for a, b, *_ in rows])
        return np.concatenate([scaled, (table.numbers("length") - now) / table.numbers("sigma")])

    best = least_squares(misfit, np.zeros(15), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert np.allclose(found.points, listed.points + best.reshape(5, 3) * listed.sigma, atol=1e-5)


def test_exact_places_stay_and_ends_that_are_no_targets_are_named() -> None:
    listed = targets([[0, 0, 0], [100, 0, 0], [250, 0, 0]], [0.0, 0.0, np.nan])
    bars = lengths(("A", "B", 120.0, 0.01), ("B", "C", 151.0, 0.001))
    found = with_lengths(listed, [("bar", bars)], Centred())  # type: ignore[arg-type]
    assert np.allclose(found.points, [[0, 0, 0], [100, 0, 0], [251, 0, 0]], atol=1e-6)
    assert with_lengths(listed, [("bar", None)], Centred()) is listed  # type: ignore[arg-type]
    with pytest.raises(InputError, match="scale bar end 'X' is not in the list of targets"):
        with_lengths(listed, [("scale bar", lengths(("A", "X", 1.0, 0.1)))], Centred())  # type: ignore[arg-type]


def test_lengths_that_no_places_have_are_refused() -> None:
    """Three lengths on a line of which one is longer than the others together, all known better than the places."""
    listed = targets([[0, 0, 0], [100, 0, 0], [200, 0, 0]], [0.001, 0.001, 0.001])
    bars = lengths(("A", "B", 100.0, 1e-6), ("B", "C", 100.0, 1e-6), ("A", "C", 230.0, 1e-6))
    with pytest.raises(InputError, match="no places of the targets give the calibrated lengths"):
        with_lengths(listed, [("bar", bars)], Centred())  # type: ignore[arg-type]


def test_a_length_far_from_the_list_is_a_mistake(tmp_path: Path, metrocli: Metrocli) -> None:
    job = network(tmp_path)
    job.write_text(job.read_text() + TRUTH)
    (tmp_path / "bars.csv").write_text("from,to,length_mm,sigma_mm\nT5,T9,241,0.005\nT0,T4,2400,0.005\n")
    ran = metrocli("simulate", job, "--out", tmp_path / "new")
    assert ran.code == 3 and not (tmp_path / "new").exists()
    assert "bars.csv:3: error: the calibrated length is 2400 mm, the list of targets has 240 mm" in ran.err
    assert "bars.csv:2" not in ran.err
