"""metrocli diagnose: the verdict as JSON, the report, the extended job that runs and is clean."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden import lengths
from benchmarks.hidden.lengths import Measurement

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
    m = lengths.measurement(rng, 40)
    return lengths.planted(m, rng, name, times)[0] if name else m


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path()


def test_json_has_the_keys_of_the_contract(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-drift"))
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err
    data = json.loads(ran.out)
    assert data["verdict"] in ("explained", "indistinct")
    assert data["noise"]["declared"] == "0.1 um, 0.1 um/m"
    assert data["noise"]["interval"][0] < data["noise"]["ratio"] < data["noise"]["interval"][1]
    (effect,) = data["effects"]
    assert effect["name"] == "dead-path-drift"
    assert set(effect["where"]) == {"tracer"}
    assert set(effect["parameters"]["rate"]) == {"value", "std", "unit"}
    assert effect["parameters"]["rate"]["unit"] == "mm/s"
    assert effect["p_value"] < 0.01
    assert all({"name", "where", "correlation", "odds"} <= set(other) for other in effect["alternatives"])
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
    job = write(folder, measured("refraction-drift"))
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
    data = json.loads(metrocli("diagnose", job, "--json", "--output", "elsewhere/new.yaml").out)
    assert data["extended_job"] == "elsewhere/new.yaml"
    assert not (folder / "job.extended.yaml").exists()
    assert metrocli("multilaterate", "elsewhere/new.yaml").code == 0
    assert (folder / "results" / "points.extended.h5").exists()


def test_a_folder_that_cannot_be_written_to_costs_the_job_only(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("tracer-scale"))
    (folder / "job.extended.yaml").mkdir()
    ran = metrocli("diagnose", job, "--json")
    assert (ran.code, json.loads(ran.out)["extended_job"]) == (0, None)
    assert "no extended job" in ran.err
    assert metrocli("diagnose", job, "--output", "job.extended.yaml").code == 3


def test_a_jump_keeps_its_time_in_the_extended_job(folder: Path, metrocli: Metrocli) -> None:
    job = write(folder, measured("dead-path-jump", 4.0))
    metrocli("diagnose", job)
    text = (folder / "job.extended.yaml").read_text()
    assert "name: dead-path-jump" in text
    assert " s\n" in text.partition("at: ")[2]
    assert json.loads(metrocli("diagnose", folder / "job.extended.yaml", "--json").out)["verdict"] == "clean"


def test_the_report_says_what_to_do(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("diagnose", write(folder, measured("tracer-scale")))
    first, _, paragraph, *_ = ran.out.split("\n", 3)
    text = " ".join(ran.out.split())
    assert first == "verdict: explained"
    assert "tracer-scale T" in paragraph + text
    for words in (
        "the wavelength or the air correction of one tracer is wrong",
        "predicted",
        "better",
        "point coordinates by up to",
        "The noise is as declared",
        "job.extended.yaml",
    ):
        assert words in text, words


def test_where_nothing_is_hidden_it_says_so(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("diagnose", write(folder, measured()))
    assert ran.out.startswith("verdict: clean")
    assert "what noise makes of this model" in " ".join(ran.out.split())
    assert not (folder / "job.extended.yaml").exists()


def test_without_times_their_effects_are_not_tested(folder: Path, metrocli: Metrocli) -> None:
    data = json.loads(metrocli("diagnose", write(folder, measured(), times=False), "--json").out)
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
    assert set(plain) == {"candidates", "alike"}
    assert not any(one["status"] == "named" for one in planted["candidates"])
    for one, other in zip(plain["candidates"], planted["candidates"], strict=True):
        if one["minimal_detectable"] is not None:
            assert np.isclose(one["minimal_detectable"]["value"], other["minimal_detectable"]["value"], rtol=0.01)
    assert any({"dead-path-drift T1", "tracer-drift T1"} == set(pair["names"]) for pair in plain["alike"])
    assert "hard to tell apart" in metrocli("diagnose", job, "--design").out


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


def test_inseparable_names_come_with_what_tells_them_apart(folder: Path, metrocli: Metrocli) -> None:
    data = json.loads(metrocli("diagnose", write(folder, measured("dead-path-drift")), "--json").out)
    assert data["verdict"] == "indistinct"
    told = {data["effects"][0]["name"], *(other["name"] for other in data["effects"][0]["alternatives"])}
    assert {"dead-path-drift", "tracer-drift"} <= told
    assert any("all around the tracers" in words for words in data["separate_by"])


@pytest.mark.parametrize(
    ("text", "code", "words"), [("straight-line", 2, "cannot be diagnosed yet"), ("nothing", 3, "job")]
)
def test_what_cannot_be_diagnosed_is_refused(text: str, code: int, words: str, job: Path, metrocli: Metrocli) -> None:
    if text == "nothing":
        job.write_text("metrocli: 1\n")
    ran = metrocli("diagnose", job)
    assert (ran.code, words in ran.err) == (code, True)


def known(folder: Path, true: float, stated: float, seed: int = 4) -> Path:
    """Write a measurement whose points are known, with an error that may not be the stated one."""
    m = lengths.measurement(np.random.default_rng([9, seed]), 50)
    off = np.random.default_rng([10, seed]).normal(0, true, m.points.shape)
    job = write(folder, replace(m, nominal=m.points + off))
    rows = (folder / "points.csv").read_text().splitlines()
    (folder / "points.csv").write_text("\n".join([f"{rows[0]},sigma_mm", *(f"{row},{stated}" for row in rows[1:])]))
    return job


@pytest.mark.parametrize(("true", "stated"), [(1e-3, 4e-3), (2e-3, 5e-4), (1e-3, 1e-3)])
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


def test_known_points_are_no_hindrance_to_what_tells_two_names_apart(folder: Path, metrocli: Metrocli) -> None:
    m = measured("dead-path-drift", 2.0)
    job = write(folder, replace(m, nominal=m.points))
    rows = (folder / "points.csv").read_text().splitlines()
    (folder / "points.csv").write_text("\n".join([f"{rows[0]},sigma_mm", *(f"{row},0.0001" for row in rows[1:])]))
    ran = metrocli("diagnose", job, "--json")
    data = json.loads(ran.out)
    assert data["verdict"] == "indistinct" and data["separate_by"]
