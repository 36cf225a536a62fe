"""`variance_groups:` in jobs: the noise of the readings of one place, in every kind that is adjusted."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images import small_jobs

from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import JobOptions, load

Metrocli = Callable[..., Any]


@pytest.mark.parametrize(
    ("sample", "job", "by"),
    [
        ("ball-cube", "views", "view"),
        ("best-fit", "fit", "point"),
        ("gear-m3d3", "tip3", "tracer"),
        ("hall-trackers", "hall", "station"),
        ("machine-lengths", "lengths", "tracer"),
        ("machine-methods", "six-dof", "line"),
        ("five-axis", "after", "ball"),
        ("xm60-launch-unit", "table", "pose"),
    ],
)
def test_readings_of_one_place_have_so_many_times_the_noise(
    sample: str, job: str, by: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    metrocli("init", tmp_path / "p", "--sample", sample)
    path = tmp_path / "p" / "jobs" / f"{job}.yaml"
    before = adjusted_job_of(load(path, JobOptions())).model
    name = before.places[by].names[0]
    with path.open("a") as file:
        file.write(f"variance_groups: [{{by: {by}, only: '{name}', ratio: 3}}]\n")
    after = adjusted_job_of(load(path, JobOptions())).model
    own = 0
    for group in after.readings:
        index = group.observations.index.get(after.places[by].index)
        changed = group.observations.deviations / before.group(group.name).observations.deviations
        expected = np.ones(group.observations.count)
        if index is not None:
            expected[(np.atleast_2d(index) == 0).any(axis=0)] = 3.0
        # noise that depends on the geometry follows the solution, and one that is estimated the residuals
        ratio = changed / np.median(changed[:, expected == 1]) if (expected == 1).any() else changed
        assert ratio == pytest.approx(np.broadcast_to(expected, ratio.shape), rel=1e-2)
        own += int((expected == 3).sum())
    assert own


def estimates(metrocli: Metrocli, kind: str, job: Path) -> dict[str, tuple[float, float]]:
    ran = metrocli(kind, job, "--json", "--force", "--accept-doubtful")
    assert ran.code in (0, 6), ran.err
    return {name: (one["value"], one["std"]) for name, one in json.loads(ran.out)["estimates"].items()}


def test_the_result_is_that_of_a_column_of_sigmas(tmp_path: Path, metrocli: Metrocli) -> None:
    """Of a board, one image of which has 2.5 times the noise: in the job, or at each of its readings."""
    job = small_jobs.board(tmp_path)
    plain = job.read_text()
    file = tmp_path / "observations.csv"
    rows = list(csv.DictReader(file.read_text().splitlines()))
    image, noise = rows[0]["image"], 0.05
    job.write_text(plain + f"variance_groups: [{{by: image, only: {image}, ratio: 2.5}}]\n")
    stated = estimates(metrocli, "calibrate-camera", job)
    job.write_text(plain)
    unweighted = estimates(metrocli, "calibrate-camera", job)
    with file.open("w", newline="") as target:
        writer = csv.DictWriter(target, [*rows[0], "sigma_px"])
        writer.writeheader()
        writer.writerows({**row, "sigma_px": 2.5 * noise if row["image"] == image else noise} for row in rows)
    by_column = estimates(metrocli, "calibrate-camera", job)
    for name, (value, std) in by_column.items():
        assert stated[name] == pytest.approx((value, std), rel=1e-9, abs=1e-9), name
    assert any(abs(unweighted[name][0] - value) > 1e-3 * std for name, (value, std) in by_column.items())


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("{by: picture, only: a, ratio: 2}", "the readings have no 'picture' of their own"),
        ("{by: tracer, only: LT9, ratio: 2}", "there is no tracer 'LT9'"),
        ("{by: tracer, only: LT1, ratio: 2}, {by: tracer, only: LT1, ratio: 3}", "tracer LT1 is listed twice"),
        ("{by: tracer, only: LT1, ratio: 0}", "ratio"),
        ("{by: tracer, ratio: 2}", "only"),
    ],
)
def test_a_wrong_entry_is_named_with_its_line(entry: str, message: str, tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "gear-m3d3")
    path = tmp_path / "p" / "jobs" / "tip3.yaml"
    path.write_text(f"{path.read_text()}variance_groups: [{entry}]\n")
    ran = metrocli("multilaterate", path)
    assert ran.code == 3 and message in ran.err
    assert f"tip3.yaml:{len(path.read_text().splitlines())}" in ran.err


def test_kinds_without_readings_refuse_them(tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "gauge-block")
    path = min((tmp_path / "p" / "jobs").glob("*.yaml"))
    path.write_text(f"{path.read_text()}variance_groups: [{{by: tracer, only: LT1, ratio: 2}}]\n")
    ran = metrocli("report-uncertainty", path)
    assert ran.code == 3 and "report-uncertainty jobs take no `variance_groups`" in ran.err


def test_the_extended_job_states_what_was_found_and_is_clean(tmp_path: Path, metrocli: Metrocli) -> None:
    """Axes of the pixels that are not at right angles, and one image with six times the noise of the others."""
    job, rng = small_jobs.board(tmp_path), np.random.default_rng(2026)
    file = tmp_path / "observations.csv"
    rows = list(csv.DictReader(file.read_text().splitlines()))
    noisy = rows[-1]["image"]
    u, v = (np.array([float(row[key]) for row in rows]) for key in ("u_px", "v_px"))
    u = u + 1e-3 * (v - 972.0)
    spread = np.where([row["image"] == noisy for row in rows], 0.3, 0.0)
    u, v = u + spread * rng.normal(size=len(u)), v + spread * rng.normal(size=len(v))
    with file.open("w", newline="") as target:
        writer = csv.DictWriter(target, list(rows[0]))
        writer.writeheader()
        writer.writerows({**row, "u_px": a, "v_px": b} for row, a, b in zip(rows, u.tolist(), v.tolist(), strict=True))
    found = json.loads(metrocli("diagnose", job, "--json", "--accept-doubtful").out)
    assert "axis-skew" in [effect["name"] for effect in found["effects"]]
    extended = tmp_path / "job.extended.yaml"
    stated = load(extended, JobOptions(accept_doubtful=True)).heading.variance_groups
    assert [(group.by, group.only) for group in stated] == [("image", noisy)]
    assert stated[0].ratio == pytest.approx(np.hypot(0.3, 0.05) / 0.05, rel=0.2)
    again = json.loads(metrocli("diagnose", extended, "--json", "--accept-doubtful").out)
    assert again["verdict"] == "clean" and not again["noise"]["apart"]
