"""metrocli diagnose: the verdict as JSON, the report, the extended job that runs and is clean."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.hidden import launch, lengths
from benchmarks.hidden.lengths import Measurement
from metrocli.cli.console import Console
from metrocli.cli.diagnosis_report import findings as diagnosis_report
from metrocli.diagnosis.detectability import Detectability
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.noise import NoiseRatio
from metrocli.diagnosis.power.collinear import Pair
from metrocli.project import diagnosed
from metrocli.project.diagnosed import carry_out
from metrocli.project.job import JobFile, load

JOB = """metrocli: 1
job: multilaterate
title: Hall 3     # a comment
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
output: results/points.h5
"""
Metrocli = Callable[..., object]


def write(folder: Path, m: Measurement, times: bool = True) -> Path:
    """Write a measurement as the files of a job."""
    more = ",t_s,temp_degC" if times else ""
    rows = [f"point,tracer,length_mm{more}"]
    for p, j, length, t, temp in zip(
        *(part.tolist() for part in (m.point, m.tracer, m.length, m.t, m.temp)), strict=True
    ):
        rows.append(f"P{p},T{j},{length!r}" + (f",{t!r},{temp!r}" if times else ""))
    (folder / "lengths.csv").write_text("\n".join(rows) + "\n")
    for name, letter, places in (("points", "P", m.nominal), ("tracers", "T", m.said)):
        lines = [
            f"{name[:-1]},x_mm,y_mm,z_mm",
            *(f"{letter}{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(places.tolist())),
        ]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


def measured(name: str = "", times: float = 3.0, seed: int = 1) -> Measurement:
    rng = np.random.default_rng([8, seed])
    m = lengths.measurement(rng, 28)
    return lengths.planted(m, rng, name, times)[0] if name else m


_CARRIED_OUT: dict[object, Diagnosis] = {}


def _once(job: JobFile, *more: Any) -> Diagnosis:
    """Carry out a diagnosis, unless that of the same job, files and limit is known; one with a first answer always."""
    _, limit, _, _, quick, first = more
    key = job.text, *(path.read_bytes() for item in job.inputs for path in item.paths), limit, quick
    if first is not None or key not in _CARRIED_OUT:
        _CARRIED_OUT[key] = carry_out(job, *more)
    return _CARRIED_OUT[key]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, and each diagnosis once: most tests here are of what becomes of one."""
    monkeypatch.setattr(diagnosed, "carry_out", _once)
    monkeypatch.chdir(tmp_path)
    return Path()


def test_json_has_the_keys_of_the_contract(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-drift"))
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err
    data = json.loads(ran.out)
    assert data["verdict"] == "indistinct"
    assert any("all around the tracers" in words for words in data["separate_by"])
    assert data["noise"]["declared"] == "0.1 um, 0.1 um/m"
    assert data["noise"]["interval"][0] < data["noise"]["ratio"] < data["noise"]["interval"][1]
    assert data["noise"]["as_declared"] is True and data["limited"] is None
    (effect,) = data["effects"]
    assert effect["name"] == "dead-path-drift"
    assert set(effect["where"]) == {"tracer"}
    assert set(effect["parameters"]["rate"]) == {"value", "std", "unit"}
    assert effect["parameters"]["rate"]["unit"] == "mm/s"
    assert effect["p_value"] < 0.01
    assert all({"name", "where", "correlation", "odds"} <= set(other) for other in effect["alternatives"])
    assert "tracer-drift" in {other["name"] for other in effect["alternatives"]}
    gain = effect["gain"]
    assert gain["shown"] and gain["unit"] == "um" and gain["holdout_after"] < gain["holdout_before"]
    assert np.isclose(gain["reduction_percent"], 100 * (1 - gain["holdout_after"] / gain["holdout_before"]))
    assert gain["result_shift"]["what"] == "point coordinates" and gain["result_shift"]["value"] > 0
    assert data["unexplained"] is None
    assert data["extended_job"] == "job.extended.yaml"
    states = {(one["name"], *one["where"].values()): one for one in data["candidates"]}
    assert states["dead-path-drift", effect["where"]["tracer"]]["status"] == "named"
    assert states["length-scale",]["status"] == "not-testable"
    assert "absorb" in states["length-scale",]["reason"]
    assert states["tracer-scale", "T0"]["status"] == "excluded"
    assert states["tracer-scale", "T0"]["minimal_detectable"]["unit"] == "1"
    assert states["tracer-scale", "T0"]["hides"]["unit"] == "um"


def test_the_extended_job_runs_unmodified_and_is_clean(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("tracer-scale"))
    before = job.read_text()
    assert metrocli("diagnose", job).code == 0
    assert job.read_text() == before
    extended = folder / "job.extended.yaml"
    ran = metrocli("multilaterate", extended)
    assert ran.code == 0, ran.err
    assert (folder / "results" / "points.extended.h5").exists()
    assert not (folder / "results" / "points.h5").exists()
    again = json.loads(metrocli("diagnose", extended, "--json").out)
    assert (again["verdict"], again["extended_job"]) == ("clean", None)
    assert not (folder / "job.extended.extended.yaml").exists()


def test_the_extended_job_can_stand_elsewhere(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("tracer-scale"))
    (folder / "elsewhere").mkdir()
    data = json.loads(metrocli("diagnose", job, "--json", "--out", "elsewhere/new.yaml").out)
    assert data["extended_job"] == "elsewhere/new.yaml"
    assert not (folder / "job.extended.yaml").exists()
    assert metrocli("multilaterate", "elsewhere/new.yaml").code == 0
    assert (folder / "results" / "points.extended.h5").exists()


def test_output_is_the_result_as_in_every_command(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("tracer-scale"))
    assert metrocli("diagnose", job, "--quick", "--output", "elsewhere.h5").code == 0
    assert (folder / "elsewhere.diagnosis.json").is_file()
    assert "output: elsewhere.extended.h5" in (folder / "job.extended.yaml").read_text()
    for name, words in (("new.yaml", "--out names the extended job"), ("new.csv", "ends in .h5")):
        ran = metrocli("diagnose", job, "--output", name)
        assert (ran.code, words in ran.err) == (2, True)


def test_a_folder_that_cannot_be_written_to_costs_the_job_only(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("tracer-scale"))
    (folder / "job.extended.yaml").mkdir()
    ran = metrocli("diagnose", job, "--json")
    assert (ran.code, json.loads(ran.out)["extended_job"]) == (0, None)
    assert "no extended job" in ran.err
    assert metrocli("diagnose", job, "--out", "job.extended.yaml").code == 3


def test_an_extended_job_that_was_edited_is_kept_unless_forced(folder: Path, metrocli: Metrocli) -> None:
    job, extended = write(folder, measured("tracer-scale")), folder / "job.extended.yaml"
    assert metrocli("diagnose", job, "--quiet").code == 0
    written = extended.read_text()
    edited = written.replace("metrocli: 1", "metrocli: 1\ntitle: with my own changes")
    extended.write_text(edited)
    ran = metrocli("diagnose", job, "--json")
    assert (ran.code, json.loads(ran.out)["extended_job"], extended.read_text()) == (0, None, edited)
    assert "job.extended.yaml: error: the extended job is not as diagnose wrote it" in ran.err
    assert "give another --out, or replace it with --force" in ran.err
    assert json.loads(metrocli("diagnose", job, "--json", "--force").out)["extended_job"] == "job.extended.yaml"
    assert extended.read_text() == written


@pytest.mark.slow
def test_a_jump_keeps_its_time_in_the_extended_job(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-jump", 4.0))
    metrocli("diagnose", job)
    text = (folder / "job.extended.yaml").read_text()
    assert "name: dead-path-jump" in text
    assert " s\n" in text.partition("at: ")[2]
    assert json.loads(metrocli("diagnose", folder / "job.extended.yaml", "--json").out)["verdict"] == "clean"


def test_the_report_says_what_to_do(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("diagnose", write(folder, measured("tracer-scale")))
    first, second, _, head, row, *_ = ran.out.split("\n")
    text = " ".join(ran.out.split())
    assert first == "verdict: explained"
    assert re.fullmatch(r"  tracer-scale T\d explains \d\d % of the misfit \(squares of held-out errors\)", second)
    assert head.startswith("effect") and row.startswith("tracer-scale T")
    for words in (
        "the wavelength or the air correction of one tracer is wrong",
        "held-out error",
        "changes result by",
        "structure left: none beyond noise",
        "noise: as declared",
        "job.extended.yaml",
    ):
        assert words in text, words


def test_where_nothing_is_hidden_it_says_so(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("diagnose", write(folder, measured()))
    assert ran.out.startswith("verdict: clean")
    assert "structure left: none beyond noise (p = " in ran.out
    assert not (folder / "job.extended.yaml").exists()


def test_without_times_their_effects_are_not_tested(folder: Path, metrocli: Metrocli) -> None:
    data = json.loads(metrocli("diagnose", write(folder, measured(), times=False), "--design", "--json").out)
    missing = {one["name"]: one["reason"] for one in data["candidates"] if one["status"] == "not-tested"}
    assert set(missing) == {
        "refraction-drift",
        "dead-path-drift",
        "dead-path-jump",
        "tracer-drift",
        "reseated-reflector",
    }
    assert "t_s" in missing["dead-path-drift"]


def test_the_design_does_not_look_at_residuals(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured())
    plain = json.loads(metrocli("diagnose", job, "--design", "--json").out)
    write(folder, measured("dead-path-drift"))
    planted = json.loads(metrocli("diagnose", job, "--design", "--json").out)
    assert set(plain) == {"part", "candidates", "alike"}
    assert plain["part"] is None
    assert not any(one["status"] == "named" for one in planted["candidates"])
    for one, other in zip(plain["candidates"], planted["candidates"], strict=True):
        if one["minimal_detectable"] is not None:
            assert np.isclose(one["minimal_detectable"]["value"], other["minimal_detectable"]["value"], rtol=0.01)
    assert any({"dead-path-drift T1", "tracer-drift T1"} == set(pair["names"]) for pair in plain["alike"])
    assert "hard to distinguish" in metrocli("diagnose", job, "--design").out


def test_the_design_is_told_before_there_are_readings(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured())
    (folder / "lengths.csv").unlink()
    job.write_text(JOB + "simulation: {mover_error: 5 um, interval: 20 s}\n")
    ran = metrocli("diagnose", job, "--design", "--json")
    assert ran.code == 0, ran.err
    states = {(one["name"], *one["where"].values()): one["status"] for one in json.loads(ran.out)["candidates"]}
    assert states["dead-path-drift", "T3"] == "excluded"
    assert states["length-scale",] == "not-testable"
    assert not (folder / "lengths.csv").exists()
    assert metrocli("diagnose", job).code == 3


@pytest.mark.parametrize(
    ("text", "code", "words"), [("straight-line", 2, "cannot be diagnosed"), ("nothing", 3, "job")]
)
def test_what_cannot_be_diagnosed_is_refused(text: str, code: int, words: str, job: Path, metrocli: Metrocli) -> None:
    if text == "nothing":
        job.write_text("metrocli: 1\n")
    ran = metrocli("diagnose", job)
    assert (ran.code, words in ran.err) == (code, True)


@pytest.mark.slow
def test_beside_a_very_large_effect_the_next_is_named_too_and_the_extended_job_is_clean(
    folder: Path, metrocli: Metrocli
) -> None:
    rng = np.random.default_rng(5)
    m, form = lengths.planted(lengths.measurement(rng, 60), rng, "sphere-form", 8.0)
    m, drift = lengths.planted(m, rng, "refraction-drift", 60.0)
    data = json.loads(metrocli("diagnose", write(folder, m), "--json").out)
    assert (data["verdict"], data["noise"]["apart"]) == ("explained", [])
    assert [(one["name"], one["where"]) for one in data["effects"]] == [
        (drift.name, dict(drift.where)),
        (form.name, dict(form.where)),
    ]
    for one, truth in zip(data["effects"], (drift, form), strict=True):
        for key, size in one["parameters"].items():
            assert abs(size["value"] - truth.values[key]) < 4 * size["std"]
            assert size["std"] < 0.2 * abs(truth.values[key])
    assert {one["name"] for one in data["candidates"] if one["status"] == "named"} == {drift.name, form.name}
    again = json.loads(metrocli("diagnose", data["extended_job"], "--json").out)
    assert (again["verdict"], again["effects"]) == ("clean", [])


@pytest.mark.slow
def test_of_two_large_effects_that_are_alike_neither_takes_the_place_of_the_other(
    folder: Path, metrocli: Metrocli
) -> None:
    """What wins first, alone, would be an effect between them: it gives way when the race is held again."""
    rng = np.random.default_rng(12)
    m = lengths.measurement(rng, 60)
    one, other = (lengths.signature("dead-path-drift", at, {"rate": rate})(m) for at, rate in ((1, 1e-5), (4, -1e-5)))
    data = json.loads(metrocli("diagnose", write(folder, replace(m, length=m.length + one + other)), "--json").out)
    assert {(one["name"], one["where"]["tracer"]) for one in data["effects"]} == {
        ("dead-path-drift", "T1"),
        ("dead-path-drift", "T4"),
    }
    for effect, truth in zip(sorted(data["effects"], key=lambda e: e["where"]["tracer"]), (1e-5, -1e-5), strict=True):
        rate = effect["parameters"]["rate"]
        assert abs(rate["value"] - truth) < 4 * rate["std"]


def test_a_report_says_how_far_the_shape_of_an_effect_was_checked() -> None:
    rng = np.random.default_rng(8)
    found = diagnose(lengths.planted(lengths.measurement(rng, 40), rng, "sphere-form", 30.0)[0].adjusted())
    # a smooth function has more terms than the effect, so that it must be somewhat larger to be seen
    assert 0.8 / 30 < found.findings[0].other_shape_from < 2.5 / 30
    for share, words in (
        (0.034, "an unlisted cause whose signature differs from this one by less than 3.4 % (80 % power)"),
        (1.2, "the effect is too small for its shape"),
    ):
        told = replace(found, findings=(replace(found.findings[0], other_shape_from=share),))
        assert words in " ".join(diagnosis_report.of_diagnosis(told, None).split())


def test_a_size_far_beyond_usual_ones_is_called_a_mistake_perhaps() -> None:
    """Half of the rows counted the other way fit an eccentricity of an encoder, which nobody has of such a size."""
    rng = np.random.default_rng(5)
    m = launch.measurement(rng, distances=True)
    read = m.read.copy()
    read[1, len(m.psi) // 2 :] *= -1
    found = diagnose(replace(m, read=read).adjusted())
    assert max(finding.times_usual or 0.0 for finding in found.findings) > 100
    assert "look for a mistake in the files and settings first" in diagnosis_report.of_diagnosis(found, None)
    noisy = replace(m, read=m.read + rng.normal(0, 100, m.read.shape) * m.sigma)
    assert "An instrument seldom has so much" in diagnosis_report.of_diagnosis(diagnose(noisy.adjusted()), None)
    usual = diagnose(lengths.planted(lengths.measurement(rng, 40), rng, "tracer-scale", 3.0)[0].adjusted())
    assert usual.findings[0].times_usual is not None
    assert "look for a mistake" not in diagnosis_report.of_diagnosis(usual, None)


def test_an_extended_job_takes_the_place_of_no_other_file(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-drift"))
    before = (folder / "lengths.csv").read_bytes()
    (folder / "notes.txt").write_bytes(before)
    ran = metrocli("diagnose", job, "--out", "notes.txt")
    assert (ran.code, "is not an extended job" in ran.err) == (3, True)
    ran = metrocli("diagnose", job, "--out", "lengths.csv", "--force")
    assert (ran.code, "which the job reads" in ran.err) == (3, True)
    assert (folder / "lengths.csv").read_bytes() == (folder / "notes.txt").read_bytes() == before


def test_a_noise_that_the_job_estimates_is_not_called_declared() -> None:
    found = diagnose(
        replace(
            lengths.measurement(np.random.default_rng(4), 20).adjusted(), declared="estimated", noise_model="estimated"
        )
    )
    text = " ".join(diagnosis_report.of_diagnosis(found, None).split())
    assert ("times the noise that the job estimates" in text, "declared" in text) == (True, False)


@pytest.mark.slow
def test_a_repeatability_that_the_job_estimates_is_not_called_declared(metrocli: Metrocli, tmp_path: Path) -> None:
    assert metrocli("init", tmp_path / "m", "--sample", "machine-lengths").code == 0
    job, lengths_file = tmp_path / "m/jobs/lengths.yaml", tmp_path / "m/data/lengths.csv"
    ran = metrocli("diagnose", job)
    assert "as declared" not in ran.out
    (line,) = [line for line in ran.out.splitlines() if line.startswith("noise: ")]
    assert line.endswith(
        "times that of the job (0.3 um, 0.2 um/m, repeatability estimated); the estimated part follows the residuals"
    )
    # a wrong reading raises the estimated part, and what is left is less than that
    rows = [line.split(",") for line in lengths_file.read_text().splitlines()]
    rows[101][5] = str(float(rows[101][5]) + 0.02)
    lengths_file.write_text("\n".join(map(",".join, rows)) + "\n")
    ran = metrocli("diagnose", job)
    assert "with 1 wrong reading" in ran.out
    assert "declared" not in ran.out


@pytest.mark.parametrize(("dof", "told"), [(9.0, True), (200.0, False)])
def test_noise_far_beyond_the_declared_is_doubted_where_few_readings_say_so(dof: float, told: bool) -> None:
    found = diagnose(lengths.measurement(np.random.default_rng(4), 20).adjusted())
    text = diagnosis_report.of_diagnosis(replace(found, noise=NoiseRatio(9.6, 6.6, 17.5, dof)), None)
    assert ("several wrong readings may pass as noise" in " ".join(text.split())) is told


def test_where_no_reading_is_to_spare_nothing_is_called_clean(folder: Path, metrocli: Metrocli) -> None:
    """Six points and six tracers: as many readings as unknowns."""
    job = write(folder, lengths.measurement(np.random.default_rng(3), 6))
    ran = metrocli("diagnose", job)
    assert (ran.code, "the job has no redundant reading" in ran.err) == (4, True)
    ran = metrocli("diagnose", job, "--design")
    assert (ran.code, "no reading is checked" in ran.out, "nan" in ran.out) == (0, True, False)
    candidates = json.loads(metrocli("diagnose", job, "--design", "--json").out)["candidates"]
    assert all(one["status"] in ("not-testable", "not-tested") for one in candidates)


def test_the_size_from_which_scales_are_told_apart_has_a_unit() -> None:
    pair = Pair("machine-scale x", "distance-scale", 0.95, 4.1e-6, "1", "ratio")
    told = diagnosis_report.of_design(
        lengths.measurement(np.random.default_rng(1), 20).adjusted(), Detectability((), (), (pair,))
    )
    assert "machine-scale x and distance-scale: distinguished from 4.1 um/m on" in told


def known(folder: Path, true: float, stated: float, seed: int = 4, name: str = "") -> Path:
    """Write a measurement whose points are known, with an error that may not be the stated one, and an effect."""
    rng = np.random.default_rng([9, seed])
    m = lengths.measurement(rng, 32)
    m = lengths.planted(m, rng, name, 5.0)[0] if name else m
    off = np.random.default_rng([10, seed]).normal(0, true, m.points.shape)
    job = write(folder, replace(m, nominal=m.points + off))
    rows = (folder / "points.csv").read_text().splitlines()
    (folder / "points.csv").write_text("\n".join([f"{rows[0]},sigma_mm", *(f"{row},{stated}" for row in rows[1:])]))
    return job


@pytest.mark.alike
@pytest.mark.parametrize(("true", "stated"), [(1e-3, 4e-3), (1e-3, 1e-3), (0.1, 1e-3)])
def test_a_wrong_sigma_of_known_points_is_told_as_that(
    folder: Path, metrocli: Metrocli, true: float, stated: float
) -> None:
    data = json.loads(metrocli("diagnose", known(folder, true, stated), "--json").out)
    assert data["verdict"] == "clean" and not data["outliers"]
    assert 0.9 < data["noise"]["ratio"] < 1.1
    if true == stated:
        assert data["noise"]["apart"] == []
    else:
        (apart,) = data["noise"]["apart"]
        assert apart["given"] == "prior of point"
        assert abs(np.log(apart["ratio"] * stated / true)) < np.log(1.3)


@pytest.mark.slow
def test_a_gain_that_is_small_beside_other_errors_is_told_as_that(folder: Path, metrocli: Metrocli) -> None:
    """Points known to 20 um are predicted to that, with the effect and without; the score has all their readings."""
    told = metrocli("diagnose", known(folder, 0.02, 0.02, name="dead-path-drift")).out
    assert "dead-path-drift T3 explains little of the misfit" in told.splitlines()[1]
    row = next(line for line in told.splitlines() if line.startswith("dead-path-drift"))
    assert " unchanged " in row and " +" in row and "not shown" not in row and "0 %" not in row


@pytest.mark.slow
def test_known_points_are_no_hindrance_to_what_tells_two_names_apart(folder: Path, metrocli: Metrocli) -> None:
    m = measured("dead-path-drift", 2.0)
    job = write(folder, replace(m, nominal=m.points))
    rows = (folder / "points.csv").read_text().splitlines()
    (folder / "points.csv").write_text("\n".join([f"{rows[0]},sigma_mm", *(f"{row},0.0001" for row in rows[1:])]))
    ran = metrocli("diagnose", job, "--json")
    data = json.loads(ran.out)
    assert data["verdict"] == "indistinct" and data["separate_by"]


@pytest.mark.slow
def test_a_wrong_known_value_is_found_as_a_change_of_it(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured())
    job.write_text(job.read_text() + "effects: [{name: tracer-scale, tracer: T1, scale: 5 ppm}]\n")
    data = json.loads(metrocli("diagnose", job, "--json").out)
    (effect,) = data["effects"]
    assert (effect["name"], effect["where"]) == ("tracer-scale", {"tracer": "T1"})
    scale = effect["parameters"]["scale"]
    assert abs(scale["value"] + 5e-6) < 4 * scale["std"]
    assert metrocli("multilaterate", data["extended_job"]).code == 0
    assert json.loads(metrocli("diagnose", data["extended_job"], "--json").out)["verdict"] == "clean"


def test_an_effect_listed_twice_is_a_fault_of_the_job(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured())
    one = "{name: dead-path-drift, tracer: T1}"
    job.write_text(job.read_text() + f"effects: [{one}, {one}]\n")
    ran = metrocli("diagnose", job)
    assert ran.code == 3 and "dead-path-drift is listed twice" in ran.err


def one_target_an_image(folder: Path, off: tuple[float, float]) -> Path:
    """Write an alignment by eight images of one target each; the machine stood elsewhere for one of them."""
    rng = np.random.default_rng(5)
    targets = np.array([[0.0, 0, 0], [1500, 0, 10], [1480, 1000, 60], [20, 980, 30]])
    part = targets @ np.array([[1.0, -0.01, 0], [0.01, 1, 0], [0, 0, 1]]).T / np.hypot(1, 0.01) + [40.0, -30, 600]
    poses, seen = ["image,x_mm,y_mm,z_mm"], ["image,target,u_px,v_px"]
    for i in range(8):
        at = part[i % 4] - [0.0, 0.0, 700.0] + rng.uniform(-90, 90, 3)
        x, y, z = part[i % 4] - at
        u, v = np.array([1200 + 2800 * x / z, 900 + 2800 * y / z]) + rng.normal(0, 0.05, 2)
        said = at + np.array([*off, 0.0]) * (i == 4)
        poses.append(f"I{i}," + ",".join(map(repr, said.tolist())))
        seen.append(f"I{i},C{i % 4},{float(u)!r},{float(v)!r}")
    (folder / "poses.csv").write_text("\n".join(poses))
    (folder / "observations.csv").write_text("\n".join(seen))
    rows = [f"C{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(targets.tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *rows]))
    place = "x: 0 mm, y: 0 mm, z: 0 mm, alpha: 0 rad, beta: 0 rad, gamma: 0 rad"
    camera = f"{{image_size: [2400, 1800], f: 2800 px, cx: 1200 px, cy: 900 px, extrinsics: {{{place}}}}}\n"
    (folder / "camera.yaml").write_text(camera)
    inputs = "{camera: camera.yaml, targets: targets.csv, poses: poses.csv, observations: observations.csv}"
    job = f"metrocli: 1\njob: align-part\ninputs: {inputs}\nestimate: [part-pose]\nnoise: 0.05 px\noutput: out.h5\n"
    (folder / "job.yaml").write_text(job)
    return folder / "job.yaml"


def test_a_direction_of_an_effect_that_nothing_shows_is_held_and_told(folder: Path, metrocli: Metrocli) -> None:
    data = json.loads(metrocli("diagnose", one_target_an_image(folder, (0.5, -0.4)), "--json").out)
    (effect,) = data["effects"]
    assert (effect["name"], effect["where"]) == ("bad-pose", {"image": "I4"})
    dx, dy, dz = (effect["parameters"][key] for key in ("dx", "dy", "dz"))
    # the beam through the target is oblique: none of the three is known by itself, and dz is taken as 0
    assert dz["value"] == 0 and all(part["std"] is None and part["unseen"] for part in (dx, dy, dz))
    assert abs(dx["value"] + 0.5) < 0.1 and abs(dy["value"] - 0.4) < 0.1
    assert data["noise"]["apart"] == []
    assert " ".join(metrocli("diagnose", "job.yaml").out.split()).count("mm (not seen)") >= 3
    assert metrocli("align-part", data["extended_job"]).code == 0
    assert json.loads(metrocli("diagnose", data["extended_job"], "--json").out)["verdict"] == "clean"


def test_noise_that_is_not_as_declared_stands_in_the_first_line(folder: Path, metrocli: Metrocli) -> None:
    """The noise is declared as a fifth of what it is; the test of the keys has the noise as it is."""
    job = write(folder, measured())
    fifth = ("--set", "noise.constant=0.02 um", "--set", "noise.proportional=0.02 um/m")
    data = json.loads(metrocli("diagnose", job, "--json", *fifth).out)
    assert (data["verdict"], data["noise"]["as_declared"]) == ("clean", False)
    assert 4 < data["noise"]["ratio"] < 6.5
    first, *rest = metrocli("diagnose", job, *fifth).out.splitlines()
    assert first == f"verdict: clean, but the noise is {data['noise']['ratio']:.2g} times what was declared"
    assert "for the declared noise" in " ".join(" ".join(rest).split())


@pytest.mark.parametrize("command", ["multilaterate", "diagnose", "check", "plan", "run"])
def test_an_input_that_cannot_be_read_is_named(
    command: str, folder: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The right to read is withdrawn: from a user who may do everything only by refusing the call itself."""
    job = write(folder, measured())
    (folder / "metrocli.yaml").write_text("project: hall\njobs: [job.yaml]\n")
    plain = os.open

    def refused(path: Any, *more: Any, **named: Any) -> int:
        if Path(path).name == "lengths.csv":
            raise PermissionError(13, "Permission denied", str(path))
        return plain(path, *more, **named)

    monkeypatch.setattr(os, "open", refused)
    ran = metrocli(command, *(() if command == "run" else (job,)))
    assert ran.code == 3, ran.err
    assert "lengths.csv: error: cannot be read: Permission denied" in ran.err
    assert "Traceback" not in ran.err
    assert not list(folder.rglob("*.h5"))


def with_wrong_length(folder: Path, count: int, point: str, at: str) -> Path:
    """Write a measurement with the first tracers, in which one length is 20 um too long."""
    m = measured()
    kept = m.tracer < count
    m = replace(m, tracers=m.tracers[:count], said=m.said[:count], point=m.point[kept], tracer=m.tracer[kept])
    m = replace(m, t=m.t[kept], temp=m.temp[kept], length=m.length[kept])
    wrong = (m.point == int(point[1:])) & (m.tracer == int(at[1:]))
    return write(folder, replace(m, length=m.length + 2e-2 * wrong))


def test_with_four_tracers_a_wrong_length_cannot_be_identified(folder: Path, metrocli: Metrocli) -> None:
    """One degree of freedom at each point: the tests of its four lengths are the same."""
    ran = metrocli("diagnose", with_wrong_length(folder, 4, "P7", "T1"), "--json")
    (wrong,) = json.loads(ran.out)["outliers"]
    assert wrong["w"] > 4
    named = [wrong["observation"], *wrong["or"]]
    assert sorted((one["point"], one["tracer"]) for one in named) == [("P7", f"T{i}") for i in range(4)]
    text = metrocli("diagnose", folder / "job.yaml").out
    assert text.startswith("verdict: clean, with 1 wrong reading\n")
    assert "These readings do not show which one is wrong" in text


def test_with_six_tracers_a_wrong_length_is_identified(folder: Path, metrocli: Metrocli) -> None:
    (wrong,) = json.loads(metrocli("diagnose", with_wrong_length(folder, 6, "P7", "T2"), "--quick", "--json").out)[
        "outliers"
    ]
    assert (wrong["observation"]["point"], wrong["observation"]["tracer"], wrong["or"]) == ("P7", "T2", [])


def test_a_status_has_a_size_and_compares_it_with_the_usual_sizes(folder: Path, metrocli: Metrocli) -> None:
    """Lengths of 0.1 um noise show a scale of 1 ppm and no roundness of 0.02 to 0.3 um."""
    data = json.loads(metrocli("diagnose", write(folder, measured()), "--json").out)
    states = {(one["name"], *one["where"].values()): one for one in data["candidates"]}
    scale = states["tracer-scale", "T0"]
    assert scale["status"] == "excluded"
    assert (scale["usual"]["from"], scale["usual"]["to"]) == (pytest.approx(1e-7), pytest.approx(5e-6))
    assert 1e-7 < scale["above"]["value"] < 5e-6 and scale["usual_seen"] == "part"
    assert scale["above"] == scale["minimal_detectable"]
    for one in data["candidates"]:
        if one.get("usual") is None or one["above"] is None:
            continue
        above = one["above"]["value"]
        assert one["usual_seen"] == (True if above <= one["usual"]["from"] else above <= one["usual"]["to"] and "part")
        assert one["status"] == ("excluded" if one["usual_seen"] else "cannot-see")
        assert one["hides"]["power"] == 0.95


@pytest.mark.slow
def test_the_exit_code_is_0_whatever_the_verdict_unless_clean_is_required(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-drift", 30.0))
    assert metrocli("multilaterate", job).code == 6  # doubtful
    required = metrocli("diagnose", job, "--require", "clean", "--json")
    assert (required.code, json.loads(required.out)["verdict"]) == (6, "explained")
    assert metrocli("diagnose", write(folder, measured()), "--require", "clean").code == 0


def test_a_search_ends_at_its_limit_with_what_it_has_found(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-drift"))
    ran = metrocli("diagnose", job, "--json", "--limit", "1 ms")
    data = json.loads(ran.out)
    assert (ran.code, data["limited"], data["effects"]) == (0, pytest.approx(1e-3), [])
    assert data["verdict"] == "unexplained" and data["candidates"]
    ended = metrocli("diagnose", job, "--limit", "1 ms", "--require", "clean")
    assert "The search ended at the limit of 0.001 s" in ended.out
    # a verdict that counts would need all that was to be tried
    assert ended.code == 6 and "so far (limit of 0.001 s)" in ended.out.splitlines()[0]


@pytest.mark.parametrize("limit", ["60", "0 s", "soon"])
def test_a_limit_is_a_time(folder: Path, metrocli: Metrocli, limit: str) -> None:
    ran = metrocli("diagnose", write(folder, measured()), "--limit", limit)
    assert (ran.code, "--limit" in ran.err) == (2, True)


@pytest.mark.slow
def test_the_diagnosis_is_kept_beside_the_result(folder: Path, metrocli: Metrocli) -> None:
    job, kept = write(folder, measured()), Path("results/points.diagnosis.json")
    assert metrocli("multilaterate", job, "--quiet").code == 0
    assert f"diagnosis: {kept}, shown by metrocli report results/points.h5" in metrocli("diagnose", job).out
    assert json.loads(kept.read_text())["verdict"] == "clean"
    metrocli("report", "results/points.h5")
    assert "Verdict: clean: the residuals are what noise produces." in Path("results/points.html").read_text(
        encoding="utf-8"
    )
    kept.write_text("{}")  # a file of one's own stays
    ran = metrocli("diagnose", job)
    assert ran.code == 0 and "the diagnosis was not saved" in ran.err and kept.read_text() == "{}"


def test_the_first_answer_names_what_explains_most(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-drift"))
    quick = json.loads(metrocli("diagnose", job, "--quick", "--json").out)
    whole = json.loads(metrocli("diagnose", job, "--json").out)
    (first,), (last,) = quick["effects"], whole["effects"]
    assert (first["name"], first["where"]) == (last["name"], last["where"])
    assert quick["quick"] and not quick["candidates"] and not whole["quick"]
    assert quick["verdict"] == "not-decided"
    assert metrocli("diagnose", job, "--quick").out.startswith("verdict: not-decided\n  dead-path-drift")
    assert metrocli("diagnose", write(folder, measured()), "--quick", "--require", "clean").code == 6
    refused = metrocli("diagnose", job, "--quick", "--next", "3")
    assert refused.code == 2 and "--quick is the first answer alone" in refused.err


@pytest.mark.slow
def test_a_terminal_shows_the_first_answer_while_the_rest_is_computed(
    folder: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Console, "is_watched", True)
    shown = metrocli("diagnose", write(folder, measured("dead-path-drift")))
    assert "first answer, to be refined:\n  dead-path-drift" in shown.err
    assert "first answer" not in metrocli("diagnose", "job.yaml", "--json").err
    assert shown.out.startswith("verdict: indistinct\n")


def test_all_candidates_stand_in_the_full_report(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured())
    assert "`--full` lists them" in metrocli("diagnose", job).out
    assert re.search(r"^candidate +where +status", metrocli("diagnose", job, "--full").out, re.MULTILINE)


def test_an_interrupted_first_answer_is_the_answer(folder: Path) -> None:
    @contextmanager
    def attended(heeded: Callable[[], None]) -> Iterator[None]:
        heeded()
        yield

    told = list[Diagnosis]()
    found = carry_out(load(write(folder, measured("tracer-scale"))), attended=attended, first=told.append)
    assert [one.interrupted for one in told] == [True] and found.quick and found.verdict == "not-decided"


def test_what_was_shown_as_found_stays_where_the_time_is_spent_before_it_is_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diagnosed_in_time(job: Any, *_: Any, quick: bool = False) -> Diagnosis:
        return diagnose(job, limit=60.0 if quick else 0.0, quick=quick)

    # the whole one is called with all its options in a row
    monkeypatch.setattr(diagnosed, "diagnose", diagnosed_in_time)
    shown = list[Diagnosis]()
    told = carry_out(load(write(tmp_path, measured("tracer-drift", 5.0))), first=shown.append)
    names = [str(finding.effect.alternative) for finding in told.findings]
    assert names == [str(finding.effect.alternative) for finding in shown[0].findings]
    assert names
    assert told.ended_early
    assert not carry_out(load(tmp_path / "job.yaml")).findings


def test_a_cause_out_of_reach_of_coarse_readings_is_no_rival(tmp_path: Path, metrocli: Metrocli) -> None:
    """Ranges of a radio to a vehicle in a plane: a cube corner, of micrometres, has the signature of their zero."""
    rng = np.random.default_rng([93, 4])
    beacons = np.array([[-40e3, 9e3], [14e3, -9e3], [22e3, 24e3], [-18e3, 59e3]])
    places = rng.uniform([-45e3, -10e3], [25e3, 65e3], (240, 2))
    at = rng.integers(4, size=240)
    ranges = np.linalg.norm(places - beacons[at], axis=1) + 1400.0 + 500.0 * rng.normal(size=240)
    for name, header, rows in (
        ("points", "point,x_mm,y_mm,z_mm,sigma_mm", [f"R{i},{x},{y},0,0" for i, (x, y) in enumerate(places.tolist())]),
        (
            "tracers",
            "tracer,x_mm,y_mm,z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm",
            [f"B{i},{x},{y},0,,,0" for i, (x, y) in enumerate(beacons.tolist())],
        ),
        (
            "lengths",
            "point,tracer,length_mm",
            [f"R{i},B{b},{r}" for i, (b, r) in enumerate(zip(at, ranges, strict=True))],
        ),
    ):
        (tmp_path / f"{name}.csv").write_text("\n".join([header, *rows, ""]))
    (tmp_path / "job.yaml").write_text(
        "metrocli: 1\njob: multilaterate\nmeasures: absolute\nnoise: {constant: 500 mm}\noutput: out.h5\n"
        "inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}\n"
    )
    ran = metrocli("diagnose", tmp_path / "job.yaml", "--json")
    told = json.loads(ran.out)
    assert [(one["name"], [other["name"] for other in one["alternatives"]]) for one in told["effects"]] == [
        ("length-offset", [])
    ]
    (incidence,) = [one for one in told["candidates"] if one["name"] == "reflector-incidence"]
    assert incidence["status"] == "not-tested"
    assert incidence["reason"].endswith("beyond the plausible")
    assert metrocli("multilaterate", told["extended_job"]).code in (0, 6)
