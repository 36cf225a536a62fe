"""What fits only at sizes that no instrument has, or at sizes that hinge on a few images, is not named."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import images
from benchmarks.hidden.scenes import board_scene, part_scene
from metrocli.diagnosis.diagnose import _confirmed
from metrocli.diagnosis.evidence.folds import gains, with_jackknife
from metrocli.diagnosis.evidence.identified import all_identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.state import State
from tests.diagnosis.evidence.test_dense import number_of_effect, with_residual


def board(count: int, size: tuple[int, int]) -> Measurement:
    rng = np.random.default_rng(31)
    return measurement_of(images.read(board_scene(rng, count, size), rng).adjusted())


def part() -> Measurement:
    rng = np.random.default_rng(32)
    return measurement_of(images.read(part_scene(rng, 30, 10), rng).adjusted())


def gain_of_a_wave(m: Measurement, rms: float) -> tuple[float, float]:
    """Return the gain of a wave over the order of the images that changes readings by so much, and what shows of it."""
    number = next(i for i, family in enumerate(m.families) if family.unknown)
    whole = m.whole(number, 0)[:, 0]
    wave = whole * rms * np.sqrt(m.system.rows) / np.linalg.norm(whole)
    rng = np.random.default_rng(33)
    drawn = with_residual(m, rng.normal(size=m.system.rows) + wave)
    return float(State.of(drawn).gains_of_family(number)[0][0]), float(np.linalg.norm(m.system.seen(wave)))


def test_a_wave_that_the_poses_absorb_is_no_cause_at_a_hundred_times_the_noise() -> None:
    gain, shown = gain_of_a_wave(board(12, (6, 5)), 100.0)
    assert shown > 8
    assert gain == 0


def test_a_wave_that_shows_is_one() -> None:
    # known poses absorb nothing of it
    gain, shown = gain_of_a_wave(part(), 2.0)
    assert shown > 8
    assert gain > 20


@pytest.mark.parametrize(("mean", "spread", "seed", "stays"), [(12.0, 2.0, 35, True), (5.0, 30.0, 8, False)])
def test_a_size_within_the_scatter_of_the_images_is_nothing(mean: float, spread: float, seed: int, stays: bool) -> None:
    m, rng = board(12, (6, 5)), np.random.default_rng(seed)
    skew = number_of_effect(m, "axis-skew")
    image = m.system.basis.member
    own = mean + spread * rng.normal(size=image.max() + 1)
    drawn = with_residual(m, rng.normal(size=m.system.rows) + m.effect(skew, 0).columns[:, 0] * own[image])
    state = State.of(drawn, [drawn.effect(skew, 0)], [], [], 0)
    before = with_jackknife(state, all_identified(state))
    # neither its evidence nor the held-out images speak against it
    assert state.without_fixed()[0] > 5
    assert gains(state, before)[0].log_score > -1e-9
    left, names, _, lost = _confirmed(state, map, quick=False)
    assert bool(names) == bool(left.named) == stays
    assert bool(lost) != stays


def test_of_two_that_nearly_cancel_each_other_the_one_of_more_evidence_stays() -> None:
    m, rng = board(12, (6, 5)), np.random.default_rng(36)
    skew, stretch = (number_of_effect(m, name) for name in ("axis-skew", "stretched-targets"))
    drawn = with_residual(m, rng.normal(size=m.system.rows) + m.effect(skew, 0).columns[:, 0] * 25)
    state = State.of(drawn, [drawn.effect(skew, 0), drawn.effect(stretch, 0)], [], [], 0)
    left, names, *_ = _confirmed(state, map, quick=False)
    assert [part.family for part in left.named] == [skew]
    assert names[0].level_of_size < 0.05
