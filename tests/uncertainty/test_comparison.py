"""Two results held against each other: figures by hand, a result with itself, and p-values that are uniform."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc
from simulated import machine as sim
from simulated import machine_lengths as lengths

from metrocli.errors import InputError
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.uncertainty.comparison import compare


def result(values: dict[str, float], covariance: list[list[float]], **more: object) -> Result:
    std = np.sqrt(np.diag(covariance))
    estimates = tuple(Estimate(name, value, s, "mm") for (name, value), s in zip(values.items(), std, strict=True))
    return Result("multilaterate", "", estimates, np.array(covariance), {}, **more)  # type: ignore[arg-type]


def test_figures_by_hand() -> None:
    first = result({"a": 1.0, "b": 2.0}, [[0.04, 0.0], [0.0, 0.09]])
    second = result({"b": 2.9, "a": 1.3}, [[0.16, 0.06], [0.06, 0.05]])
    found = compare(first, second)
    by_name = {one.name: one for one in found.compared}
    assert by_name["a"].difference == pytest.approx(0.3)
    assert by_name["a"].std == pytest.approx(0.3)
    assert by_name["b"].en == pytest.approx(0.9 / (2 * 0.5))
    d, q = np.array([0.3, 0.9]), np.array([[0.09, 0.06], [0.06, 0.25]])
    assert found.chi2 == pytest.approx(d @ np.linalg.solve(q, d))
    assert found.dof == 2
    assert found.p_value == pytest.approx(np.exp(-found.chi2 / 2))
    assert found.max_en == pytest.approx(0.9)


def test_points_are_compared_by_name_and_what_only_one_has_is_listed() -> None:
    def points(names: list[str], x: list[float]) -> Table:
        n = len(x)
        columns = {"point": np.array(names), "x": np.array(x), "y": np.zeros(n), "z": np.zeros(n)}
        return Table(columns | {s: np.full(n, 3e-4) for s in ("sx", "sy", "sz")}, {"x": "mm"})

    first = result({"a": 1.0, "c": 0.0}, [[1.0, 0.0], [0.0, 1.0]], tables={"points": points(["P1", "P2"], [0.0, 5.0])})
    second = result({"a": 1.0}, [[1.0]], tables={"points": points(["P3", "P2"], [9.0, 5.001])})
    found = compare(first, second)
    x = next(one for one in found.compared if one.name == "P2.x")
    assert (x.difference, x.std) == (pytest.approx(1e-3), pytest.approx(3e-4 * 2**0.5))
    assert "P1.x" not in {one.name for one in found.compared}
    assert found.only_in_one == ("estimates c", "points P1", "points P3")


def test_results_that_have_nothing_in_common_are_refused() -> None:
    first = result({"a": 1.0}, [[1.0]])
    with pytest.raises(InputError, match="two kinds cannot be compared: multilaterate and align-part"):
        compare(first, replace(first, kind="align-part"))
    with pytest.raises(InputError, match="nothing in common"):
        compare(first, result({"b": 1.0}, [[1.0]]))


def calibrated(machine: sim.Machine, seed: int, tools: dict[str, tuple[float, float, float]] | None = None) -> Result:
    rng = np.random.default_rng(seed)
    table = lengths.measured(machine, rng, 50, tools or sim.THREE)
    settings = lengths.settings(tools or sim.THREE, (3, 3, 3))
    return calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=table))


def test_calibrations_of_one_machine_differ_by_their_uncertainty_and_a_changed_machine_is_found() -> None:
    machine = sim.random_machine(np.random.default_rng(60), knots=(3, 3, 3))
    results = [calibrated(machine, 600 + i) for i in range(4)]
    itself = compare(results[0], results[0])
    assert (itself.chi2, itself.max_en) == (0.0, 0.0)
    found = [compare(results[i], results[i + 1]) for i in range(0, 4, 2)]
    dof = sum(one.dof for one in found)
    # three squareness errors; of three knots one is free in straightness, two in all others
    assert dof == 2 * (3 + 6 * 1 + 12 * 2)
    assert abs(sum(one.chi2 for one in found) - dof) < 3.5 * np.sqrt(2 * dof)
    moved = replace(machine, tables={**machine.tables, "EXX": machine.tables["EXX"] + [0.0, 0.002, 0.0]})
    changed = compare(results[0], calibrated(moved, 700))
    assert changed.p_value < 1e-6
    worst = max(changed.compared, key=lambda one: one.en)
    assert (worst.group, worst.name) == ("EXX", "300 mm")
    assert worst.difference == pytest.approx(0.002, abs=4 * worst.std)


def test_squareness_that_holds_for_one_tool_is_not_compared_with_squareness_alone() -> None:
    """With one tool A0Z has what EAZ turns that tool by: the difference was 6.6 times its expanded uncertainty."""
    machine = sim.random_machine(np.random.default_rng(60), knots=(3, 3, 3))
    whole, alone, again = calibrated(machine, 600), calibrated(machine, 601, sim.ONE), calibrated(machine, 602, sim.ONE)
    found = compare(whole, alone)
    assert found.max_en < 2 and found.p_value > 1e-3
    assert {"C0Y"} == {one.name for one in found.compared if one.group == "estimates" and one.name.endswith("0Y")}
    assert any(name.startswith("estimates A0Z with EYZ") for name in found.only_in_one)
    both = compare(alone, again)
    assert any(
        one.name.startswith("A0Z with EYZ") and one.name.endswith("of the tool (0, 0, 120) mm") for one in both.compared
    )
    assert both.p_value > 1e-3


def test_a_result_is_no_different_from_itself() -> None:
    one = result({"a": 1.0, "b": 2.0}, [[0.04, 0.01], [0.01, 0.09]])
    found = compare(one, one)
    assert [part.difference for part in found.compared] == [0.0, 0.0]
    assert (found.max_en, found.chi2, found.p_value) == (0.0, 0.0, 1.0)


def drawn(rng: np.random.Generator, truth: np.ndarray, root: np.ndarray, dof: int) -> Result:  # type: ignore[type-arg]
    """A result with three estimates whose noise is estimated from `dof` residuals."""
    factor = rng.chisquare(dof) / dof
    values = truth + root @ rng.normal(size=3)
    found = result(dict(zip("abc", values.tolist(), strict=True)), (factor * root @ root.T).tolist())
    return replace(found, statistics={"noise_estimated": True, "dof": dof})


def test_few_degrees_of_freedom_leave_p_uniform_and_e_n_below_one() -> None:
    """600 pairs with 8 degrees of freedom each; as chi-square, significantly more than 10 % are below 0.1."""
    rng = np.random.default_rng(6)
    root = np.array([[2.0, 0, 0], [1.0, 1.5, 0], [-0.5, 0.7, 1.0]])
    pairs = [compare(*(drawn(rng, np.array([1.0, 5, 9]), root, 8) for _ in range(2))) for _ in range(600)]
    p = np.sort([pair.p_value for pair in pairs])
    steps = np.arange(1, 601) / 600
    assert max(np.abs(steps - p).max(), np.abs(p - steps + 1 / 600).max()) < 1.63 / np.sqrt(600)
    assert np.mean([chdtrc(3, pair.chi2) < 0.1 for pair in pairs]) > 0.1 + 3 * np.sqrt(0.09 / 600)
    # U of both added in squares covers somewhat more than 95.45 %
    inside = np.mean([one.en <= 1 for pair in pairs for one in pair.compared])
    assert 0.95 < inside < 0.98
    # t(95.45 %) of 8 degrees of freedom: 2.37 (GUM table G.2)
    one = drawn(rng, np.zeros(3), root, 8)
    found = compare(one, replace(one, estimates=tuple(replace(e, value=e.value + 1) for e in one.estimates)))
    assert found.compared[0].expanded / found.compared[0].std == pytest.approx(2.37, abs=0.005)


def test_an_input_of_both_counts_once() -> None:
    """`x = F s + own`, with the same s in both results: the difference has the covariance of a direct computation."""
    rng = np.random.default_rng(71)
    factors = rng.normal(size=(2, 3, 2))
    own = [np.diag(rng.uniform(0.1, 1.0, 3)) for _ in factors]
    values = rng.normal(size=(2, 3))

    def result(i: int, digest: str) -> Result:
        covariance = own[i] + factors[i] @ factors[i].T
        std = np.sqrt(np.diag(covariance))
        listed = tuple(Estimate(n, float(v), float(s), "mm") for n, v, s in zip("abc", values[i], std, strict=True))
        shared = Table({"input": np.array(["camera"]), "digest": np.array([digest])})
        return Result("align-part", "", listed, covariance, {}, {"shared": shared}, {"owed_to_camera": factors[i]})

    found = compare(result(0, "11"), result(1, "11"))
    apart = factors[1] - factors[0]
    covariance = own[0] + own[1] + apart @ apart.T
    difference = values[1] - values[0]
    assert found.counted_once == ("camera",)
    assert [one.std for one in found.compared] == pytest.approx(np.sqrt(np.diag(covariance)))
    assert [one.en for one in found.compared] == pytest.approx(np.abs(difference) / np.sqrt(np.diag(covariance)) / 2)
    assert found.chi2 == pytest.approx(difference @ np.linalg.solve(covariance, difference))
    other = compare(result(0, "11"), result(1, "22"))
    both = own[0] + own[1] + factors[0] @ factors[0].T + factors[1] @ factors[1].T
    assert other.counted_once == ()
    assert other.chi2 == pytest.approx(difference @ np.linalg.solve(both, difference))
