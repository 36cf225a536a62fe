"""Effects in jobs of multilaterate: planted by simulate, estimated or applied by a job, told in the result."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metrocli.formats import csv, hdf5
from metrocli.tasks.multilaterate.settings import LENGTHS

TRACERS = """tracer,x_mm,y_mm,z_mm
LT1,-600,-500,100
LT2,1900,-400,-200
LT3,700,1700,0
LT4,800,400,1900
LT5,2000,1500,1100
"""
JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: new/lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
simulation: {mover_error: 5 um, interval: 20 s, warming: 1 K}
output: result.h5
"""
PLANTED = {
    "dead-path-drift.LT2": ("dead-path-drift:tracer=LT2,rate=0.3um/min", "{name: dead-path-drift, tracer: LT2}"),
    "refraction-drift": ("refraction-drift:rate=3e-6 1/K", "{name: refraction-drift}"),
    "dead-path-jump.LT4": (
        "dead-path-jump:tracer=LT4,step=4um,at=700s",
        "{name: dead-path-jump, tracer: LT4, at: 700 s}",
    ),
}


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    points = np.random.default_rng(12).uniform(0, 1, (60, 3)) * [1300, 1000, 800]
    rows = [f"P{i}," + ",".join(f"{x:.4f}" for x in point) for i, point in enumerate(points)]
    (tmp_path / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *rows, ""]))
    (tmp_path / "tracers.csv").write_text(TRACERS)
    (tmp_path / "job.yaml").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    return Path("job.yaml")


@pytest.mark.alike
@pytest.mark.parametrize("label", PLANTED)
def test_what_simulate_plants_a_job_finds(label: str, job: Path, metrocli: Callable[..., object]) -> None:
    planted, named = PLANTED[label]
    assert metrocli("simulate", job, "--out", "new", "--effect", planted, "--seed", "5").code == 0
    truth = json.loads(Path("new/truth.json").read_text())
    assert metrocli("multilaterate", job, "--set", f"effects=[{named}]").code == 0
    result, _ = hdf5.read(Path("result.h5"))
    found = [e for e in result.estimates if e.name.startswith(label)]
    assert len(found) == 1
    assert abs(found[0].value - truth[found[0].name]) <= 3 * found[0].std
    assert abs(found[0].value) > 10 * found[0].std
    table = result.tables[f"effects/{label}/parameters"]
    assert table.texts("name")[0] == found[0].name.rpartition(".")[2]
    assert np.isclose(np.sqrt(result.arrays[f"effects/{label}/covariance"][0, 0]), found[0].std)
    assert np.isclose(result.covariance[-1, -1], found[0].std ** 2)
    assert 0.7 < result.statistics["sigma0"] < 1.3


def test_a_known_effect_is_applied(job: Path, metrocli: Callable[..., object]) -> None:
    planted, named = PLANTED["dead-path-drift.LT2"]
    metrocli("simulate", job, "--out", "new", "--effect", planted, "--seed", "5")
    metrocli("multilaterate", job)
    without = hdf5.read(Path("result.h5"))[0].statistics["sigma0"]
    metrocli("multilaterate", job, "--set", f"effects=[{named.replace('LT2}', 'LT2, rate: 0.3 um/min}')}]")
    result, _ = hdf5.read(Path("result.h5"))
    assert without > 1.5 > 1.3 > result.statistics["sigma0"]
    assert not any(e.name.startswith("dead-path-drift") for e in result.estimates)
    assert not result.tables["effects/dead-path-drift.LT2/parameters"].columns["estimated"].any()


def test_simulation_keeps_the_times_of_lengths_that_exist(job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new")
    text = Path("new/lengths.csv").read_text().splitlines()
    Path("new/lengths.csv").write_text("\n".join([text[0], *text[:0:-1]]) + "\n")
    before = csv.read(Path("new/lengths.csv"), LENGTHS)
    metrocli("simulate", job, "--out", "again", "--effect", PLANTED["refraction-drift"][0])
    after = csv.read(Path("again/lengths.csv"), LENGTHS)
    for name in ("point", "tracer", "t", "temp"):
        assert list(before.columns[name]) == list(after.columns[name])


REFUSED = {
    "place": ("{name: dead-path-drift, tracer: LT9}", 3, "there is no tracer 'LT9'"),
    "unit": ("{name: dead-path-drift, tracer: LT2, rate: 1 mm}", 3, "not of a speed"),
    "key": ("{name: dead-path-drift, tracr: LT2}", 3, "did you mean 'tracer'?"),
    "time": ("{name: dead-path-jump, tracer: LT2}", 3, "the key 'at' is missing"),
    "absorbed": ("{name: length-scale}", 4, "length-scale cannot be separated from the other unknowns"),
}


@pytest.mark.parametrize("name", [*list(REFUSED)[:-1], pytest.param("absorbed", marks=pytest.mark.slow)])
def test_what_cannot_be_added_is_refused_in_words(name: str, job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new")
    effect, code, words = REFUSED[name]
    ran = metrocli("multilaterate", job, "--set", f"effects=[{effect}]")
    assert (ran.code, words in ran.err) == (code, True), ran.err
    assert not Path("result.h5").exists()


def test_an_effect_without_its_column_is_refused(job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new", "--set", "simulation={mover_error: 5 um}")
    ran = metrocli("multilaterate", job, "--set", "effects=[{name: dead-path-drift, tracer: LT2}]")
    assert ran.code == 3
    assert "needs a column t_s" in ran.err


@pytest.mark.parametrize("effect", ["dead-path-drift:tracer=LT2", "dead-path-drift:LT2", ":rate=1um/min"])
def test_a_simulation_needs_every_value(effect: str, job: Path, metrocli: Callable[..., object]) -> None:
    ran = metrocli("simulate", job, "--out", "new", "--effect", effect)
    assert ran.code in (2, 3)
    assert effect in ran.err
    assert not Path("new").exists()
