"""Monte Carlo: the same bits whoever works, quantiles within the stated error, adaptive runs, resumed runs, memory."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.report_uncertainty.jobs import carry_out

from metrocli.errors import NotConvergedError
from metrocli.expressions.expression import parse
from metrocli.project.running.files import ChunkFolder
from metrocli.uncertainty import monte_carlo
from metrocli.uncertainty.distributions import Normal, Uniform
from metrocli.uncertainty.inputs import InputQuantity, Inputs, join
from metrocli.uncertainty.monte_carlo import MonteCarloResult, tolerance_of
from metrocli.uncertainty.samples import BINS, Binned, Edges, Kept
from metrocli.uncertainty.trials import TrialsPlan, plan_of
from metrocli.uncertainty.workers import Workers

MODELS = {"sum": parse("a + b"), "product": parse("a*b*c")}


def inputs(dof: float = math.inf) -> Inputs:
    return join(
        [
            InputQuantity("a", 1.0, Normal(0.1), dof),
            InputQuantity("b", 2.0, Uniform(0.3)),
            InputQuantity("c", 3.0, Normal(0.2)),
        ],
        [("a", "c", 0.5)],
    )


def same(a: MonteCarloResult, b: MonteCarloResult) -> bool:
    """Whether two outcomes agree in every bit."""
    ends = [[s.symmetric(0.95) + s.shortest(0.95) for s in o.samples] for o in (a, b)]
    return (
        np.array_equal(a.means, b.means)
        and np.array_equal(a.covariance, b.covariance)
        and ends[0] == ends[1]
        and a.trials == b.trials
    )


@pytest.mark.alike
@pytest.mark.parametrize("trials", [12_345, 1_000_000, 2_300_000, None])
def test_the_same_bits_whatever_the_number_of_workers(trials: int | None) -> None:
    plan = plan_of(MODELS, inputs(), 3, 0.95, trials)
    first, *others = [monte_carlo.run(plan, Workers(count), 2, 10_000_000) for count in (1, 2, 5)]
    assert trials is None or first.trials == trials
    assert all(same(first, other) for other in others)
    assert not same(first, monte_carlo.run(plan_of(MODELS, inputs(), 4, 0.95, trials), Workers(1), 2, 10_000_000))


def test_counted_values_give_quantiles_within_the_stated_error() -> None:
    values = np.random.default_rng(0).standard_t(4, size=400_000)
    edges = Edges.around(values[:20_000])
    counts = np.bincount(edges.places(values), minlength=BINS + 2)
    binned, exact = Binned(edges, counts), Kept(values)
    for p in (0.5, 0.95, 0.99):
        for found, true in zip(binned.symmetric(p), exact.symmetric(p), strict=True):
            assert abs(found - true) <= 1.01 * binned.resolution
        low, high = binned.shortest(p)
        assert high - low == pytest.approx(np.diff(exact.shortest(p))[0], abs=3 * binned.resolution)
        assert exact.below(high) - exact.below(low) == pytest.approx(p, abs=2e-4)
    assert binned.below(1.0) == pytest.approx(exact.below(1.0), abs=1e-4)
    assert binned.resolution < 1e-3 * values.std()


def test_the_shortest_interval_of_an_exponential_begins_at_zero() -> None:
    values = Kept(np.random.default_rng(1).standard_exponential(200_000))
    low, high = values.shortest(0.95)
    assert low == pytest.approx(0.0, abs=2e-3)
    assert high == pytest.approx(-math.log(0.05), abs=0.03)


@pytest.mark.parametrize(
    ("std", "digits", "wanted"),
    [
        (32.0, 2, 0.5),
        (0.00035, 1, 0.00005),
        (0.0351, 2, 0.0005),
        (2.0, 2, 0.05),
        (9.99, 2, 0.5),
        (99.6, 2, 5.0),
        (0.0, 2, 0.0),
    ],
)
def test_numerical_tolerance(std: float, digits: int, wanted: float) -> None:
    """JCGM 101, 7.9.2: half of the last of the digits that count."""
    assert tolerance_of(std, digits) == pytest.approx(wanted)


def test_an_adaptive_run_is_as_good_as_it_says() -> None:
    plan = plan_of({"y": parse("a + b")}, inputs(), 0, 0.95, None)
    wanted = tolerance_of(math.hypot(0.1, 0.3 / math.sqrt(3)), 2)
    for digits, most in ((1, 50_000), (2, 2_000_000)):
        outcome = monte_carlo.run(plan, Workers(2), digits, 10_000_000)
        assert outcome.trials <= most
        assert abs(outcome.means[0] - 3.0) < 3 * wanted * 10 ** (2 - digits)
    fixed = monte_carlo.run(plan_of({"y": parse("a + b")}, inputs(), 9, 0.95, 2_000_000), Workers(2))
    ends = zip(outcome.samples[0].symmetric(0.95), fixed.samples[0].symmetric(0.95), strict=True)
    assert all(abs(one - other) < 2 * wanted for one, other in ends)


def test_an_adaptive_run_needs_more_trials_for_rarer_ends() -> None:
    assert plan_of(MODELS, inputs(), 0, 0.95, None).chunk == 10_000
    assert plan_of(MODELS, inputs(), 0, 0.9999, None).chunk == 1_000_000
    assert plan_of(MODELS, inputs(), 0, 0.9999, 5_000_000).chunk == 50_000


def test_digits_are_those_of_the_unit_of_the_measurand() -> None:
    """u = 0.1 of one unit and 0.9 of another: half of the last of two digits is 1/20 of the one, 1/180 of the other."""
    one, other = (
        monte_carlo.run(
            plan_of({"y": parse("a")}, join([InputQuantity("a", 0.0, Normal(0.1))]), 0, 0.95, None, {"y": unit}),
            Workers(2), 2, 10_000_000,
        )
        for unit in (1.0, 1 / 9)
    )  # fmt: skip
    assert other.trials > 20 * one.trials


@pytest.mark.parametrize("coverage", [{"k": 10}, {"k": 8}, {"probability": 0.9999999}])
def test_an_adaptive_run_for_too_rare_ends_is_refused(
    coverage: dict[str, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = {"quantities": {"a": {"value": 1, "std": 1}}, "measurands": {"y": {"model": "a"}}, "coverage": coverage}
    ran = carry_out(tmp_path, {**job, "monte_carlo": {"trials": "adaptive"}})
    assert ran.code == 5
    assert "fix the number of trials" in capsys.readouterr().err
    assert carry_out(tmp_path, {**job, "monte_carlo": {"trials": 10_000}}).code == 0


def test_an_adaptive_run_does_not_claim_what_it_has_not_reached() -> None:
    plan = plan_of({"y": parse("a")}, join([InputQuantity("a", 0.0, Normal(1.0), 2.2)]), 0, 0.95, None)
    with pytest.raises(NotConvergedError, match="less well than 3 digits"):
        monte_carlo.run(plan, Workers(2), 3, 400_000)


def test_an_adaptive_run_goes_on_beyond_the_kept_values(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of({"y": parse("a")}, join([InputQuantity("a", 0.0, Normal(0.9))]), 0, 0.95, None)
    whole = monte_carlo.run(plan, Workers(1), 2, 10_000_000)
    monkeypatch.setattr(monte_carlo, "KEPT", 60_000)
    counted = monte_carlo.run(plan, Workers(2), 2, 10_000_000)
    assert counted.trials >= whole.trials > 60_000
    for one, other in zip(counted.samples[0].symmetric(0.95), whole.samples[0].symmetric(0.95), strict=True):
        assert one == pytest.approx(other, abs=2 * tolerance_of(0.9, 2))


class Killed(Exception):
    """A run that ends in the middle."""


def test_a_killed_run_goes_on_from_its_finished_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of(MODELS, inputs(), 3, 0.95, 4_500_000)
    whole = monte_carlo.run(plan, Workers(2))

    def die(done: int, of: int | None) -> None:
        if done == 2:
            raise Killed

    folder = ChunkFolder(tmp_path / "job.chunks")
    with pytest.raises(Killed):
        monte_carlo.run(plan, Workers(2, finished=folder, tell=die))
    for extra in sorted(folder.folder.glob("*.npz"))[2:]:
        extra.unlink()
    done: list[int] = []
    outcomes = TrialsPlan.outcomes

    def counted(plan: TrialsPlan, number: int) -> np.ndarray:
        done.append(number)
        return outcomes(plan, number)

    monkeypatch.setattr(TrialsPlan, "outcomes", counted)
    resumed = monte_carlo.run(plan, Workers(2, finished=folder))
    assert same(whole, resumed)
    assert set(done) == {0, 1, *range(40, 90)}
    assert not folder.folder.exists()


def test_chunks_of_another_job_or_damaged_ones_are_not_taken(tmp_path: Path) -> None:
    folder = ChunkFolder(tmp_path / "job.chunks")
    for seed in (1, 2):
        plan = plan_of(MODELS, inputs(), seed, 0.95, 2_300_000)
        with pytest.raises(Killed):
            monte_carlo.run(plan, Workers(1, finished=folder, tell=_die))
    kept = sorted(folder.folder.glob("*.npz"))
    assert len(kept) == 2
    kept[0].write_bytes(kept[0].read_bytes()[:100])
    for seed in (1, 2):
        plan = plan_of(MODELS, inputs(), seed, 0.95, 2_300_000)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(ChunkFolder, "clear", lambda self: None)
            found = monte_carlo.run(plan, Workers(1, finished=folder))
        assert same(found, monte_carlo.run(plan, Workers(1)))


def _die(done: int, of: int | None) -> None:
    raise Killed


def test_the_command_removes_its_chunks(tmp_path: Path) -> None:
    job = {
        "quantities": {"a": {"value": 1, "std": 0.1}},
        "measurands": {"y": {"model": "a"}},
        "monte_carlo": {"trials": 2_100_000},
    }
    ran = carry_out(tmp_path, job)
    assert ran.code == 0
    assert ran.details("y")["mc"]["resolution"] < 1e-4
    assert {path.name for path in tmp_path.iterdir()} == {"job.yaml", "job.h5"}


def test_trials_without_a_value_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job: dict[str, Any] = {"quantities": {"a": {"value": 1, "std": 0.5}}, "measurands": {"y": {"model": "log(a)"}}}
    ran = carry_out(tmp_path, job)
    assert ran.code == 4
    assert "trials of 'log(a)' have no value" in capsys.readouterr().err
    assert not ran.path.exists()


@pytest.mark.slow
def test_ten_million_trials_in_bounded_memory(tmp_path: Path) -> None:
    code = (
        "import re, sys\nfrom metrocli.cli.commands import run\n"
        f"assert run(['report-uncertainty', {str(tmp_path / 'job.yaml')!r}, '--quiet', '--workers', '2']) == 0\n"
        "assert 'scipy.stats' not in sys.modules\n"
        # the peak of this program alone: ru_maxrss begins at what the process that started it had
        "print(int(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1]) / 1024)\n"
    )
    from tasks.report_uncertainty.jobs import write

    write(tmp_path, {
        "quantities": {"a": {"value": 1, "std": 0.1}, "b": {"value": 2, "half_width": 0.3}},
        "measurands": {"y": {"model": "a*b"}}, "monte_carlo": {"trials": 10_000_000},
    })  # fmt: skip
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(ran.stdout) < 300


def test_many_measurands_are_counted_sooner() -> None:
    models = {f"y{n}": parse(f"a + {n}*b*c") for n in range(20)}
    outcome = monte_carlo.run(plan_of(models, inputs(), 1, 0.95, 500_000), Workers(2))
    assert all(isinstance(sample, Binned) for sample in outcome.samples)
    assert outcome.covariance.shape == (20, 20)
    few = monte_carlo.run(plan_of({"y3": models["y3"]}, inputs(), 1, 0.95, 500_000), Workers(2))
    assert isinstance(few.samples[0], Kept)
    for one, other in zip(outcome.samples[3].symmetric(0.95), few.samples[0].symmetric(0.95), strict=True):
        assert abs(one - other) <= outcome.samples[3].resolution
