"""locate-launch-unit on the command line: the sample, results in files, effects planted and found."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: locate-launch-unit
inputs: {poses: new/poses.csv, places: places.csv}
noise: {encoder: 5 arcsec, distance: 1 um}
simulation: {place: [950 mm, 430 mm, -250 mm], gamma: 80 deg, distances: true}
output: result.h5
"""
PLANTED = {
    "encoder-eccentricity.phi4": (
        "encoder-eccentricity:encoder=phi4,c1=30arcsec,s1=-20arcsec",
        "{name: encoder-eccentricity, encoder: phi4}",
    ),
    "belt-hysteresis.phi3": (
        "belt-hysteresis:encoder=phi3,width=60arcsec",
        "{name: belt-hysteresis, encoder: phi3}",
    ),
    "base-tilt.launch": ("base-tilt:unit=launch,tx=20arcsec,ty=-30arcsec", "{name: base-tilt, unit: launch}"),
    "beam-offset": ("beam-offset:h=0.2mm", "{name: beam-offset}"),
    "distance-scale": ("distance-scale:scale=20ppm", "{name: distance-scale}"),
    "machine-squareness.yz": ("machine-squareness:pair=yz,angle=100urad", "{name: machine-squareness, pair: yz}"),
    "bad-pose.P7": ("bad-pose:pose=P7,dx=0.3mm,dy=-0.4mm,dz=0.5mm", "{name: bad-pose, pose: P7}"),
}


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rng = np.random.default_rng(12)
    places = rng.uniform([0, 0, 50], [2000, 1000, 1000], (22, 3))
    rows = [
        f"P{i}," + ",".join(f"{x:.4f}" for x in place) + f",{90 * (i % 4)},{60 * i}" for i, place in enumerate(places)
    ]
    (tmp_path / "places.csv").write_text("\n".join(["pose,x_mm,y_mm,z_mm,spindle_deg,t_s", *rows, ""]))
    (tmp_path / "job.yaml").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    return Path("job.yaml")


LONG = ("beam-offset", "bad-pose.P7")


@pytest.mark.alike
@pytest.mark.parametrize(
    "label", [pytest.param(label, marks=pytest.mark.slow if label in LONG else ()) for label in PLANTED]
)
def test_what_simulate_plants_a_job_finds(label: str, job: Path, metrocli: Callable[..., object]) -> None:
    planted, named = PLANTED[label]
    assert metrocli("simulate", job, "--out", "new", "--effect", planted, "--seed", "5").code == 0  # type: ignore[attr-defined]
    truth = json.loads(Path("new/truth.json").read_text())
    assert metrocli("locate-launch-unit", job, "--set", f"effects=[{named}]").code == 0  # type: ignore[attr-defined]
    result, _ = hdf5.read(Path("result.h5"))
    found = [e for e in result.estimates if e.name.startswith(label)]
    off = np.array([(e.value - truth[e.name]) / e.std for e in result.estimates])
    assert np.abs(off).max() < 4
    assert found and max(abs(e.value) / e.std for e in found) > 10
    assert 0.7 < result.statistics["sigma0"] < 1.3  # type: ignore[operator]
    assert len(result.covariance) == len(result.estimates)
    code = metrocli("locate-launch-unit", job).code  # type: ignore[attr-defined]
    without, record = hdf5.read(Path("result.h5"))
    assert (code, record.status) == ((6, "doubtful") if without.statistics["sigma0"] > 2 else (0, "done"))  # type: ignore[operator]
    assert without.statistics["sigma0"] > 1.5  # type: ignore[operator]


REFUSED = {
    "phi1": (
        "{name: encoder-offset, encoder: phi1}",
        4,
        "encoder-offset.phi1 cannot be separated from the other unknowns",
    ),
    "encoder": ("{name: encoder-offset, encoder: phi5}", 3, "there is no encoder 'phi5'"),
    "axis": ("{name: machine-scale, axis: a}", 3, "there is no axis 'a'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_effects_that_cannot_be_added_are_refused(name: str, job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new")
    effect, code, words = REFUSED[name]
    ran = metrocli("locate-launch-unit", job, "--set", f"effects=[{effect}]")
    assert (ran.code, words in ran.err) == (code, True), ran.err  # type: ignore[attr-defined]
    assert not Path("result.h5").exists()


def test_effects_and_columns_that_are_missing(job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new", "--set", "simulation.distances=false")
    ran = metrocli("locate-launch-unit", job, "--set", "effects=[{name: distance-offset}]")
    assert ran.code == 3 and "needs a column distance_mm" in ran.err  # type: ignore[attr-defined]
    ran = metrocli("locate-launch-unit", job, "--set", "effects=[{name: beam-offset}]", "--set", "method=lines")
    assert ran.code == 3 and "only `method: adjustment`" in ran.err  # type: ignore[attr-defined]


def test_one_pose_ends_with_4_and_writes_nothing(job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new", "--set", "simulation.distances=false")
    Path("new/poses.csv").write_text("\n".join(Path("new/poses.csv").read_text().splitlines()[:2]) + "\n")
    ran = metrocli("locate-launch-unit", job)
    assert ran.code == 4 and "there is one pose" in ran.err  # type: ignore[attr-defined]
    assert not Path("result.h5").exists()


def test_a_missing_column_is_told(job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new")
    text = Path("new/poses.csv").read_text()
    Path("new/poses.csv").write_text(text.replace("phi3_rad", "phi3"))
    ran = metrocli("locate-launch-unit", job)
    assert ran.code == 3 and "phi3" in ran.err and "_deg" in ran.err  # type: ignore[attr-defined]
    Path("new/poses.csv").write_text(text.replace("\nP2,", "\nP1,"))
    ran = metrocli("locate-launch-unit", job)
    assert ran.code == 3 and "P1" in ran.err  # type: ignore[attr-defined]


def test_the_sample_runs_and_holds_the_truth(tmp_path: Path, metrocli: Callable[..., object]) -> None:
    project = tmp_path / "sample"
    assert metrocli("init", project, "--sample", "xm60-launch-unit").code == 0  # type: ignore[attr-defined]
    ran = metrocli("run", project)
    assert ran.code == 0, ran.err  # type: ignore[attr-defined]
    truth = {"ideal": (0, 1000, 1500, 20), "errors": (0, 1000, 1500, 20), "table": (85, 60, 45, -35)}
    for name, (*place, gamma) in truth.items():
        result, _ = hdf5.read(project / "results" / f"{name}.h5")
        true = np.array([*place, np.deg2rad(gamma)])
        off = np.array([e.value for e in result.estimates]) - true
        assert (np.abs(off) < 3.5 * np.array([e.std for e in result.estimates])).all(), name
        if name == "ideal":
            assert np.abs(off[:3]).max() < 1e-5
    planned = metrocli("plan", project / "jobs" / "table.yaml", "--json")
    assert planned.code == 0  # type: ignore[attr-defined]
    files = [Path(path) for path in json.loads(planned.out)["files"]]  # type: ignore[attr-defined]
    assert {path.name for path in files if path.suffix == ".nc"} == {
        f"{name}.nc" for name in ("x", "y", "z", "xy", "yz", "xz")
    }
    assert all(path.is_file() for path in files)
    assert (
        (project / "jobs" / "table.plan" / "points.csv")
        .read_text()
        .splitlines()[0]
        .startswith("line,axis,position_mm,x_mm")
    )
    compared = metrocli("locate-launch-unit", project / "jobs" / "table.yaml", "--compare")
    assert compared.code == 0 and "closed-loop" in compared.out  # type: ignore[attr-defined]


SWAPPED = {
    "phi1 and phi4": ("phi1_rad", "phi4_rad"),
    "phi2 and phi3": ("phi2_rad", "phi3_rad"),
    "phi3 and phi4": ("phi3_rad", "phi4_rad"),
}


@pytest.mark.alike
@pytest.mark.parametrize(
    "columns", [pytest.param(one, marks=pytest.mark.slow if one == "phi2 and phi3" else ()) for one in SWAPPED]
)
def test_diagnose_finds_swapped_columns(columns: str, job: Path, metrocli: Callable[..., object]) -> None:
    metrocli("simulate", job, "--out", "new", "--seed", "3")
    one, other = SWAPPED[columns]
    text = Path("new/poses.csv").read_text()
    Path("new/poses.csv").write_text(text.replace(one, "?").replace(other, one).replace("?", other))
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err  # type: ignore[attr-defined]
    found = json.loads(ran.out)  # type: ignore[attr-defined]
    assert found["verdict"] == "mistaken"
    assert (found["mistake"]["file"], found["mistake"]["what"]) == ("poses", f"{columns} are swapped")
    assert "in the headings" in found["mistake"]["write"]


def test_diagnose_names_what_was_planted(job: Path, metrocli: Callable[..., object]) -> None:
    planted, _ = PLANTED["base-tilt.launch"]
    metrocli("simulate", job, "--out", "new", "--effect", planted, "--seed", "5")
    found = json.loads(metrocli("diagnose", job, "--json").out)  # type: ignore[attr-defined]
    assert (found["verdict"], [e["name"] for e in found["effects"]]) == ("explained", ["base-tilt"])
    assert found["effects"][0]["where"] == {"unit": "launch"}
    hidden = {c["name"]: c["status"] for c in found["candidates"] if c["where"] == {"encoder": "phi1"}}
    assert hidden["encoder-offset"] == "not-testable"
    extended = metrocli("locate-launch-unit", found["extended_job"])
    assert extended.code == 0, extended.err  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_bad_pose_is_no_set_of_wrong_readings(job: Path, metrocli: Callable[..., object]) -> None:
    """Its distance is off by 440 standard deviations, its angles by 20: that is more than the error of one reading."""
    metrocli("simulate", job, "--out", "new", "--effect", PLANTED["bad-pose.P7"][0], "--seed", "5")
    found = json.loads(metrocli("diagnose", job, "--quick", "--json").out)  # type: ignore[attr-defined]
    assert [(e["name"], e["where"]) for e in found["effects"]] == [("bad-pose", {"pose": "P7"})]


@pytest.mark.slow
@pytest.mark.parametrize("distances", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_what_of_a_bad_pose_is_not_seen_has_no_standard_deviation(
    distances: bool, job: Path, metrocli: Callable[..., object]
) -> None:
    """Without a distance nothing sees the error along the beam, so dx, dy, dz are not known, only their sum across it."""
    planted = "bad-pose:pose=P7,dx=0.3mm,dy=-0.4mm,dz=0.5mm"
    metrocli(
        "simulate",
        job,
        "--out",
        "new",
        "--effect",
        planted,
        "--seed",
        "5",
        "--set",
        f"simulation.distances={distances}".lower(),
    )
    found = json.loads(metrocli("diagnose", job, "--json").out)  # type: ignore[attr-defined]
    assert [(e["name"], e["where"]) for e in found["effects"]] == [("bad-pose", {"pose": "P7"})]
    parts = found["effects"][0]["parameters"]
    if distances:
        for name, true in (("dx", 0.3), ("dy", -0.4), ("dz", 0.5)):
            assert abs(parts[name]["value"] - true) < 4 * parts[name]["std"] < 0.2
        assert "unseen" not in parts["dx"] and metrocli("locate-launch-unit", found["extended_job"]).code == 0  # type: ignore[attr-defined]
        return
    text = metrocli("diagnose", job).out  # type: ignore[attr-defined]
    assert all(part["std"] is None and part["unseen"] for part in parts.values())
    assert " ".join(text.split()).count("mm (not seen)") >= 3
    assert metrocli("locate-launch-unit", found["extended_job"]).code == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize("removes", [False, True])
def test_a_wrong_distance_is_no_wrong_unit(removes: bool, tmp_path: Path, metrocli: Metrocli) -> None:
    """All positions in um would bring a distance of 4 m too much nearer, and were advised."""
    metrocli("init", tmp_path / "p", "--sample", "xm60-launch-unit")
    job, data = tmp_path / "p" / "jobs" / "table.yaml", tmp_path / "p" / "data" / "table.csv"
    data.write_text(re.sub(r"(?m)^(A3,(?:[^,]+,){8})(\d+)", lambda m: f"{m[1]}{int(m[2]) + 4000}", data.read_text()))
    job.write_text(job.read_text() + "outliers: remove\n" * removes)
    ran, diagnosed = metrocli("locate-launch-unit", job), metrocli("diagnose", job, "--quick")
    assert (ran.code, diagnosed.code) == (0 if removes else 5, 0), diagnosed.err
    assert removes or "without the distance of A3 the rest fits" in ran.err
    assert "with 1 wrong reading\n" in diagnosed.out and "\nA3/distance " in diagnosed.out
    assert "_um" not in ran.err + diagnosed.out
    assert ("leaves wrong readings out.\n" if removes else "out; or measure them again.\n") in diagnosed.out
