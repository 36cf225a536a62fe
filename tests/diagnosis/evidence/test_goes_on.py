"""The search goes on without an effect that held-out readings do not confirm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden import images
from benchmarks.hidden.scenes import board_scene
from metrocli.diagnosis.confirmation import not_confirmed, with_confirmed, with_confirmed_effects
from metrocli.diagnosis.evidence.identified import identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.moves import Move
from metrocli.diagnosis.evidence.parts import CORRELATED, EFFECT, SCATTER
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.variances import Found, scattered_effects
from metrocli.diagnosis.evidence.weights import with_noise
from metrocli.diagnosis.rounds import _terms_instead, _with_rivals
from tests.diagnosis.evidence.test_dense import with_residual


@pytest.mark.parametrize("seed", [0, 3, 6])
def test_the_cause_that_an_unconfirmed_shape_stood_for_is_named(seed: int) -> None:
    rng = np.random.default_rng(seed)
    read = images.read(board_scene(rng, 10, (6, 5)), rng)
    below = read.uv[:, 1] - read.scene.image_size[1] / 2
    # a skew of all images, and another of each: few images decide on what they share
    skew = 1e-3 * (1 + 0.8 * rng.normal(size=len(read.scene.time)))[read.scene.view]
    uv = read.uv + np.stack([skew * below, np.zeros(len(below))], axis=1)
    job = replace(read, uv=uv).adjusted()
    m = measurement_of(job)
    shape = next(one for one in scattered_effects(State.of(m)) if m.scatters[one.key[0]][0].name == "lens-shape")
    begin = State.of(m, random=[shape.part(m)], logs=[shape.log])
    ((part, against),) = not_confirmed(begin)
    assert part.kind == SCATTER and "lens-shape" in against.name
    state, lost = with_confirmed(job, begin)
    assert lost[0] == against and all(one.kind != SCATTER for one in state.random)
    assert [state.measurement.alternative(one.key).effect.name for one in state.named] == ["axis-skew"]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_cause_beside_an_effect_that_held_out_readings_refute_is_named(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = measurement_of(images.read(board_scene(rng, 10, (6, 5)), rng).adjusted())
    numbers = {family.alternatives[0].effect.name: number for number, family in enumerate(m.families)}
    prism, skew = (m.effect(numbers[name], 0).columns[:, 0] for name in ("thin-prism", "axis-skew"))
    # a skew of all images, and a prism of a few: those that are held out do not have it
    few = np.isin(m.system.basis.member, [0, 1])
    drawn = with_residual(m, rng.normal(size=m.system.rows) + 25 * skew + 8 * prism * few)
    begin = State.of(drawn, [drawn.effect(numbers["thin-prism"], 0)])
    state, names, gained, lost = with_confirmed_effects(begin, map, quick=False)
    assert "axis-skew" in [one.alternative.effect.name for one in names]
    assert gained[0].log_score > 0
    assert [one.name for one in lost] == ["thin-prism"]
    # what was refuted is no rival of anything; one whose size may be nothing beside the other is still
    assert (numbers["thin-prism"] in state.measurement.prices.refuted) == (lost[0].size_level is None)


def test_a_part_that_leaves_and_enters_again_has_the_same_columns() -> None:
    """Noise of two images that is found between makes other directions of a smooth effect too small to see."""
    rng = np.random.default_rng(22)
    m = measurement_of(images.read(board_scene(rng, 8, (5, 4)), rng).adjusted())
    number = next(i for i, families in enumerate(m.scatters) if families[0].name == "lens-shape")
    before = State.of(m, random=[m.scatter(number)], logs=[0.0])
    noisier = [i for i, unit in enumerate(m.units) if unit[0] == "image"][:4]
    weighted = with_noise(m, dict.fromkeys(noisier, 30.0))
    (stays,), enters = before.at(weighted).random, weighted.random(SCATTER, (number, 0, -1))
    assert stays.unit == enters.unit and np.allclose(stays.columns, enters.columns, rtol=1e-12, atol=0)


def test_an_effect_at_all_its_places_is_not_like_an_error_with_its_number() -> None:
    rng = np.random.default_rng(22)
    m = measurement_of(images.read(board_scene(rng, 8, (5, 4)), rng).adjusted())
    found = scattered_effects(State.of(m))[0]
    error = Move(1.0, entering=Found(1.0, CORRELATED, found.key, found.log))
    assert not error.is_like(found.part(m))
    assert Move(1.0, entering=found).is_like(found.part(m))


def test_a_term_that_explains_as_well_about_its_own_solution_is_a_rival() -> None:
    """To first order about the other's it explains less: about each solution, the readings look like its own term."""
    rng = np.random.default_rng(24)
    m = measurement_of(images.read(board_scene(rng, 8, (5, 4)), rng).adjusted())
    numbers = {family.alternatives[0].effect.name: n for n, family in enumerate(m.families)}
    noise = m.system.seen(rng.normal(size=m.system.rows))

    def alone(name: str, left: float) -> State:
        part = m.effect(numbers[name], 0)
        shown = m.system.seen(part.columns[:, 0])
        return State.of(with_residual(m, left * noise + 25.0 * shown / np.linalg.norm(shown)), [part])

    state, as_well, less = alone("thin-prism", 1.0), alone("sensor-tilt", 1.0), alone("axis-skew", 1.2)
    before = [one.alternative.effect.name for one in identified(state, state.fixed[0]).rivals]
    assert not before
    found = _with_rivals(state, [state, as_well, less])
    (rival,) = identified(found, found.fixed[0]).rivals
    assert rival.alternative.effect.name == "sensor-tilt" and 0.05 < rival.odds <= 1
    # it stays one where the same parts have other weights
    (kept,) = found.at(with_noise(found.measurement, {0: 1.1})).fixed
    assert kept.rivals == found.fixed[0].rivals


def test_a_wave_that_nothing_names_is_tried_in_place_of_no_term_of_a_lens(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stands in the state already: tried once more, its columns would enter twice."""
    rng = np.random.default_rng(23)
    m = measurement_of(images.read(board_scene(rng, 8, (5, 4)), rng).adjusted(), quick=True)
    at = next(number for number, family in enumerate(m.families) if family.unknown)
    term = next(n for n, family in enumerate(m.families) if family.alternatives[0].effect.name == "thin-prism")
    columns = [m.families[family].columns.whole([0], m.system.rows)[:, 0].sum(axis=1) for family in (at, term)]
    # the poses of a board take most of a wave: one that shows is larger than a wave may be
    monkeypatch.setattr("metrocli.diagnosis.evidence.state.LARGEST", 20.0)
    m = with_residual(m, sum(30 * m.system.seen(shape) / np.linalg.norm(m.system.seen(shape)) for shape in columns))
    state = State.of(m, [m.effect(at, 0), m.effect(term, 0)])
    instead = _terms_instead(state.minus([state.fixed[1]]), (term, 0))
    assert instead and all(part.sort == EFFECT for part in instead)
