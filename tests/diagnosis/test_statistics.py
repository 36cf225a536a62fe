"""The statistics of diagnosis against plain least squares, scipy's distributions and simulated noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from benchmarks.hidden import launch, lengths
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import design
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.identified import determined
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.moves import moves
from metrocli.diagnosis.evidence.search import forward
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.counting import effective_number_of_tests
from metrocli.diagnosis.linear.distributions import chi_interval, log_family, log_tail, noncentrality, single_level
from metrocli.diagnosis.linear.families import families_of
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.diagnosis.power.average_power import size_found

Array = np.typing.NDArray[np.float64]


@cache
def adjusted() -> AdjustedJob:
    return lengths.measurement(np.random.default_rng(2), 30).adjusted()


@cache
def field() -> Measurement:
    return measurement_of(adjusted())


@cache
def start() -> State:
    return State.of(field())


def seen(family: int, number: int) -> Array:
    """Columns of a candidate, without what the unknowns absorb."""
    return np.asarray(field().system.seen(field().whole(family, number)))


@cache
def plain() -> tuple[Array, Array, Array]:
    """Derivatives by differences of the chain's predictions, residuals and standard deviations, one reading a row."""
    model = adjusted().model
    group = model.readings[0]
    columns = []
    for name, block in model.blocks.items():
        for member, column in zip(*np.nonzero(block.free), strict=True):
            step = np.zeros(block.values.shape)
            step[member, column] = 0.01

            def at(h: float, name: str = name, block=block, step: Array = step) -> Array:  # type: ignore[no-untyped-def]
                return group.chain.predict({**model.blocks, name: block.moved(h * step)}, group.observations)[0]

            columns.append((at(1.0) - at(-1.0)) / 0.02)
    sigma = group.observations.sigma[0]
    return np.stack(columns, axis=1) / sigma[:, None], group.residuals(model.blocks)[0] / sigma, sigma


def test_what_is_seen_is_what_least_squares_leaves() -> None:
    system = field().system
    values = np.random.default_rng(0).normal(size=(system.rows, 3))
    size = np.linalg.norm(plain()[0], axis=0)
    expected = values - (plain()[0] / size) @ np.linalg.lstsq(plain()[0] / size, values, rcond=1e-9)[0]
    assert np.abs(system.seen(values) - expected).max() < 1e-6
    assert system.dof == system.rows - plain()[0].shape[1] + 6


def test_absorbed_changes_are_those_of_the_adjustment_in_its_datum() -> None:
    system = field().system
    model = adjusted().model
    values = np.random.default_rng(1).normal(size=system.rows)
    change = system.absorbed(values[:, None])
    shift = system.shift(change, "point", (0, 1, 2))[:, :, 0]
    tracer = system.shift(change, "tracer", (0, 1, 2, 3))[:, :, 0]
    block = model.blocks["point"]
    free = [np.nonzero(b.free) for b in model.blocks.values()]
    full = np.concatenate(
        [
            (shift if name == "point" else tracer)[where]
            for (name, _), where in zip(model.blocks.items(), free, strict=True)
        ]
    )
    assert np.abs(values - system.seen(values) - plain()[0] @ full).max() < 1e-5
    assert np.abs(shift.sum(axis=0)).max() < 1e-9
    assert (
        np.abs(np.cross(block.values, shift).sum(axis=0)).max()
        < 1e-4 * np.abs(block.values).max() * np.abs(shift).max()
    )


def test_where_no_effect_can_be_tried_structure_is_still_told() -> None:
    m = lengths.measurement(np.random.default_rng(2), 40)
    wave = 1e-3 * np.sin(2 * np.pi * (m.t - m.t.min()) / np.ptp(m.t)) * (m.tracer == 1)
    found = diagnose(replace(replace(m, length=m.length + wave).adjusted(), effects=()))
    assert (found.verdict, found.left and found.left.where) == ("unexplained", ("T1",))


@pytest.mark.parametrize(("q", "rest"), [(1, 42), (3, 220), (7, 30), (19, 200)])
def test_tails_are_those_of_the_f_distribution(q: int, rest: int) -> None:
    share = np.array([0.0, 0.01, 0.1, 0.3, 0.6])
    f = share / q / ((1 - share) / rest)
    assert np.allclose(log_tail(share, q, rest), stats.f.logsf(f, q, rest), rtol=1e-6, atol=1e-12)
    far = log_tail(np.array([1 - 1e-12]), q, 20 * rest)
    assert far < -2000
    assert np.isfinite(far)


@pytest.mark.parametrize("level", [0.03, 1e-4, 1e-8])
@pytest.mark.parametrize(("q", "rest"), [(1, 42), (3, 220)])
def test_the_least_detectable_size_has_its_power(level: float, q: int, rest: int) -> None:
    critical = stats.f.isf(level, q, rest)
    assert np.isclose(stats.ncf.sf(critical, q, rest, noncentrality(level, q, rest)), 0.8, atol=2e-3)


@pytest.mark.parametrize(
    ("sizes", "rank"), [((4.0,), 1), ((1.0, 900.0), 2), ((1.0, 4.0, 100.0), 3), ((0.0, 1.0, 1.0), 2)]
)
def test_a_stated_size_has_its_power_on_average_over_directions(sizes: tuple[float, ...], rank: int) -> None:
    rng = np.random.default_rng(8)
    turn, _ = np.linalg.qr(rng.normal(size=(len(sizes), len(sizes))))
    gram = turn @ np.diag(sizes) @ turn.T
    size = size_found(gram[None], np.array([rank]), 1e-4, 100, 0.8)
    towards = rng.normal(size=(20_000, len(sizes)))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    strength = size**2 * np.einsum("da,ab,db->d", towards, gram, towards)
    critical = stats.f.isf(1e-4, rank, 100 - rank)
    assert np.isclose(stats.ncf.sf(critical, rank, 100 - rank, strength).mean(), 0.8, atol=0.012)


@pytest.mark.parametrize(("name", "keys"), [("tracer-drift", ("vx", "vy", "vz")), ("sphere-form", ("c2", "s2"))])
def test_the_stated_size_of_an_effect_is_that_of_a_random_direction(name: str, keys: tuple[str, ...]) -> None:
    """What is visible of it comes from formulas of its own; the level of a single test is that of the diagnosis."""
    m = lengths.measurement(np.random.default_rng(2), 30)
    one = next(c for c in design(start()).candidates if c.alternative.spot == (name, ("T1",)))
    level = single_level(0.03, field().prices.tests[one.family])
    units = [lengths.signature(name, 1, dict.fromkeys(keys, 0.0) | {key: 1e-6})(m) * 1e6 for key in keys]
    seen = lengths.visible(m, lengths.absorbed_by(m), np.stack(units, axis=1))
    towards = np.random.default_rng(3).normal(size=(5000, len(keys)))
    strength = one.detectable**2 * ((towards / np.linalg.norm(towards, axis=1)[:, None] @ seen.T) ** 2).sum(axis=1)
    rest = field().system.dof - len(keys)
    found = stats.ncf.sf(stats.f.isf(level, len(keys), rest), len(keys), rest, strength)
    assert np.isclose(found.mean(), 0.8, atol=0.02)
    # not that of the mean strength, at which a share of the directions is hardly seen
    assert stats.ncf.sf(stats.f.isf(level, len(keys), rest), len(keys), rest, strength.mean()) > 0.9


def test_levels_of_many_tests() -> None:
    p = np.array([1e-300, 1e-12, 1e-3, 0.2])
    expected = [np.log(1e-300) + np.log(50), *np.log(-np.expm1(50 * np.log1p(-p[1:])))]
    assert np.allclose(log_family(np.log(p), 50.0), expected, rtol=1e-6)
    draws = np.random.default_rng(5).uniform(size=(4000, 37)).min(axis=1)
    assert 30 < effective_number_of_tests(np.log(draws)) < 45


def test_the_interval_of_the_noise() -> None:
    low, high = chi_interval(222.0, 222.0)
    assert np.isclose(low, np.sqrt(222 / stats.chi2.ppf(0.975, 222)))
    assert np.isclose(high, np.sqrt(222 / stats.chi2.ppf(0.025, 222)))


def test_small_systems_with_and_without_full_rank() -> None:
    a = np.array([[[4.0, 0.0], [0.0, 9.0]], [[1.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
    gain, rank = quadratic(a, np.array([[2.0, 3.0], [1.0, 1.0], [0.0, 0.0]]), np.ones((3, 2)))
    assert np.allclose(gain, [2.0, 1.0, 0.0])
    assert rank.tolist() == [2, 1, 0]


def test_held_out_errors_are_of_angles_where_distances_are_read_too() -> None:
    rng = np.random.default_rng(21)
    m, _ = launch.planted(launch.measurement(rng, True), rng, "machine-scale", 30.0)
    gain = diagnose(m.adjusted()).findings[0].gain
    arcsec = np.pi / 648_000
    assert gain.before > 20 * arcsec
    assert 3.5 * arcsec < gain.after < 8 * arcsec  # encoders of 5 arcsec


def test_a_signature_is_the_difference_of_predictions() -> None:
    system = field().system
    for family in families_of(adjusted(), system)[0]:
        full = family.alternatives[-1].signature(system)
        assert np.allclose(np.linalg.norm(full, axis=0), family.raw[-1])
        whole = family.columns.whole([len(family.alternatives) - 1], system.rows)[:, 0]
        assert np.allclose(system.seen(full), system.seen(whole), atol=1e-9 * family.raw[-1].max())


def test_what_a_candidate_explains_is_the_fall_of_the_sum_of_squares() -> None:
    m = field()
    for number, family in enumerate(m.families):
        explained, rank = start().of_family(number)
        for at in {0, len(family.alternatives) - 1, int(np.argmax(explained))}:
            if rank[at] < family.columns.parameters:
                continue  # dependent columns: their rank depends on where the line is drawn
            columns = seen(number, at)
            size = np.linalg.norm(columns, axis=0)
            fit = (columns / size) @ np.linalg.lstsq(columns / size, m.system.residual, rcond=1e-5)[0]
            fall = float(fit @ m.system.residual)
            assert abs(explained[at] - fall) < 1e-4 * max(fall, 1.0), (family.name, at)


def test_what_a_candidate_explains_beside_another_is_that_of_both_together() -> None:
    m = field()
    number = next(i for i, f in enumerate(m.families) if f.name == "dead-path-drift")
    one, other = (m.effect(number, at) for at in range(2))
    first, both = State.of(m, [one]), State.of(m, [one, other])
    explained, rank = first.of_family(number)
    assert np.isclose(explained[1], first.fit.squares - both.fit.squares, rtol=1e-6)
    assert rank[0] == 0


def test_wrong_readings_have_their_studentised_residuals() -> None:
    system = field().system
    redundancy = 1 - system.basis.squares()
    _, rank, explained = start().of_readings()
    good = rank > 0
    assert good.mean() > 0.9
    assert np.allclose(explained[good], (system.residual**2 / redundancy)[good], rtol=1e-8)


def test_without_a_wrong_reading_the_others_explain_what_they_do_in_the_smaller_state() -> None:
    m = field()
    state = State.of(m, [m.reading(3), m.effect(2, 0), m.reading(77)])
    for one in state.readings:
        less, taken = state.beside(one), state.taken_by(one)
        for found, expected in zip(state.of_readings(taken)[1:], less.of_readings()[1:], strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-7)
        for family in range(len(m.families)):
            for found, expected in zip(state.of_family(family, taken), less.of_family(family), strict=True):
                np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(("draws", "most"), [(30, 4), pytest.param(200, 14, marks=pytest.mark.slow)])
def test_in_noise_the_levels_are_what_they_say(draws: int, most: int) -> None:
    """Of many draws of white noise as residuals, few name anything, and about as many as the level allows."""
    m, rng, named = field(), np.random.default_rng(11), 0
    for _ in range(draws):
        noise = m.system.seen(rng.normal(size=m.system.rows))
        state = State.of(replace(m, system=replace(m.system, residual=noise), cache={}))
        found = moves(state)
        named += bool(found and found[0].net > 0 and forward(state).named)
    assert named <= most


@pytest.mark.slow
@pytest.mark.parametrize("noisier", [False, True])
def test_a_noisier_tracer_is_found(noisier: bool) -> None:
    found = []
    for seed in range(6):
        rng = np.random.default_rng([4, seed])
        m = lengths.measurement(rng, 60)
        m = lengths.noisier(m, rng) if noisier else m
        found.append(forward(State.of(measurement_of(m.adjusted()))).measurement.noise)
    # the noise of one is 1.7 times that of the others only, by chance
    assert sum(len(ratios) for ratios in found) == (5 if noisier else 0)
    assert all(2 < ratio < 4.5 for ratios in found for ratio in ratios.values())


def test_of_parameters_that_are_not_seen_apart_as_few_are_held_as_need_be() -> None:
    """Columns a, a + b, b and one of rounding, beside an own one: the one of rounding and one of three are held."""
    rng = np.random.default_rng(14)
    a, b, alone = rng.normal(size=(3, 50))
    left = np.stack([a, 1e4 * (a + b), b, 1e-9 * rng.normal(size=50), 1e-3 * alone], axis=1)
    shown, _ = determined(left.T @ left, np.array([10.0, 1e5, 10.0, 10.0, 1.0]))
    assert shown[[3, 4]].tolist() == [False, True] and shown[:3].sum() == 2
    few = left[:, [0, 2, 4]]
    assert determined(few.T @ few, np.array([10.0, 10.0, 1.0]))[0].all()
    kept = left[:, shown]
    fitted = kept @ np.linalg.lstsq(kept, np.stack([a, a + b, b, alone], axis=1), rcond=None)[0]
    assert fitted == pytest.approx(np.stack([a, a + b, b, alone], axis=1), abs=1e-9), "what is seen is fitted whole"
