"""Test lengths of a network: measured between adjusted targets, never used, and refused where they prove nothing."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images.small_jobs import network

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]


def job_with(folder: Path, rows: list[str], more: str = "", bars: str = "scale_bars: bars.csv") -> Path:
    job = network(folder)
    (folder / "tests.csv").write_text("\n".join(["from,to,length_mm,sigma_mm", *rows, ""]))
    text = job.read_text().replace("scale_bars: bars.csv", ", ".join(filter(None, [bars, "test_lengths: tests.csv"])))
    job.write_text(text + more)
    return job


def true_lengths(folder: Path) -> dict[tuple[str, str], float]:
    """Every length between two targets, from the places that the readings were simulated with."""
    network(folder)
    rows = [line.split(",") for line in (folder / "targets.csv").read_text().splitlines()[1:]]
    places = {row[0]: np.array([float(value) for value in row[1:4]]) for row in rows}
    return {(a, b): float(np.linalg.norm(places[b] - places[a])) for a, b in combinations(places, 2)}


def test_errors_are_measured_minus_calibrated_and_leave_the_network_as_it_is(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    known = {pair: size for pair, size in true_lengths(tmp_path).items() if pair != ("T0", "T4")}
    assert metrocli("calibrate-camera", network(tmp_path)).code == 0
    without = hdf5.read(tmp_path / "camera.h5")[0]
    placed = set(without.tables["points"].texts("point"))
    rows = [f"{a},{b},{size:.6f},0.002" for (a, b), size in known.items() if {a, b} <= placed]
    assert len(rows) > 100
    more = "length_limit: {constant: 20 um, proportional: 100 um/m, at_most: 40 um}\n"
    more += 'require: {length_error_over_limit: "< 1"}\n'
    ran = metrocli("calibrate-camera", job_with(tmp_path, rows, more), "--force")
    assert ran.code in (0, 6), ran.err
    result = hdf5.read(tmp_path / "camera.h5")[0]
    assert np.array_equal(result.tables["points"].stacked("xyz"), without.tables["points"].stacked("xyz"))
    table, points = result.tables["length_errors"], result.tables["points"]
    place = dict(zip(points.texts("point"), points.stacked("xyz"), strict=True))
    ends = list(zip(table.texts("from"), table.texts("to"), strict=True))
    expected = np.array([np.linalg.norm(place[b] - place[a]) - round(known[a, b], 6) for a, b in ends])
    assert np.allclose(table.numbers("error"), expected, atol=1e-9)
    # the same uncertainty from the factors of the joint covariance
    row = {name: n for n, name in enumerate(points.texts("point"))}
    one, other = (np.array([row[pair[k]] for pair in ends]) for k in (0, 1))
    common, core = result.arrays["points_common"], result.arrays["points_core"]
    whole = result.arrays["points_covariance"]
    away = points.stacked("xyz")[other] - points.stacked("xyz")[one]
    along = away / np.linalg.norm(away, axis=1)[:, None]
    between = common[one] @ core @ np.swapaxes(common[other], 1, 2)
    joint = whole[one] + whole[other] - between - np.swapaxes(between, 1, 2)
    assert np.allclose(table.numbers("std") ** 2, np.einsum("na,nab,nb->n", along, joint, along) + 0.002**2)
    share = np.abs(expected) / np.minimum(0.020 + 100e-6 * np.array([known[one] for one in ends]), 0.040)
    assert result.statistics["length_error_over_limit"] == pytest.approx(share.max(), rel=1e-4)
    assert ran.code == (6 if share.max() > 1 else 0)
    assert result.statistics["length_measuring_error"] == pytest.approx(np.abs(expected).max())
    assert "less than the guideline asks for" in ran.out


@pytest.mark.slow
def test_the_uncertainty_is_the_scatter_of_repeated_readings(tmp_path: Path, metrocli: Metrocli) -> None:
    """More noise of the same size is added to the readings, again and again; ends are correlated by the poses."""
    pairs = [("T1", "T9"), ("T0", "T14"), ("T2", "T7"), ("T10", "T11"), ("T3", "T13"), ("T0", "T1")]
    known = true_lengths(tmp_path)
    job = job_with(tmp_path, [f"{a},{b},{known[a, b]:.6f},0.00001" for a, b in pairs])
    (tmp_path / "bars.csv").write_text("from,to,length_mm,sigma_mm\nT0,T4,240.0,0.00001\n")
    observations = tmp_path / "observations.csv"
    lines = [line.split(",") for line in observations.read_text().splitlines()]
    rng, errors, table = np.random.default_rng(8), [], None
    for _ in range(10):
        assert metrocli("calibrate-camera", job, "--force").code in (0, 6)
        table = hdf5.read(tmp_path / "camera.h5")[0].tables["length_errors"]
        errors.append(table.numbers("error"))
        rows = [[*row[:2], *(f"{float(value) + rng.normal() * 0.05:.4f}" for value in row[2:4])] for row in lines[1:]]
        observations.write_text("\n".join(",".join(row) for row in [lines[0][:4], *rows]) + "\n")
    assert table is not None
    score = (np.array(errors[1:]) - errors[0]) / table.numbers("std")
    assert 0.75 < np.sqrt((score**2).mean()) < 1.3


def test_lengths_that_prove_nothing(tmp_path: Path, metrocli: Metrocli) -> None:
    job = job_with(tmp_path, ["T4,T0,240.0,0.005", "T1,T9,100,0.005"])
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3 and "tests.csv:2: error: the length T0 - T4 is a scale bar of this adjustment too" in ran.err
    ran = metrocli("calibrate-camera", job_with(tmp_path, ["T1,T9,100,0.005"], bars=""))
    assert ran.code == 3 and "the network has no scale that lengths could test" in ran.err
    ran = metrocli("calibrate-camera", job_with(tmp_path, ["T1,X9,100,0.005", "T2,T2,100,0"]))
    assert ran.code == 3
    twice = metrocli("calibrate-camera", job_with(tmp_path, ["T1,T9,100,0.005", "T9,T1,100,0.005"]))
    assert (twice.code, "tests.csv:3: error: a second test length between 'T9' and 'T1'" in twice.err) == (3, True)
    for message in ("end 'X9' is not in the list", "from 'T2' to itself", "the sigma of the test length is not above"):
        assert message in ran.err


@pytest.mark.alike
@pytest.mark.parametrize(("unit", "doubted"), [("mm", False), ("m", True)])
def test_bars_in_another_unit_than_the_list_are_warned_of(
    unit: str, doubted: bool, tmp_path: Path, metrocli: Metrocli
) -> None:
    job = network(tmp_path)
    (tmp_path / "bars.csv").write_text(f"from,to,length_{unit},sigma_{unit}\nT0,T4,240.0,0.005\n")
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 0, ran.err
    assert ("the network has 1e+03 times the size of the list of targets: check the units" in ran.err) is doubted
