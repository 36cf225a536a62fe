"""A wrong reading, and the effect at its place that would explain it as well: from plain formulas."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tasks.shared.images import small_jobs

from benchmarks.hidden import images, launch, lengths
from benchmarks.hidden_effects import KINDS
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.cli.diagnosis_report.loop import loop_text
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.verdict import as_data
from metrocli.diagnosis.wrong_readings import wrong_readings
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load
from metrocli.project.until_clean import End, Loop


def test_a_bad_pose_that_only_its_distance_shows_stands_beside_the_wrong_distance() -> None:
    """20 um along the beam: the angles do not show it, and a distance of 1 um that is wrong by 20 um looks the same."""
    rng = np.random.default_rng(3)
    m = launch.measurement(rng, True)
    off = np.zeros(m.receivers.shape)
    beam = m.receivers[4] - m.unit[:3]
    off[4] = 0.02 * beam / np.linalg.norm(beam)
    true = replace(m, receivers=m.receivers + off)
    found = diagnose(replace(m, read=true.predicted() + rng.normal(size=m.read.shape) * m.sigma).adjusted())
    (wrong,) = as_data(found)["outliers"]
    assert (wrong["observation"]["pose"], wrong["observation"]["reading"]) == ("P4", "distance")
    assert wrong["or_effects"] == [{"name": "bad-pose", "where": {"pose": "P4"}}]
    assert "bad-pose P4" in of_diagnosis(found, None).split("\n\n")[1]
    # the loop --until-clean has nothing to add, and states the wrong reading, too
    looped = loop_text(Loop(found, found, (), End.CLEAN))
    assert looped == "verdict: clean, with 1 wrong reading\n\nended: clean"


def test_a_wrong_angle_is_no_bad_pose() -> None:
    """The other angles of the pose contradict that it stood elsewhere."""
    rng = np.random.default_rng(4)
    m = launch.measurement(rng, True)
    read = m.read.copy()
    read[2, 5] += 12 * launch.ENCODER
    (wrong,) = as_data(diagnose(replace(m, read=read).adjusted()))["outliers"]
    assert wrong["observation"]["reading"] == "phi3" and wrong["or_effects"] == []


@pytest.mark.alike
@pytest.mark.parametrize("wrong_by", [100.0, 10.0])
def test_a_gross_length_gives_no_effects(wrong_by: float) -> None:
    """It moves points and tracers so far that what derivatives miss there looked like effects."""
    m = lengths.measurement(np.random.default_rng(5), 60)
    off = np.zeros(len(m.length))
    off[77] = wrong_by
    found = diagnose(replace(m, length=m.length + off).adjusted())
    assert found.verdict == "clean" and not found.findings and not found.variance_groups
    assert len(found.outliers) == 1 and 0.8 < found.noise.ratio < 1.2


@pytest.mark.parametrize("apart", [True, False])
def test_only_what_shows_alike_stands_in_the_place_of_a_wrong_reading(apart: bool) -> None:
    """Errors of 7 sigma in two lengths that have little in common, or in one of two whose tests are nearly the same."""
    m = measurement_of(lengths.measurement(np.random.default_rng(8), 30).adjusted())
    rows = m.places[:, 0]
    errors = np.zeros((m.system.rows, len(rows)))
    errors[rows, np.arange(len(rows))] = 1.0
    errors = m.system.seen(errors)
    shown = np.linalg.norm(errors, axis=0)
    errors = (errors / np.maximum(shown, 1e-9))[:, shown > 0.3]
    alike = np.abs(errors.T @ errors)
    chosen = np.argwhere(alike < 1e-3)[0] if apart else np.argwhere(np.triu(alike, 1) == np.triu(alike, 1).max())[0]
    pair = errors[:, chosen]
    noise = m.system.seen(np.random.default_rng(9).normal(size=m.system.rows))
    residual = noise - pair @ np.linalg.lstsq(pair, noise, rcond=None)[0] + 7 * pair @ [1.0, float(apart)]
    one, other = (m.reading(int(np.flatnonzero(shown > 0.3)[at])) for at in chosen)
    (wrong,) = wrong_readings(State.of(replace(m, system=replace(m.system, residual=residual), cache={}), [one]))
    assert wrong.keys == m.keys_of(one.number) and 4 < wrong.test < 9
    assert (m.keys_of(other.number) in wrong.others) is not apart


def test_a_tracer_with_another_fault_than_noise_gives_no_effects() -> None:
    """All its lengths are off by tenths of millimetres: its noise is 2,000 times that of the others."""
    rng = np.random.default_rng(7)
    m = lengths.measurement(rng, 60)
    off = np.where(m.tracer == 2, rng.normal(0, 0.2, len(m.length)), 0.0)
    found = diagnose(replace(m, length=m.length + off).adjusted())
    assert not found.findings and not found.scatters
    places = {one.keys["tracer"] for one in found.outliers} | {group.name for group in found.variance_groups}
    assert places == {"T2"} and 0.8 < found.noise.ratio < 1.2


def test_a_term_of_a_lens_is_named_beside_a_gross_coordinate() -> None:
    """The rounds that adjust with the terms begin at the job as it is, not at that of the round before."""
    rng, name = np.random.default_rng(1), "radial-distortion"
    scene = images._scene("calibrate-camera", "x", rng, "board", True)
    planted = images.planted(
        images.read(images.without(scene, [images.PLANTS["calibrate-camera"][name]], [name]), rng), rng, name, 300
    )
    assert planted is not None
    seen, _ = planted
    uv = seen.uv.copy()
    uv[5, 0] += 300 * seen.scene.noise
    found = diagnose(replace(seen, uv=uv).adjusted())
    assert found.findings[0].effect.alternative.effect.name == name
    assert len(found.outliers) == 1 and 0.8 < found.noise.ratio < 1.2


def test_a_gross_distance_of_a_launch_unit_gives_no_effects() -> None:
    m = launch.measurement(np.random.default_rng(6), True)
    read = m.read.copy()
    read[launch.READINGS.index("distance"), 5] += 100.0
    found = diagnose(replace(m, read=read).adjusted())
    assert found.verdict == "clean" and not found.findings and len(found.outliers) == 1


@pytest.mark.alike
@pytest.mark.parametrize("number", [302, 1582])
def test_one_wrong_coordinate_is_no_bad_pose_nor_a_moved_target(number: int) -> None:
    """An image of two targets, or a target in one image: the effect explains the coordinate, and so does the error."""
    case = KINDS["align-part"].case(number, False)
    found = diagnose(case.adjusted())
    assert not found.findings and found.verdict == "clean"
    assert {tuple(one.keys.values()) for one in found.outliers} == case.outliers


@pytest.mark.parametrize("number", [345, *(pytest.param(number, marks=pytest.mark.slow) for number in (1605, 1725))])
def test_an_image_of_few_readings_that_is_noisier_has_no_bad_pose(number: int) -> None:
    """Three targets: a bad pose takes half of what the noise adds, and hid the rest of it."""
    found = diagnose(KINDS["align-part"].case(number, False).adjusted())
    assert not found.findings and not found.outliers
    (unit,) = found.variance_groups
    assert unit.key == "image" and 2 < unit.ratio < 5


@pytest.fixture
def earlier_plants(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plants from which the cases of these numbers were drawn; the candidates of the diagnosis are all."""
    plants = images.PLANTS["align-part"]
    later = ("machine-angular", "spindle-growth", "rolling-shutter")
    kept = {name: plant for name, plant in plants.items() if name not in later}
    monkeypatch.setitem(images.PLANTS, "align-part", kept)


@pytest.mark.alike
@pytest.mark.parametrize(("number", "name"), [(148, "bad-pose"), (309, "moved-target")])
@pytest.mark.usefixtures("earlier_plants")
def test_a_bad_pose_of_an_image_of_two_or_three_targets_is_no_noise(number: int, name: str) -> None:
    case = KINDS["align-part"].case(number, False)
    found = diagnose(case.adjusted())
    (one,) = found.findings
    assert (one.effect.alternative.effect.name, one.effect.alternative.where) == (name, case.hidden[0].where)
    assert not found.variance_groups


@pytest.mark.usefixtures("earlier_plants")
def test_noise_of_an_image_that_explains_as_much_stands_beside_the_bad_pose() -> None:
    """A bad pose of just the least detectable size: more noise in this image looks much like it."""
    found = diagnose(KINDS["align-part"].case(3047, False).adjusted())
    (effect,) = as_data(found)["effects"]
    assert (effect["name"], effect["where"]) == ("bad-pose", {"image": "I016"})
    (noise,) = effect["alternatives"]
    assert (noise["name"], noise["where"]) == ("noise", {"image": "I016"}) and 0.05 < noise["odds"] < 20
    assert found.verdict == "indistinct"
    assert "noise of image I016" in of_diagnosis(found, None).split("\n\n")[1]


def test_a_wrong_first_length_is_no_jump() -> None:
    """Beside the dead path a jump after the first length of a tracer changes just that length."""
    m = lengths.measurement(np.random.default_rng(6), 30)
    rows = np.flatnonzero(m.tracer == 2)
    at = rows[np.argmin(m.t[rows])]
    length = m.length.copy()
    length[at] += 15 * m.sigma[at]
    found = diagnose(replace(m, length=length).adjusted())
    (wrong,) = as_data(found)["outliers"]
    assert found.verdict == "clean" and wrong["observation"] == {"point": f"P{m.point[at]}", "tracer": "T2"}
    assert {"name": "dead-path-jump", "where": {"tracer": "T2"}} in wrong["or_effects"]


def test_a_target_that_a_single_image_shows_elsewhere_is_no_moved_one(tmp_path: Path) -> None:
    """Its depth is not seen, and nothing but its one image speaks for the move."""
    job = small_jobs.cmm(tmp_path)
    lines = (tmp_path / "observations.csv").read_text().splitlines()
    image, target, u, v = lines[9].split(",")
    lines[9] = f"{image},{target},{float(u) + 1.0},{float(v) + 1.5}"
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n")
    found = diagnose(adjusted_job_of(load(job)))
    assert not found.findings
    assert {(one.keys["target"], one.keys["component"]) for one in found.outliers} == {(target, "u"), (target, "v")}
