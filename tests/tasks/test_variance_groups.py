"""`variance_groups:` in jobs: the noise of the readings of one place, in every kind that is adjusted."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hints.bases import two_cameras
from tasks.calibrate_camera import test_multi_camera as rig
from tasks.shared.images import small_jobs

from metrocli.adjust.dense_jacobian import unit_noise
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.diagnosis.corrections import Mistake
from metrocli.diagnosis.job_entries import proposed_variances
from metrocli.diagnosis.mistakes import Mistaken
from metrocli.project.diagnosed import adjusted_job_of, carry_out, write_extended
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
        ("{by: tracer, only: LT9x, ratio: 2}", "allowed: LT1, LT2, LT3, LT4"),
        ("{by: tracr, only: LT1, ratio: 2}", "did you mean 'tracer'?"),
        ("{by: reading, only: lengths, ratio: 2}", "the readings have no 'reading' of their own"),
        ("{by: tracer, only: [LT1, LT2], ratio: 2}", "there is no tracer 'LT1 LT2'"),
        ("{by: tracer, only: LT1, ratio: 2 mm}", "'2 mm' is not a plain number"),
        ("{by: tracer, only: LT1, ratio: 1e9}", "1e9 is out of range"),
        ("{by: tracer, only: LT1, ratio: 1e-300}", "1e-300 is out of range"),
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


def test_readings_of_one_kind_have_so_many_times_the_noise(tmp_path: Path, metrocli: Metrocli) -> None:
    """A kind of reading is a group of its own: elevations of a network; a place beside it multiplies."""
    metrocli("init", tmp_path / "p", "--sample", "hall-trackers")
    path = tmp_path / "p" / "jobs" / "hall.yaml"
    before = adjusted_job_of(load(path, JobOptions())).model
    with path.open("a") as file:
        file.write("variance_groups: [{by: reading, only: el, ratio: 4}, {by: station, only: S3, ratio: 2}]\n")
    after = adjusted_job_of(load(path, JobOptions())).model
    for group in after.readings:
        station = np.array(group.observations.keys.get("station", ("",) * group.observations.count))
        expected = np.where(station == "S3", 2.0, 1.0) * (4.0 if group.name == "el" else 1.0)
        ratio = group.observations.deviations[0] / before.group(group.name).observations.deviations[0]
        assert ratio == pytest.approx(expected, rel=1e-3)


def test_a_ball_is_named_by_its_indices(tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "ball-cube")
    path = tmp_path / "p" / "jobs" / "views.yaml"
    with path.open("a") as file:
        file.write("variance_groups: [{by: ball, only: [1, 0, -2], ratio: 3}]\n")
    model = adjusted_job_of(load(path, JobOptions())).model
    ball = model.places["ball"].names.index("1 0 -2")
    ratios = model.readings[0].observations.ratios
    assert ratios is not None
    assert ((ratios == 3) == (model.readings[0].observations.index["artefact_error"] == ball)).all()


def test_places_without_readings_and_jobs_without_places_are_named(tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "machine-methods")
    path = tmp_path / "p" / "jobs" / "standstill.yaml"
    path.write_text(f"{path.read_text()}variance_groups: [{{by: point, only: P001, ratio: 2}}]\n")
    ran = metrocli("calibrate-machine", path)
    assert ran.code == 3 and "they are of one kind and have no places: leave it out" in ran.err
    job = small_jobs.board(tmp_path)
    targets = tmp_path / "targets.csv"
    first = targets.read_text().splitlines()[1]
    unseen = ",".join(["unseen", *first.split(",")[1:-1], "500.0"])
    targets.write_text(f"{targets.read_text()}{unseen}\n")
    job.write_text(f"{job.read_text()}variance_groups: [{{by: target, only: unseen, ratio: 2}}]\n")
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3 and "variance_groups: target 'unseen' has no readings" in ran.err


def test_jobs_that_cannot_weight_them_name_the_key(tmp_path: Path, metrocli: Metrocli) -> None:
    """None is left aside in silence: features alone, points of several stations, and methods as printed."""
    entry, fit = "variance_groups: [{by: reading, only: z, ratio: 2}]\n", tmp_path / "fit.yaml"
    rows = [f"{i % 2},S,Q{i},{np.cos(i):.4f},{np.sin(i):.4f},{i % 3}" for i in range(12)]
    for key, shape in (("feature", "features: {S: {shape: cylinder}}\n"), ("station", "")):
        kept = [row.split(",")[0 if key == "station" else 1] + "," + row.split(",", 2)[2] for row in rows]
        (tmp_path / "points.csv").write_text(f"{key},point,x_mm,y_mm,z_mm\n" + "\n".join(kept) + "\n")
        fit.write_text(f"metrocli: 1\njob: fit-points\ninputs: {{points: points.csv}}\n{shape}noise: 10 um\n{entry}")
        for command in (("fit-points", fit), ("check", fit)):
            ran = metrocli(*command)
            assert ran.code == 3 and "`variance_groups`: " in ran.err and "`effects`" not in ran.err
    metrocli("init", tmp_path / "p", "--sample", "xm60-launch-unit")
    path = tmp_path / "p" / "jobs" / "ideal.yaml"
    path.write_text(f"{path.read_text()}method: lines\nvariance_groups: [{{by: reading, only: phi2, ratio: 2}}]\n")
    ran = metrocli("locate-launch-unit", path)
    assert ran.code == 3 and "`variance_groups`: only `method: adjustment` can have them" in ran.err


def test_a_requirement_of_a_misspelt_effect_is_no_fault_beside_it(tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "gear-m3d3")
    path = tmp_path / "p" / "jobs" / "tip3.yaml"
    named = "effects: [{name: dead-path-drif, tracer: LT2}]\nvariance_groups: [{by: tracer, only: LT1, ratio: 2}]\n"
    required = path.read_text().replace("require: {", 'require: {"dead-path-drift LT2 rate": "< 1 um/min", ')
    path.write_text(required + named)
    ran = metrocli("multilaterate", path, "--json")
    assert [fault["message"] for fault in json.loads(ran.out)["errors"]] == ["unknown effect 'dead-path-drif'"]


def test_noise_of_one_size_has_no_variance_groups() -> None:
    observations = Observations(np.zeros((2, 3)), np.ones(1), ratios=np.array([1.0, 2.0, 3.0]))
    group = unit_noise(Group("readings", Chain(()), observations), 0.5)
    assert (group.observations.deviations == 0.5).all()


def noisy_heights(folder: Path) -> Path:
    """Write a best fit of 40 points whose z has six times the noise of x and y."""
    rng, job = np.random.default_rng(4), folder / "fit.yaml"
    nominal = rng.uniform(-1000, 1000, (40, 3))
    measured = nominal + rng.normal(size=(40, 3)) * [0.01, 0.01, 0.06] + [10, 20, 30]
    for name, points in (("nominal", nominal), ("measured", measured)):
        lines = [f"Q{i},{x:.5f},{y:.5f},{z:.5f}" for i, (x, y, z) in enumerate(points.tolist())]
        (folder / f"{name}.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *lines]) + "\n")
    inputs = "inputs: {points: measured.csv, nominal: nominal.csv}"
    job.write_text(f"metrocli: 1\njob: fit-points\n{inputs}\nnoise: 10 um\noutput: fit.h5\n")
    return job


def test_a_clean_job_has_an_extended_one_where_a_noise_is_found(tmp_path: Path, metrocli: Metrocli) -> None:
    """Of a kind of reading, the z of a best fit; a ratio that the job states is multiplied by the one found."""
    job, extended = noisy_heights(tmp_path), tmp_path / "fit.extended.yaml"
    for stated in (1.0, 2.0):
        if stated != 1:
            job.write_text(f"{job.read_text()}variance_groups: [{{by: reading, only: z, ratio: {stated}}}]\n")
        ran = metrocli("diagnose", job, "--force")
        assert "verdict: clean, but z is" in ran.out
        assert "next: `metrocli fit-points" in ran.out and "are for the noise of each place" in ran.out
        (group,) = load(extended, JobOptions()).heading.variance_groups
        assert (group.by, group.only) == ("reading", "z") and group.ratio == pytest.approx(6, rel=0.35)
        assert metrocli("fit-points", extended, "--force").code == 0
        again = json.loads(metrocli("diagnose", extended, "--json").out)
        assert again["verdict"] == "clean" and not again["noise"]["apart"]
        assert not (tmp_path / "fit.extended.extended.yaml").exists()


def with_noise(file: Path, images: tuple[str, ...], sigma: float) -> None:
    """Add noise [px] to the readings of some images."""
    rng, rows = np.random.default_rng(5), list(csv.DictReader(file.read_text().splitlines()))
    for row in rows:
        if row["image"] in images:
            row |= {key: str(float(row[key]) + sigma * float(rng.normal())) for key in ("u_px", "v_px")}
    with file.open("w", newline="") as target:
        writer = csv.DictWriter(target, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.mark.parametrize("several", [False, True])
def test_a_noise_that_is_stated_is_no_doubt_about_the_lens(several: bool, tmp_path: Path, metrocli: Metrocli) -> None:
    """Noise that follows the residuals, of one camera and of several: no image stands out, and no lens is wrong."""
    if several:
        for name, text in two_cameras().items():
            (tmp_path / name).write_text(text)
    job = tmp_path / "job.yaml" if several else small_jobs.board(tmp_path)
    noisy = ("left3.png", "left5.png", "right7.png") if several else ("view02.png", "view04.png")
    with_noise(tmp_path / "observations.csv", noisy, 1.4)
    job.write_text(job.read_text().replace("noise: 0.05 px", "noise: estimated"))
    ran = metrocli("calibrate-camera", job, "--force")
    assert ran.code == 6 and "times the median of the images" in ran.err
    entries = ", ".join(f"{{by: image, only: {name}, ratio: 28}}" for name in noisy)
    job.write_text(f"{job.read_text()}variance_groups: [{entries}]\n")
    ran = metrocli("calibrate-camera", job, "--force")
    assert ran.code == 0 and "times the median of the images" not in ran.err


def test_a_place_whose_readings_are_all_left_out_is_no_fault(tmp_path: Path, metrocli: Metrocli) -> None:
    """The one reading of a bar is wrong: the network is adjusted without it, and without its variance group."""
    metrocli("init", tmp_path / "p", "--sample", "hall-trackers")
    bars, path = tmp_path / "p" / "data" / "bars.csv", tmp_path / "p" / "jobs" / "hall.yaml"
    bars.write_text(bars.read_text().replace("2527.5667", "2532.5667"))
    entries = "[{by: bar, only: B1, ratio: 2}, {by: station, only: S3, ratio: 3}]"
    path.write_text(f"{path.read_text()}outliers: remove\nvariance_groups: {entries}\n")
    ran = metrocli("adjust-network", path, "--accept-doubtful")
    assert ran.code == 0 and "left out as wrong: B1" in ran.err


def test_a_plan_that_leaves_them_out_warns(tmp_path: Path, metrocli: Metrocli) -> None:
    for sample, job, by in (("ball-cube", "views", "view"), ("machine-lengths", "lengths", "tracer")):
        metrocli("init", tmp_path / sample, "--sample", sample)
        path = tmp_path / sample / "jobs" / f"{job}.yaml"
        path.write_text(f"{path.read_text()}variance_groups: [{{by: {by}, only: '1', ratio: 3}}]\n")
        assert "the plan leaves out `variance_groups` of the job" in metrocli("plan", path).err


def test_a_wrong_file_is_mended_before_its_noise_is_stated(tmp_path: Path) -> None:
    """Readings of one kind are as noisy as a mistake makes them: no extended job states that."""
    job = load(noisy_heights(tmp_path), JobOptions())
    diagnosis = carry_out(job)
    assert proposed_variances(diagnosis)
    mistaken = Mistaken((Mistake("nominal", "z is of another part", "another list"),), diagnosis.job, 6.0, 6.0)
    assert write_extended(job, replace(diagnosis, mistaken=mistaken)) is None
    assert write_extended(job, diagnosis) is not None


def test_a_noisier_line_is_no_cause(tmp_path: Path, metrocli: Metrocli) -> None:
    """A six-dof line with five times the noise had been named as the pitch error of a screw."""
    metrocli("init", tmp_path / "p", "--sample", "machine-methods")
    job, file = tmp_path / "p" / "jobs" / "six-dof.yaml", tmp_path / "p" / "data" / "lines.csv"
    rows, rng = list(csv.DictReader(file.read_text().splitlines())), np.random.default_rng(11)
    for row in (row for row in rows if row["line"] == "y"):
        for column in ("ex_mm", "ey_mm", "ez_mm", "ea_rad", "eb_rad", "ec_rad"):
            noise = 1e-6 if column.endswith("rad") else 0.5e-3 if column == "ey_mm" else 1e-3
            row[column] = str(float(row[column]) + noise * np.sqrt(24) * float(rng.normal()))
    with file.open("w", newline="") as target:
        writer = csv.DictWriter(target, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert found["verdict"] == "clean" and not found["effects"]
    (apart,) = found["noise"]["apart"]
    assert apart["line"] == "y" and apart["ratio"] == pytest.approx(5.0, rel=0.25)


def test_a_noisier_camera_is_named_and_not_each_of_its_images(tmp_path: Path, metrocli: Metrocli) -> None:
    rng, images = np.random.default_rng(12), rig.seen()
    job = rig.job(
        tmp_path,
        {
            name: uv + (rng.normal(0, 0.1 * np.sqrt(8), uv.shape) if name.startswith("right") else 0.0)
            for name, uv in images.items()
        },
    )
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert found["verdict"] == "clean"
    (apart,) = found["noise"]["apart"]
    assert apart["camera"] == "right" and apart["ratio"] == pytest.approx(3.0, rel=0.15)
    again = json.loads(metrocli("diagnose", tmp_path / "rig.extended.yaml", "--json").out)
    assert again["verdict"] == "clean" and not again["noise"]["apart"]


def test_a_noisier_instrument_is_named_and_not_each_of_its_stations(tmp_path: Path, metrocli: Metrocli) -> None:
    """Three times the noise of the tracker at the first three stations of the sample, beside its two effects."""
    metrocli("init", tmp_path / "p", "--sample", "hall-trackers")
    job, file = tmp_path / "p" / "jobs" / "hall.yaml", tmp_path / "p" / "data" / "readings.csv"
    rows, rng = list(csv.DictReader(file.read_text().splitlines())), np.random.default_rng(13)
    for row in (row for row in rows if row["station"] in ("S1", "S2", "S3")):
        distance = float(row["d_mm"])
        angle = float(np.hypot(0.4 / 3600, np.degrees(4e-3 / distance)))
        for column, noise in (("az_deg", angle), ("el_deg", angle), ("d_mm", np.hypot(2e-3, 3e-7 * distance))):
            row[column] = str(float(row[column]) + float(noise * np.sqrt(8) * rng.normal()))
    with file.open("w", newline="") as target:
        writer = csv.DictWriter(target, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert {effect["name"] for effect in found["effects"]} == {"tracker-beam-offset", "point-moved"}
    (apart,) = found["noise"]["apart"]
    assert apart["instrument"] == "LT1" and apart["ratio"] == pytest.approx(3.0, rel=0.15)
