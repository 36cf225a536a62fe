"""A wrong reading, and the effect at its place that would explain it as well: from plain formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.hidden import launch
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.verdict import as_data


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


def test_a_wrong_angle_is_no_bad_pose() -> None:
    """The other angles of the pose contradict that it stood elsewhere."""
    rng = np.random.default_rng(4)
    m = launch.measurement(rng, True)
    read = m.read.copy()
    read[2, 5] += 12 * launch.ENCODER
    (wrong,) = as_data(diagnose(replace(m, read=read).adjusted()))["outliers"]
    assert wrong["observation"]["reading"] == "phi3" and wrong["or_effects"] == []
