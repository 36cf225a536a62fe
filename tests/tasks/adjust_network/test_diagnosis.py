"""What is hidden in a network is named with its place, and nothing where nothing is hidden."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated.network import Network, network, polar

from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

pytestmark = pytest.mark.slow


def diagnosed(net: Network, folder: Path) -> Diagnosis:
    return diagnose(adjusted_job_of(load(net.write(folder))))


def named(found: Diagnosis) -> list[tuple[str, dict[str, str]]]:
    return [(one.effect.alternative.effect.name, one.effect.alternative.where) for one in found.findings]


def test_nothing_is_named_where_nothing_is_hidden(tmp_path: Path) -> None:
    found = diagnosed(network(np.random.default_rng(61), 3, 16, faces=2), tmp_path)
    assert named(found) == []
    assert found.left is None


def test_a_bar_is_a_cause_and_a_single_reading_is_not(tmp_path: Path) -> None:
    net = network(np.random.default_rng(62), 3, 16, mixed=True)
    (a, b, length), other = net.bars
    seen = net.seen.copy()
    seen[20, 2] += 0.2
    found = diagnosed(replace(net, bars=((a, b, length + 0.2), other), seen=seen), tmp_path)
    assert ("bar-error", {"bar": "B1"}) in named(found)
    assert [one.keys["quantity"] for one in found.outliers] == ["d"]


def test_a_beam_offset_is_named_from_both_faces(tmp_path: Path) -> None:
    net = network(np.random.default_rng(63), 3, 16, faces=2)
    face, (_, e, d) = np.where(net.face == 1, 1.0, -1.0), net.seen.T
    shift = np.stack([face * 0.02 / (d * np.cos(e)), np.zeros_like(d), np.zeros_like(d)], axis=1)
    found = diagnosed(net.with_effect(shift), tmp_path)
    assert ("tracker-beam-offset", {"instrument": "A"}) in named(found)


def test_a_moved_point_speaks_against_no_other_effect(tmp_path: Path) -> None:
    """No other point shows the move: beside its error the tilt lost what it gained at all other points."""
    net = network(np.random.default_rng(76), 4, 20, faces=2)
    tilt = 1e-4 * np.where(net.face == 1, 1.0, -1.0) * np.tan(net.seen[:, 1])
    moved = ((net.point == 4) & (net.station > 0))[:, None] * np.array([0.4, -0.5, 0.6])
    turned, away = net.rotations[net.station], net.points[net.point] - net.places[net.station]
    before, after = (polar(np.einsum("nab,na->nb", turned, away + shift)) for shift in (0.0, moved))
    change = after - before + np.outer(tilt, [1.0, 0.0, 0.0])
    found = diagnosed(replace(net, times=True).with_effect(change), tmp_path)
    scores = {one.effect.alternative.effect.name: one.gain.log_score for one in found.findings}
    assert set(scores) == {"tracker-transit-tilt", "point-moved"} and found.verdict == "explained"
    assert scores["tracker-transit-tilt"] > 50, scores
