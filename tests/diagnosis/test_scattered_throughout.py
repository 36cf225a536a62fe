"""All poses off at once, or one instrument noisier than declared: named as what they are, from plain formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden import images, launch
from benchmarks.hidden.scenes import part_scene
from metrocli.cli.diagnosis_report.candidates import candidate_lines
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.detectability import Detectability, WrongReading
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.variances import scattered_effects
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.hidden_change import UndetectedBias
from metrocli.diagnosis.power.average_power import ScatterCandidate, scatter_candidates
from metrocli.diagnosis.status import Conclusions, candidates
from metrocli.diagnosis.verdict import as_data
from metrocli.tasks.calibrate_machine.effects import OF_LENGTHS


def unit(seed: int, distances: bool, off: float = 0.0, noisier: tuple[float, ...] = (1.0,) * 5) -> Diagnosis:
    """A launch unit whose receiver stands `off` [mm] from its listed places, and whose readings are noisier."""
    rng = np.random.default_rng([12, seed])
    m = launch.measurement(rng, distances)
    true = replace(m, receivers=m.receivers + rng.normal(0, off, m.receivers.shape)) if off else m
    noise = rng.normal(size=m.read.shape) * m.sigma * np.array(noisier[: len(m.read)])[:, None]
    return diagnose(replace(m, read=true.predicted() + noise).adjusted())


@pytest.mark.parametrize("distances", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_machine_that_is_off_in_every_pose_is_one_finding(distances: bool) -> None:
    """30 um in each pose: no pose stands out of the others, and the residuals passed for noise or a squareness."""
    found = unit(3, distances, off=0.03)
    assert found.verdict == "explained" and not found.findings
    (one,) = found.scatters
    assert one.effect.name == "bad-pose" and not one.rivals
    assert abs(one.std - 0.03) < 3 * one.spread < 0.02
    text = of_diagnosis(found, None)
    assert "bad-pose at every pose" in text and "the machine's repeatability" in text


def test_an_encoder_noisier_than_declared_is_named_and_no_effect() -> None:
    found = unit(4, True, noisier=(1, 1, 4, 1, 1))
    assert not (found.findings or found.scatters)
    (one,) = found.variance_groups
    assert (one.key, one.name) == ("reading", "phi3") and 2.8 < one.ratio < 5.6
    assert found.noise.as_declared
    first = of_diagnosis(found, None).splitlines()[0]
    assert first.startswith("verdict: clean") and f"but phi3 is {one.ratio:.2g} times as noisy as the others" in first
    several = of_diagnosis(replace(found, variance_groups=(one,) * 3), None).splitlines()
    assert several[0].endswith("but 3 groups of readings are noisier or quieter than the others (below)")
    (line,) = [line for line in several if line.startswith("  Times as noisy as the others")]
    assert line.count(f"phi3 {one.ratio:.2g}") == 3


def test_distances_noisier_than_declared_or_poses_that_are_off_are_indistinct() -> None:
    """Only the distances are good enough to show a few micrometres: their noise and the poses' errors look alike."""
    found = unit(5, True, noisier=(1, 1, 1, 1, 4))
    assert found.verdict == "indistinct" and not found.findings
    (effect,) = as_data(found)["effects"]
    assert (effect["name"], effect["where"]) == ("bad-pose", {})
    (rival,) = effect["alternatives"]
    assert (rival["name"], rival["where"]) == ("noise", {"reading": "distance"})
    # the keys of all alternatives
    assert rival["correlation"] is None and rival["odds"] > 0.05
    assert "noise of distance" in of_diagnosis(found, None)


@pytest.mark.parametrize("which", ["poses", "targets"])
def test_a_part_seen_from_poses_that_are_off(which: str) -> None:
    """A machine that returns to 30 um, or a list of targets that is off by 50 um."""
    rng = np.random.default_rng(2)
    scene = part_scene(rng, 20, 16)
    poses = {"image": np.arange(20), "bad_pose": rng.normal(0, 0.03, (20, 3))}
    targets = {"target": np.arange(16), "moved": rng.normal(0, 0.05, (16, 3))}
    uv = scene.predicted(scene.start(), poses if which == "poses" else targets)
    found = diagnose(images.Images(scene, uv + rng.normal(0, scene.noise, uv.shape)).adjusted())
    assert found.verdict == "explained" and found.noise.as_declared
    assert [one.effect.name for one in found.scatters] == ["bad-pose" if which == "poses" else "moved-target"]


def test_a_scatter_shares_the_level_with_all_other_names() -> None:
    """3 % of measurements of white noise have a name of any kind, and a scatter is one of a dozen."""
    rng = np.random.default_rng(8)
    m = measurement_of(launch.measurement(rng, True).adjusted())
    named = 0
    for noise in rng.normal(size=(300, m.system.rows)):
        drawn = State.of(replace(m, system=replace(m.system, residual=m.system.seen(noise))))
        named += scattered_effects(drawn)[0].net > 0
    assert named <= 0.01 * 300


def test_one_bad_pose_and_none_are_no_scatter() -> None:
    rng = np.random.default_rng(6)
    m = launch.measurement(rng, True)
    assert not diagnose(m.adjusted()).scatters
    off = np.zeros(m.receivers.shape)
    off[7] = [0.3, -0.2, 0.3]
    true = replace(m, receivers=m.receivers + off)
    found = diagnose(replace(m, read=true.predicted() + rng.normal(size=m.read.shape) * m.sigma).adjusted())
    assert [str(one.effect.alternative) for one in found.findings] == ["bad-pose P7"] and not found.scatters


@pytest.mark.parametrize("seed", range(6))
def test_a_shape_of_a_lens_is_excluded_only_above_the_upper_bound_of_its_size(seed: int) -> None:
    """Waves over the image of half the noise, and none: what is excluded is larger than what is there."""
    rng = np.random.default_rng([17, seed])
    seen = images.read(images._scene("calibrate-camera", "x", rng, "board", True), rng)
    place = 3 * np.pi * (seen.uv - seen.uv.min(axis=0)) / np.ptp(seen.uv, axis=0)
    begin = rng.uniform(0, 2 * np.pi, (2, 2))
    wave = seen.scene.noise * np.sin(place[:, :1] + begin[0]) * np.cos(place[:, 1:] + begin[1])
    bounds = []
    for uv in (seen.uv, seen.uv + wave):
        job = replace(seen, uv=uv).adjusted()
        (shape,) = scatter_candidates(State.of(measurement_of(job)))
        bounds.append(shape.upper)
        # as if held-out readings had not to decide
        sought = Detectability((), (), (), (), (replace(shape, required=False),))
        (entry,) = candidates(job, sought, Conclusions())
        assert entry["status"] == "excluded" and entry["above"]["value"] == max(shape.upper, shape.detectable)
        assert f"{entry['above']['value']:.2g} px" in entry["reason"]
    assert bounds[0] < shape.detectable * 1.5 and bounds[1] > max(float(wave.std()), shape.detectable)


def test_a_search_that_ended_early_excludes_no_scatter_and_no_wrong_reading() -> None:
    """What the search did not reach is neither there nor excluded."""
    job = launch.measurement(np.random.default_rng(7), True).adjusted()
    effect = next(effect for effect in OF_LENGTHS if effect.throughout)
    sought = ScatterCandidate(effect, effect.plausible / 2, UndetectedBias(0.0))
    single = next(effect for effect in OF_LENGTHS if effect.of_one_reading)
    wrong = WrongReading(single, 0.01, (0.01, 0.02), UndetectedBias(0.0), 0)
    design = Detectability((), (), (), (wrong,), (sought,))
    (large,) = candidates(
        job, Detectability((), (), (), (), (replace(sought, upper=2 * effect.plausible),)), Conclusions()
    )
    assert large["status"] == "cannot-see"
    for decided, word in ((True, "excluded"), (False, "not-decided")):
        found = Conclusions(decided=decided)
        assert [entry["status"] for entry in candidates(job, design, found)] == [word] * 2
        for line in candidate_lines(job, design, found)[1:]:
            assert word in line and ("the search ended before this was decided" in line) is not decided


def test_a_named_scatter_hides_nothing() -> None:
    """It is in the model then, and changes no result unseen."""
    job = launch.measurement(np.random.default_rng(7), True).adjusted()
    effect = next(effect for effect in OF_LENGTHS if effect.throughout)
    large = ScatterCandidate(effect, effect.plausible / 2, UndetectedBias(1.0))
    design, found = Detectability((), (), (), (), (large,)), Conclusions(scattered=(effect.name,))
    (entry,) = candidates(job, design, found)
    assert entry["status"] == "named" and entry["hides"] is None
    (line,) = candidate_lines(job, design, found)[1:]
    assert line.split() == [effect.name, "everywhere", "named"]
