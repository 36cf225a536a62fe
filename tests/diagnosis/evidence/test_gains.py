"""What held-out readings gain: mixtures of predictions, and what the others do not determine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from benchmarks.hidden import lengths
from metrocli.diagnosis.evidence.folds import gain_of_parts, gains
from metrocli.diagnosis.evidence.gain import FoldPrediction
from metrocli.diagnosis.evidence.held_out import Fold, Others
from metrocli.diagnosis.evidence.identified import all_identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.moves import effects
from metrocli.diagnosis.evidence.state import State
from metrocli.effects.covariates import Covariate
from tests.diagnosis.evidence.test_dense import NETWORK, measurement, number_of_effect, unknowns, with_residual


def test_a_mixture_has_the_mean_density_and_the_variance_of_both() -> None:
    one = np.ones(2)
    without, other = (
        FoldPrediction(-3.0, np.array([2.0, 0.0]), one, one, one),
        FoldPrediction(-1.0, np.array([0.0, 1.0]), one, one, 2 * one),
    )
    mixed = without.mixed(other, 0.25)
    assert np.exp(mixed.score) == pytest.approx(0.75 * np.exp(-3.0) + 0.25 * np.exp(-1.0))
    draws = np.random.default_rng(5).normal(size=(200_000, 2))
    chosen = np.random.default_rng(6).random((200_000, 1)) < 0.25
    seen = np.where(chosen, other.errors + np.sqrt(2) * draws, without.errors + draws)
    assert mixed.errors == pytest.approx(seen.mean(axis=0), abs=0.02)
    assert mixed.variances == pytest.approx(seen.var(axis=0), rel=0.02)
    assert without.mixed(other, 1.0) is other
    assert without.mixed(other, 0.0).score == pytest.approx(-3.0)


def test_what_the_evidence_names_just_so_is_confirmed() -> None:
    """The fold that shows an effect most is the one without which it is not chosen: its part must not be lost."""
    m, rng = measurement(NETWORK), np.random.default_rng(11)
    family = number_of_effect(m, "refraction-drift")
    column = m.effect(family, 0).columns[:, 0]
    seen = column / np.linalg.norm(m.system.seen(column))
    sums = []
    while len(sums) < 12:
        drawn = with_residual(m, rng.normal(size=m.system.rows) + 4.0 * seen)
        state = State.of(drawn, [drawn.effect(family, 0)])
        net = float(state.without_fixed()[0])
        if 0 < net < 2:
            sums.append(net + gains(state, all_identified(state))[0].log_score)
    assert np.mean(np.array(sums) > 0) > 0.8


def test_what_the_others_do_not_determine_is_taken_off_a_prediction() -> None:
    """Without a tracer nothing says where it stands: its lengths are predicted but for its place and its dead path."""
    m = measurement(NETWORK)
    m = with_residual(m, np.random.default_rng(6).normal(size=m.system.rows))
    rows = np.flatnonzero(m.system.rows_at({"tracer": "T2"}))
    held = Others.of(Fold(m, rows), State.of(m)).predicted()
    others = np.setdiff1d(np.arange(m.system.rows), rows)
    columns, r = unknowns(m), m.system.residual
    error = r[rows] - columns[rows] @ (np.linalg.pinv(columns[others], 1e-10) @ r[others])
    unseen = columns[rows] @ scipy.linalg.null_space(columns[others], 1e-10)
    basis = np.linalg.svd(unseen, full_matrices=False)[0]
    assert basis.shape[1] == 4
    np.testing.assert_allclose(held.errors, error - basis @ (basis.T @ error), atol=1e-6)
    np.testing.assert_allclose(held.shares, 1 - (basis**2).sum(axis=1), atol=1e-9)
    assert held.shares.sum() == pytest.approx(len(rows) - 4) and held.variances.max() < 100


def beside_waves(*sizes: float) -> State:
    """Return the state of a network with a scale of a tracer, and a wave over each of as many covariates."""
    rng = np.random.default_rng([77, 1])
    job = lengths.measurement(rng, 60).adjusted()
    group = job.model.readings[0]
    order = [rng.permutation(group.observations.count).astype(float) for _ in sizes]
    waves = [Covariate(f"order {number}", {group.name: one}, periodic=True) for number, one in enumerate(order)]
    m = measurement_of(replace(job, covariates=tuple(waves)), quick=True)
    unknown = [number for number, family in enumerate(m.families) if family.unknown]
    scale = number_of_effect(m, "tracer-scale")
    off = 6 * m.effect(scale, 2).columns[:, 0]
    for number, size in zip(unknown, sizes, strict=True):
        off = off + size * m.whole(number, 7)[:, 0]
    return State.of(with_residual(m, m.system.residual + off), [m.effect(scale, 2), m.effect(unknown[0], 7)])


def test_an_effect_predicts_beside_what_has_no_known_cause() -> None:
    """A wave of six times the noise is in the predictions with the effect and without it, or it would drown the effect."""
    quiet, loud = beside_waves(0.0), beside_waves(6.0)
    found = [gains(state, all_identified(state))[0] for state in (quiet, loud)]
    assert found[1].log_score == pytest.approx(gain_of_parts(loud, loud.named).log_score, abs=1.0)
    assert found[1].log_score == pytest.approx(found[0].log_score, abs=1.0)
    assert found[1].log_score > 10 and found[1].before < 2 * found[0].before


def test_a_wave_over_one_covariate_leaves_room_for_that_over_another() -> None:
    """Both have the same number among the waves of their covariate."""
    state = beside_waves(6.0, 5.0)
    (first, *_) = effects(state)
    assert [(state.measurement.families[part.family].unknown, part.number) for part in first.fixed] == [("order 1", 7)]


def test_terms_of_laws_have_keys_of_their_own() -> None:
    """What an effect adds is kept by its key: that of a term of the same numbers is another."""
    m = beside_waves(0.0).measurement
    effect, term = m.effect(0, 0), m.term(m.whole(0, 1), (0, 0), 1.0)
    assert effect.key != term.key


def test_a_part_is_seen_in_place_of_one_with_the_same_columns() -> None:
    """Jumps between the same two readings are one: the first had hidden the other, and jumps gained exactly nothing."""
    m, rng = measurement(NETWORK), np.random.default_rng(13)
    part = m.effect(number_of_effect(m, "refraction-drift"), 0)
    state = State.of(with_residual(m, rng.normal(size=m.system.rows) + 20.0 * part.columns[:, 0]), [part])
    others, alike = Others.of_fold(state, 0), replace(part, number=part.number)
    assert others.with_fixed([alike]).kept == (alike,)
    assert others.with_fixed([alike]).predicted().score == pytest.approx(others.predicted().score)
