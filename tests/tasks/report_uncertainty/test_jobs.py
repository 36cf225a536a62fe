"""Jobs of report-uncertainty: what is refused, where and with what advice; what the result holds."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.report_uncertainty.jobs import carry_out, write

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: report-uncertainty
quantities:
  ls: {value: 50.000623 mm, std: 25 nm, dof: 18}
  alpha: {mean: 11.5e-6 1/K, half_width: 2e-6 1/K, distribution: uniform}
  theta: {value: -0.1 K, std: 0.4 K}
measurands:
  l: {model: "ls*(1 + alpha*theta)", unit: mm}
coverage: {probability: 0.95}
monte_carlo: {trials: 10000, seed: 1}
"""
CORRELATED = "correlations: [{between: [ls, alpha], value: 0.9}, {between: [ls, theta], value: 0.9}, {between: [alpha, theta], value: -0.9}]\ncoverage"
BAD = [
    ("0.95}", "95}", 9, 25, "95 is not a probability", "write 0.95"), ("dof: 18", "dof: 0", 4, 46, "0 is out of range", "at least 0.5"), ("std: 25 nm", "std: -25 nm", 4, 34, "std is negative", "0 or more"),
    ("std: 25 nm", "std: 25", 4, 34, "std is a plain number, the value a length", "write it in mm"), ("std: 25 nm", "std: 25 K", 4, 34, "temperature difference", "mm"),
    ("alpha*theta)", "alpha*theta) + theta", 8, 38, "'theta' is a temperature difference", "same unit"), ("alpha*theta", "alhpa*theta", 8, 23, "no quantity 'alhpa'", "did you mean 'alpha'?"),
    ("unit: mm", "unit: K", 8, 44, "the model gives a length", "'mm'"), (", unit: mm", "", 8, 14, "the model gives a length", "'mm'"), ("  theta:", "  sin:", 6, 8, "'sin' is reserved", "sin_"),
    ("  theta:", "  pi:", 6, 7, "'pi' is reserved", "pi1"), ("  theta:", "  lambda:", 6, 11, "'lambda' is reserved", "lambda_"), ("  theta:", "  the-ta:", 6, 11, "cannot be the name", "letters"),
    ("measurands", "  extra: 5 mm\nmeasurands", 7, 10, "the quantity 'extra' is in no model", "leave the quantity out"), ("trials: 10000", "trials: ten", 10, 23, "not a number of trials", "adaptive"),
    ("alpha*theta", "part.x*theta", 8, 23, "there is no result 'part'", "inputs"), ("coverage", CORRELATED, 9, 16, "contradict each other: r(ls, alpha) = 0.9, r(ls, theta) = 0.9, r(alpha, theta) = -0.9", "wrong sign"),
    ("coverage", "correlations: [{between: [ls, alfa], value: 0.9}]\ncoverage", 9, 26, "'alfa'", "did you mean 'alpha'?"), ("coverage", "correlations: [{between: [ls, alpha], value: 1.9}]\ncoverage", 9, 46, "out of range", "at most 1"),
    ("half_width: 2e-6 1/K", "std: 2e-6 1/K, half_width: 2e-6 1/K", 5, 57, "std and half_width are both given", "one uncertainty only"), ("uniform", "unifrom", 5, 66, "unifrom", "did you mean 'uniform'?"),
    ("uniform", "normal", 5, 42, "has no half-width", "give std"), ("uniform", "trapezoidal", 5, 66, "needs beta", "0 to 1"), ("uniform", "curvilinear-trapezoid", 5, 66, "needs half_width and inexactness", "both"),
    ("uniform", "curvilinear-trapezoid, inexactness: 3e-6 1/K", 5, 102, "larger than the half-width", "at most"), ("dof: 18", "distribution: t", 4, 55, "needs its degrees of freedom", "dof"),
    ("std: 25 nm", "U: 50 nm", 4, 32, "U needs its k", "k: 2"), ("std: 25 nm, dof: 18", "dof: 18", 4, 7, "there is no uncertainty", "std"), ("value: 50.000623 mm, std: 25 nm, dof: 18", "readings: no.csv", 4, 18, "no such file", ""),
    ("ls*(1 + alpha*theta)", "ls*(1 + alpha*theta", 8, 18, "bracket is not closed", "')'"), ("ls*(1 + alpha*theta)", "ls*log(alpha*theta/(alpha*theta) - 1)", 8, 18, "has no value at the best estimates", "division"),
    ("ls*(1 + alpha*theta)", "ls*(1 + alpha*theta)*9**9**9", 8, 36, "no finite value", "1e308"), ("ls*(1 + alpha*theta)", "open(ls)", 8, 15, "unknown function 'open'", "sqrt"), ("ls*(1 + alpha*theta)", "ls.real", 8, 15, "no result 'ls'", ""),
    ("coverage", "tolerance: {m: [1 mm, 2 mm]}\ncoverage", 9, 16, "'m', which is not a measurand", "l"), ("coverage", "tolerance: {l: [2 mm, 1 mm]}\ncoverage", 9, 23, "not above", "[lower, upper]"),
    ("coverage", "tolerance: {l: [1 K, 1 mm]}\ncoverage", 9, 17, "temperature difference", "mm"), ("coverage", "tolerance: 2 mm\ncoverage", 9, 12, "tolerance of a volume", "{NAME"), ("coverage", "tolerance: {l: [none, none]}\ncoverage", 9, 16, "both limits are missing", ""),
    ("std: 25 nm", "U: 50 nm, k: 1e-9", 4, 42, "1e-9 is out of range", "at least 0.5 and at most 100"), ("0.95}", "0.05}", 9, 25, "0.05 is not a probability between 0.5 and 1", "write 0.95"), ("probability: 0.95", "k: 0.1", 9, 15, "0.1 is out of range", "at least 0.5"),
    ("theta: {value: -0.1 K, std: 0.4 K", "theta: {value: 0 K, std: 4 %", 6, 28, "'4 %' of a value of 0", "in K"), ("theta: {value: -0.1 K, std: 0.4 K", "theta: {value: 20 degC, std: 4 %", 6, 32, "temperature in degC", "in K"), ("std: 25 nm", "std: -1 %", 4, 34, "std is negative", "0 or more"),
    ("theta: {value: -0.1 K, std: 0.4 K", "theta: {value: 0.2, std: 4 %", 6, 28, "'4 %' is ambiguous", "write 0.008 for a share of the value, 0.04 for a difference"),
    ("coverage", "target: {m: 1 nm}\ncoverage", 9, 13, "'m', which is not a measurand", "l"), ("coverage", "target: {l: 1 K}\ncoverage", 9, 13, "the target is a temperature difference", "mm"), ("coverage", "target: {l: 0 um}\ncoverage", 9, 13, "not above zero", "U"),
    ("value: 50.000623 mm", "value: 50,000623 mm", 4, 18, "unknown key '000623 mm'", "comma"), ("value: 50.000623 mm", "value: '50,000623 mm'", 4, 15, "decimal comma", "50.000623 mm"), ("0.95}", "0.95, k: 2}", 9, 34, "both given", "one of them"),
    ("unit: mm", "unit: furlong", 8, 44, "unknown unit 'furlong'", ""), ("-0.1 K, std: 0.4 K", "20 degC, std: 0.4 K", 8, 29, "differences of such temperatures", "20 degC"), ("-0.1 K", "-0.1 Kelvin", 6, 18, "unknown unit 'Kelvin'", ""),
    ("quantities:", "volume: {from: [0 mm, 0 mm, 0 mm], to: [1 mm, 1 mm, 1 mm]}\nquantities:", 1, 1, "'contributors' is missing", "volume"), ("seed: 1", "seed: -1", 10, 36, "out of range", "0"), ("seed", "sed", 10, 30, "unknown key 'sed'", "seed"),
    ("std: 25 nm", "std: 1e-300 nm", 4, 34, "out of range", "1e100"), ("50.000623 mm", "1e300 mm", 4, 15, "out of range", "1e100"), ("alpha*theta)", "1e160*alpha*theta)", 8, 15, "too large for a number", "1e150"),
    ("  theta: {value: -0.1 K, std: 0.4 K}", "  theta: {value: 3.5 K, distribution: counts}", 6, 10, "a count is a whole number", "25"), ("-0.1 K, std: 0.4 K", "-0.1 K, distribution: exponential", 6, 10, "above zero", ""),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line", "column", "message", "hint"), BAD, ids=lambda value: str(value)[:24])
def test_faults_have_place_reason_and_advice(
    old: str, new: str, line: int, column: int, message: str, hint: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    path = tmp_path / "bad.yaml"
    assert old in JOB
    path.write_text(JOB.replace(old, new, 1))
    ran = metrocli("report-uncertainty", path, "--output", tmp_path / "bad.h5")
    assert ran.code == 3
    place = f"bad.yaml:{line}:{column}: error:"
    assert place in ran.err
    told = ran.err[ran.err.index(place) :]
    assert message in told and hint in told
    assert "defect" not in ran.err
    assert not (tmp_path / "bad.h5").exists()
    assert metrocli("check", path).code == 3


def test_the_job_without_faults_has_none(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "good.yaml").write_text(JOB)
    assert metrocli("check", tmp_path / "good.yaml").code == 0
    assert metrocli("report-uncertainty", tmp_path / "good.yaml", "--dry-run").code == 0
    assert not (tmp_path / "results").exists()


def test_the_summary_is_laid_out_as_promised(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "job.yaml").write_text(
        JOB
        + 'tolerance: {l: [49.999 mm, 50.001 mm]}\nrequire: {l.U: "< 1 um", l.std: "< 300 nm", l.tolerance.U_over_T: "< 25 percent", l.k: "< 3"}\n'
    )
    ran = metrocli("report-uncertainty", tmp_path / "job.yaml", "--json")
    assert ran.code == 0
    summary = json.loads(ran.out)
    shown = json.loads(metrocli("show", tmp_path / "results" / "job.h5", "--json").out)
    assert shown == summary
    found = summary["estimates"]["l"]
    assert {"value", "std", "unit", "U", "k", "dof", "interval", "second_order", "mc", "gum_valid"} <= set(found)
    assert set(found["mc"]) == {"mean", "std", "interval", "shortest", "trials", "covered"}
    assert set(found["second_order"]) == {"value", "std"}
    assert found["unit"] == "mm"
    assert found["interval"] == pytest.approx([found["value"] - found["U"], found["value"] + found["U"]])
    assert all(verdict["met"] for verdict in summary["requirements"])


def test_the_budget_is_a_table(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "job.yaml").write_text(JOB)
    assert metrocli("report-uncertainty", tmp_path / "job.yaml").code == 0
    budget = hdf5.read(tmp_path / "results" / "job.h5")[0].tables["budget"]
    assert {"measurand", "contributor", "value", "std", "sensitivity", "contribution", "dof"} <= set(budget)
    assert sorted(budget.texts("contributor")) == ["alpha", "ls", "theta"]
    row = budget.texts("contributor").index("theta")
    assert budget.numbers("std")[row] == pytest.approx(0.4)
    assert budget.numbers("sensitivity")[row] == pytest.approx(50.000623 * 11.5e-6)
    assert budget.numbers("contribution")[row] == pytest.approx(50.000623 * 11.5e-6 * 0.4)
    assert budget.numbers("share").sum() == pytest.approx(100)
    assert metrocli("export", tmp_path / "results" / "job.h5", "--to", "csv").code == 0
    assert (tmp_path / "results" / "job.budget.csv").read_text().startswith("measurand,contributor,value,std")


def test_a_requirement_missed_is_told_with_its_unit(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "job.yaml").write_text(JOB.replace("unit: mm", "unit: nm") + 'require: {l.U: "< 0.1 um"}\n')
    ran = metrocli("report-uncertainty", tmp_path / "job.yaml")
    assert ran.code == 6
    assert "NOT met" in ran.out
    assert "nm)" in ran.out


@pytest.mark.parametrize("command", ["simulate", "plan"])
def test_there_is_nothing_to_simulate_or_plan(command: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "job.yaml").write_text(JOB)
    ran = metrocli(command, tmp_path / "job.yaml", "--out", tmp_path / "out")
    assert ran.code == 2
    assert "report-uncertainty jobs cannot be" in ran.err


def test_values_are_shown_in_the_unit_of_the_measurand(tmp_path: Path, metrocli: Metrocli) -> None:
    text = JOB.replace("unit: mm", "unit: nm") + "tolerance: {l: [49.999 mm, 50.001 mm]}\n"
    (tmp_path / "job.yaml").write_text(text)
    shown = metrocli("report-uncertainty", tmp_path / "job.yaml").out
    assert re.search(r"^l +50000570 +± 230 +nm$", shown, re.MULTILINE), shown
    assert "in the guard band (50000565.5 nm)" in shown


def test_a_width_in_percent_is_a_share_of_the_value(tmp_path: Path) -> None:
    quantities = {
        "a": {"value": "-20 mm", "std": "0.5 %"}, "b": {"value": "20 mrad", "half_width": "3 %", "distribution": "uniform"},
        "c": {"value": "5 V", "U": "100 ppm", "k": 2}, "d": {"value": "50 %", "std": "2 %"},
    }  # fmt: skip
    job = {
        "quantities": quantities,
        "measurands": {"y": {"model": "a*b*d*c", "unit": "mm V"}},
        "monte_carlo": {"trials": 0},
    }
    table = carry_out(tmp_path, job).result.tables["budget"]
    stds = dict(zip(table.texts("contributor"), table.numbers("std").tolist(), strict=True))
    assert stds == pytest.approx({"a": 0.1, "b": 0.6 / math.sqrt(3), "c": 0.25e-3, "d": 2.0})


REVERSE: dict[str, Any] = {
    "a": {"value": 10, "std": 3.0, "dof": 4}, "b": {"value": 5, "std": 2.0, "dof": 12}, "c": {"value": 1, "std": 1.0},
    "d": {"value": 1, "std": 0.2},
}  # fmt: skip


@pytest.mark.alike
@pytest.mark.parametrize(
    "correlations", [[], [{"between": ["b", "c"], "value": 0.6}]], ids=["independent", "correlated"]
)
@pytest.mark.parametrize("coverage", [{"probability": 0.95}, {"k": 2}], ids=["probability", "k"])
def test_with_the_needed_std_the_job_reaches_its_target(
    coverage: dict[str, float], correlations: list[Any], tmp_path: Path
) -> None:
    job: dict[str, Any] = {
        "quantities": REVERSE, "measurands": {"y": {"model": "a + b - 2*c + d"}}, "coverage": coverage,
        "correlations": correlations, "monte_carlo": {"trials": 0}, "target": {"y": 6.5},
    }  # fmt: skip
    ran = carry_out(tmp_path, job)
    before, table = ran.details("y"), ran.result.tables["reverse_budget"]
    assert before["target"] == {"U": 6.5, "reached": False, "factor": pytest.approx(6.5 / before["U"])}
    needed = dict(zip(table.texts("contributor"), table.numbers("needed_std").tolist(), strict=True))
    for name, std in needed.items():
        U = [
            carry_out(tmp_path, {**job, "quantities": {**REVERSE, name: {**REVERSE[name], "std": of}}}).details("y")[
                "U"
            ]
            for of in ((0.0, 0.0) if math.isnan(std) else (std, 1.001 * std))
        ]
        assert U[1] > 6.5
        assert U[0] <= 6.5 * (1 + 1e-9) or math.isnan(std)
    assert math.isnan(needed["d"]) and math.isfinite(needed["a"])
    assert any("cannot be reached by this input alone" in line for line in ran.result.notes)
    shrunk = {name: {**each, "std": each["std"] * before["target"]["factor"]} for name, each in REVERSE.items()}
    assert carry_out(tmp_path, {**job, "quantities": shrunk}).details("y")["U"] == pytest.approx(6.5)


def test_the_trials_are_a_histogram(tmp_path: Path) -> None:
    job = {
        "quantities": {"x": {"value": "3 mm", "half_width": "1 um"}},
        "measurands": {"y": {"model": "x", "unit": "um"}},
    }
    ran = carry_out(tmp_path, {**job, "monte_carlo": {"trials": 100_000}})
    table = ran.result.tables["trials"]
    from_, to, share = (table.numbers(name) for name in ("from", "to", "share"))
    np.testing.assert_allclose(from_[1:], to[:-1])
    assert 99.7 < share.sum() <= 100 + 1e-9
    inside = (from_ > 2999.01) & (to < 3000.99)
    # of a uniform distribution all bins inside have the share of their width
    np.testing.assert_allclose(share[inside], 100 * (to - from_)[inside] / 2, rtol=0.2)


UNITS_OF_ONE_JOB = [
    ({"v": {"value": "4.999 V", "std": "3.2 mV"}, "i": {"value": "19.661 mA", "std": "9.5 uA"}}, "v/i", "ohm", 254.26),
    ({"m": {"value": "2 kg", "std": "1 g"}, "l": {"value": "100 mm", "std": "1 um"}}, "m/l**3", "kg/m^3", 2000.0),
    ({"t": {"value": "25.3 degC", "std": "0.1 K"}, "t0": "20 degC", "l": {"value": "1 m", "std": "0 um"}, "a": {"value": "11.5 um/m/K", "std": "1e-6 1/K"}}, "l*a*(t - t0)", "um", 60.95),
    ({"a": {"value": "90 deg", "std": "1 arcsec"}, "r": "100 mm"}, "r*sin(a/3)", "mm", 50.0), ({"f": {"value": "50 Hz", "std": "1 mHz"}}, "1/f", "ms", 20.0),
    ({"p": {"value": "101325 Pa", "std": "1 hPa"}}, "p", "kPa", 101.325), ({"x": {"value": "3 mm", "std": "1 um"}, "y": {"value": "3 mm", "std": "1 um"}}, "atan2(x, y)", "deg", 45.0),
    ({"t": {"value": "20 degC", "std": "0.3 K"}, "d": {"value": "0.5 K", "std": "0.1 K"}}, "t + d", "degC", 20.5), ({"n": {"value": "2 %", "std": 0.001}}, "n", "percent", 2.0),
]  # fmt: skip


@pytest.mark.parametrize(("quantities", "model", "unit", "value"), UNITS_OF_ONE_JOB)
def test_units_go_in_and_out(quantities: dict[str, Any], model: str, unit: str, value: float, tmp_path: Path) -> None:
    ran = carry_out(
        tmp_path,
        {
            "quantities": quantities,
            "measurands": {"y": {"model": model, "unit": unit}},
            "monte_carlo": {"trials": 10000},
        },
    )
    assert ran.code == 0
    found = ran.details("y")
    assert found["value"] == pytest.approx(value, rel=1e-4)
    assert found["mc"]["mean"] == pytest.approx(value, abs=5 * found["mc"]["std"] / 100)
    assert found["unit"] == unit


GIVEN = [
    ({"value": 3, "U": 0.6, "k": 2}, 3, 0.3, None), ({"value": 3, "U": 0.6, "k": 3, "dof": 9}, 3, 0.2, 9), ({"value": 3, "std": 1, "distribution": "uniform"}, 3, 1, None),
    ({"value": 3, "std": 1, "dof": "inf"}, 3, 1, None), ({"value": 3, "std": 1, "dof": math.inf, "distribution": "t"}, 3, 1, None),
    ({"value": 3, "half_width": 1, "distribution": "rectangular"}, 3, 1 / math.sqrt(3), None), ({"value": 3, "half_width": 1, "distribution": "U"}, 3, 1 / math.sqrt(2), None),
    ({"value": 3, "half_width": 1, "distribution": "trapezoidal", "beta": 0.5}, 3, math.sqrt(1.25 / 6), None), ({"value": 3, "std": 1, "distribution": "triangular"}, 3, 1, None),
    ({"value": 3, "distribution": "exponential"}, 3, 3, None), ({"value": 3, "distribution": "counts"}, 4, 2, None), ({"value": 3, "half_width": 1, "dof": 8}, 3, 1 / math.sqrt(3), 8),
    ({"value": 3, "std": 0.5, "dof": 4, "distribution": "t"}, 3, 0.5, 4), ({"value": 3, "half_width": 1, "inexactness": 0.3}, 3, math.sqrt(1 / 3 + 0.01), None),
]  # fmt: skip


@pytest.mark.parametrize(("given", "value", "std", "dof"), GIVEN, ids=lambda v: str(v)[:40])
def test_ways_to_say_how_well_a_quantity_is_known(
    given: dict[str, Any], value: float, std: float, dof: float | None, tmp_path: Path
) -> None:
    ran = carry_out(
        tmp_path, {"quantities": {"x": given}, "measurands": {"y": {"model": "x"}}, "monte_carlo": {"trials": 100000}}
    )
    found = ran.details("y")
    assert (found["value"], found["std"]) == pytest.approx((value, std))
    assert found["dof"] == (math.inf if dof is None else pytest.approx(dof))
    assert found["mc"]["mean"] == pytest.approx(value, abs=0.05)


def test_a_count_has_the_interval_of_its_gamma_distribution(tmp_path: Path) -> None:
    """25 events: the 95 % interval of gamma(26) is that of chi-squared with 52 degrees of freedom, halved (tables)."""
    job = {"quantities": {"n": {"value": 25, "distribution": "counts"}}, "measurands": {"m": {"model": "n"}}}
    found = carry_out(tmp_path, job).details("m")
    assert (found["value"], found["std"]) == pytest.approx((26.0, math.sqrt(26.0)))
    assert found["mc"]["interval"] == pytest.approx([33.968 / 2, 73.810 / 2], abs=0.05)


def test_a_correlation_is_never_dropped(tmp_path: Path) -> None:
    for extra, u in (({}, 1.949), ({"dof": 30}, 1.949), ({"distribution": "uniform"}, 1.949)):
        ran = carry_out(tmp_path, {
            "quantities": {name: {"value": 0, "std": 1, **extra} for name in "ab"}, "measurands": {"y": {"model": "a + b"}},
            "correlations": [{"between": ["a", "b"], "value": 0.9}], "monte_carlo": {"trials": 200000},
        })  # fmt: skip
        found = ran.details("y")
        assert found["std"] == pytest.approx(u, abs=1e-3)
        assert found["mc"]["std"] == pytest.approx(u * math.sqrt(30 / 28) if extra.get("dof") else u, rel=0.01)


def test_a_correlation_that_shapes_cannot_have_is_told_at_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shape = {"value": 1, "distribution": "exponential"}
    job = {
        "quantities": {"a": shape, "b": dict(shape), "c": {"value": 1, "std": 0.1}},
        "correlations": [{"between": ["a", "c"], "value": 0.2}, {"between": ["a", "b"], "value": -0.9}],
        "measurands": {"m": {"model": "a + b + c"}},
    }
    assert carry_out(tmp_path, job).code == 3
    told = capsys.readouterr().err
    line = next(n for n, text in enumerate((tmp_path / "job.yaml").read_text().splitlines(), 1) if "-0.9" in text) - 3
    assert f"job.yaml:{line}:" in told
    assert "a and b: quantities of these shapes can have a correlation up to -0.645 only" in told


def test_degrees_of_freedom_of_correlated_readings_are_shared(tmp_path: Path) -> None:
    """JCGM 100, H.2: five sets of simultaneous readings, 4 degrees of freedom for whatever is computed of them."""
    job = {
        "quantities": {name: {"value": 1, "std": 0.1, "dof": 4} for name in "ab"}, "measurands": {"y": {"model": "a*b"}},
        "correlations": [{"between": ["a", "b"], "value": 0.5}], "monte_carlo": {"trials": 0},
    }  # fmt: skip
    assert carry_out(tmp_path, job).details("y")["dof"] == pytest.approx(4)
    job["quantities"]["b"]["dof"] = 9
    ran = carry_out(tmp_path, job)
    assert ran.details("y")["dof"] == pytest.approx(4)
    assert ran.result is not None and "different degrees of freedom" in ran.result.warnings[0]


def test_effective_degrees_of_freedom_are_cut_with_a_guard(tmp_path: Path) -> None:
    """JCGM 100, G.4.1: 18.9987 is meant as 19."""
    spread = {"a": (0.25, 9), "b": (0.57, 4), "c": (0.82, 14)}
    ran = carry_out(tmp_path, {
        "quantities": {name: {"value": 0, "std": std, "dof": dof} for name, (std, dof) in spread.items()},
        "measurands": {"y": {"model": "a + b + c"}}, "monte_carlo": {"trials": 0},
    })  # fmt: skip
    found = ran.details("y")
    assert found["dof"] == pytest.approx(19.0, abs=0.05)
    assert found["k"] == pytest.approx(2.093, abs=5e-4)
    assert found["U"] == pytest.approx(2.2, abs=0.05)


def test_a_model_without_derivative_has_the_uncertainty_of_monte_carlo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job: dict[str, Any] = {
        "quantities": {"x": {"value": 0, "std": 1}, "y": {"value": 0, "std": 1}}, "measurands": {"r": {"model": "sqrt(x*x + y*y)"}, "s": {"model": "x + y"}},
        "monte_carlo": {"trials": 200000},
    }  # fmt: skip
    ran = carry_out(tmp_path, job)
    found = ran.details("r")
    assert found["std"] == pytest.approx(math.sqrt(2 - math.pi / 2), rel=0.01)
    assert found["gum_valid"] is False
    assert found["interval"] == found["mc"]["interval"]
    assert ran.result is not None
    assert ran.result.covariance[0, 0] == pytest.approx(found["std"] ** 2)
    assert "no derivative" in ran.result.warnings[0]
    (tmp_path / "job.h5").unlink()
    assert carry_out(tmp_path, {**job, "monte_carlo": {"trials": 0}}).code == 4
    assert "Monte Carlo" in capsys.readouterr().err


def test_the_verdict_is_by_digits_in_the_unit_asked_for(tmp_path: Path) -> None:
    """Half of the last of two digits is 5 % of u = 0.10 deg and 2.9 % of the same 1.7 mrad.

    Of a normal and a rectangular distribution of equal variance 1.917 u cover 95 %, not 1.960 u.
    """
    parts = {"a": {"value": "30 deg", "std": "0.07071 deg"}, "b": {"value": "0 deg", "half_width": "0.12247 deg"}}
    job = {
        "quantities": parts,
        "measurands": {"in_deg": {"model": "a + b", "unit": "deg"}, "in_mrad": {"model": "a + b", "unit": "mrad"}},
        "monte_carlo": {"trials": 1_000_000, "seed": 1},
    }
    ran = carry_out(tmp_path, job)
    assert ran.details("in_deg")["gum_valid"] is True
    assert ran.details("in_mrad")["gum_valid"] is False


def test_reasons_where_gum_does_not_hold(tmp_path: Path) -> None:
    cases = [
        ("x*x", {"value": 0.1, "std": 0.05}, "not linear"), ("x", {"value": 0, "half_width": 1}, "not normal: it needs k = 1.65"),
        ("x", {"value": 1, "distribution": "exponential"}, "skew"), ("x*x", {"value": 0, "std": 1}, "no first-order sensitivity"),
    ]  # fmt: skip
    for model, given, reason in cases:
        ran = carry_out(
            tmp_path,
            {"quantities": {"x": given}, "measurands": {"y": {"model": model}}, "monte_carlo": {"trials": 200000}},
        )
        assert ran.details("y")["gum_valid"] is False
        assert ran.result is not None
        assert any(reason in note for note in ran.result.notes), ran.result.notes
    ran = carry_out(tmp_path, {"quantities": {"x": {"value": 0, "std": 1}}, "measurands": {"y": {"model": "2*x"}}})
    assert ran.details("y")["gum_valid"] is True


def test_a_verdict_that_few_trials_leave_open_names_how_many_decide(tmp_path: Path) -> None:
    """Both methods have the same t interval: trials that differ from it do so by chance."""
    job = {"quantities": {"a": {"value": "1 mm", "std": "84 nm", "dof": 9}}, "measurands": {"y": {"model": "a", "unit": "nm"}}}  # fmt: skip
    for seed in range(20):
        few = carry_out(tmp_path, {**job, "monte_carlo": {"trials": 5000, "digits": 1, "seed": seed}}, f"few{seed}")
        assert math.isnan(few.details("y")["gum_valid"]) and few.result is not None and not few.result.warnings
        decides = re.search(r"`trials: (\d+)` would do", "\n".join(few.result.notes))
        assert decides is not None
    enough = {"trials": int(decides[1]), "digits": 1, "seed": 1}
    assert carry_out(tmp_path, {**job, "monte_carlo": enough}, "enough").details("y")["gum_valid"] is True


def test_what_has_slopes_and_curvature_of_zero_still_depends_on_its_inputs(tmp_path: Path) -> None:
    job = {
        "quantities": {name: {"value": 0, "std": 1} for name in "abc"},
        "measurands": {"cube": {"model": "a**3"}, "product": {"model": "a*b*c"}, "none": {"model": "a - a"}},
        "monte_carlo": {"trials": 1000},
    }
    ran = carry_out(tmp_path, job)
    assert ran.result is not None
    notes = {name: text for name, _, text in (line.partition(": ") for line in reversed(ran.result.warnings))}
    assert "higher orders" in notes["cube"] and "higher orders" in notes["product"]
    assert "depends on no input" in notes["none"]


def test_a_reverse_budget_has_sizes_in_the_unit_that_suits_them(tmp_path: Path) -> None:
    """It was `target U = 3e-05 mm`."""
    quantities = {"a": {"value": "50 mm", "std": "25 nm"}}
    job = {"quantities": quantities, "measurands": {"y": {"model": "a", "unit": "mm"}}, "target": {"y": "30 nm"}}
    notes = [line.strip() for line in carry_out(tmp_path, job).result.notes]
    assert "target U = 30 nm: not reached" in notes and not any("e-05 mm" in line for line in notes)


def test_equal_readings_are_refused_with_the_entry_of_the_resolution(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "l.csv").write_text("l_mm\n" + 6 * "7.302\n")
    path = write(tmp_path, {"quantities": {"l": {"readings": "l.csv"}}, "measurands": {"y": {"model": "l", "unit": "mm"}}})  # fmt: skip
    ran = metrocli("report-uncertainty", path)
    assert ran.code == 3 and "all 6 readings are 7.302 mm" in ran.err
    given = re.search(r"\{value: 7.302 mm, half_width: half of its step\}", ran.err)
    assert given is not None
    written = path.read_text().replace(
        "l:\n    readings: l.csv", "l: " + given[0].replace("half of its step", "0.5 um")
    )
    path.write_text(written)
    assert metrocli("report-uncertainty", path).code == 0


def test_a_column_that_is_missing_is_named_before_its_unit_is_judged(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "l.csv").write_text("l_mm\n7.302\n7.305\n")
    parts = {"l": {"readings": "l.csv", "column": "length"}, "d": {"value": "1 mm", "std": "1 um"}}
    path = write(tmp_path, {"quantities": parts, "measurands": {"y": {"model": "l + d", "unit": "mm"}}})
    for command in ("report-uncertainty", "check"):
        ran = metrocli(command, path)
        assert ran.code == 3 and "has no column 'length'" in ran.err and "plain number" not in ran.err


def test_readings_and_samples_of_files(tmp_path: Path) -> None:
    values = np.random.default_rng(0).exponential(2.0, 4000) + 10
    (tmp_path / "old.csv").write_text(
        "run,l_um\n" + "\n".join(f"a{n},{value!r}" for n, value in enumerate(values.tolist())) + "\n"
    )
    (tmp_path / "l.csv").write_text("l_um\n10\n12\n11\n13\n")
    ran = carry_out(tmp_path, {
        "quantities": {"a": {"samples": "old.csv", "column": "l_um"}, "b": {"readings": "l.csv"}, "c": {"readings": "old.csv", "column": "l_um", "distribution": "sampled"}},
        "measurands": {"y": {"model": "a", "unit": "um"}, "z": {"model": "b", "unit": "um"}, "w": {"model": "c", "unit": "um"}}, "monte_carlo": {"trials": 200000},
    })  # fmt: skip
    sampled = ran.details("y")
    assert (sampled["value"], sampled["std"]) == pytest.approx((values.mean(), values.std()))
    assert sampled["mc"]["interval"] == pytest.approx(np.quantile(values, [0.025, 0.975]), rel=0.01)
    assert ran.details("w")["mc"]["interval"] == pytest.approx(np.quantile(values, [0.025, 0.975]), rel=0.01)
    assert ran.details("z")["value"] == pytest.approx(11.5)
    assert ran.details("z")["std"] == pytest.approx(math.sqrt(5 / 3) / 2)
    assert ran.details("z")["dof"] == 3
    record = hdf5.read(ran.path)[1]
    assert [item.path for item in record.inputs] == ["l.csv", "old.csv"]


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("l_mm\n1\nx\n", "l_mm", "'x' in the column 'l_mm'"),
        ("l_mm\n1\n", "l_mm", "one reading"),
        ("l_mm,m_mm\n1,2\n2,3\n", None, "2 columns of numbers"),
        ("l_mm\n1\n2\n", "k_mm", "did you mean 'l_mm'?"),
    ],
)
def test_readings_that_are_none_are_refused(
    text: str, column: str | None, message: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    (tmp_path / "l.csv").write_text(text)
    given = f"readings: l.csv{f', column: {column}' if column else ''}"
    (tmp_path / "job.yaml").write_text(JOB.replace("value: 50.000623 mm, std: 25 nm, dof: 18", given))
    for command in ("check", "report-uncertainty"):
        ran = metrocli(command, tmp_path / "job.yaml")
        assert ran.code == 3
        assert message in ran.err


def test_decisions(tmp_path: Path) -> None:
    job: dict[str, Any] = {
        "quantities": {"x": {"value": "10.004 mm", "std": "2 um"}}, "measurands": {"y": {"model": "x", "unit": "mm"}}, "coverage": {"k": 2},
        "tolerance": {"y": {"between": ["9.99 mm", "10.01 mm"], "process": {"mean": "10 mm", "std": "4 um"}, "risk": 0.01}}, "monte_carlo": {"trials": 200000},
    }  # fmt: skip
    found = carry_out(tmp_path, job).details("y")["tolerance"]
    assert found["zone"] == "conforming" and found["acceptance"] == pytest.approx([9.994, 10.006])
    assert found["acceptance_2017"] == pytest.approx([9.9933, 10.0067])
    assert found["U_over_T"] == pytest.approx(0.2) and found["capable"] is True
    assert found["conformance"] == pytest.approx(0.998650, abs=1e-6)
    assert found["conformance_mc"] == pytest.approx(0.99865, abs=5e-4)
    assert found["guarded"]["consumer"] <= 0.01 + 1e-9 or found["guard_band"] < 0
    job["quantities"]["x"]["value"] = "10.008 mm"
    assert carry_out(tmp_path, job).details("y")["tolerance"]["zone"] == "undecided"
    job["quantities"]["x"]["value"] = "10.015 mm"
    assert carry_out(tmp_path, job).details("y")["tolerance"]["zone"] == "non-conforming"
    del job["tolerance"]["y"]["process"]
    found = carry_out(tmp_path, job).details("y")["tolerance"]
    assert found["guard_band"] == pytest.approx(2.326348e-3 * 2)


def test_a_tolerance_that_leaves_nothing_to_accept_says_so(tmp_path: Path) -> None:
    job: dict[str, Any] = {
        "quantities": {"x": {"value": "10 mm", "std": "2 um"}}, "measurands": {"y": {"model": "x", "unit": "mm"}}, "coverage": {"k": 2},
        "tolerance": {"y": {"between": ["9.9945 mm", "10.0055 mm"], "risk": 0.01}}, "monte_carlo": {"trials": 0},
    }  # fmt: skip
    found = carry_out(tmp_path, job).details("y")["tolerance"]
    # Both limits take their part: P(Z < -2.3263) would be 0.01 for one.
    low, high = found["acceptance_guarded"]
    assert math.erfc((low - 9.9945) / 0.002 / math.sqrt(2)) / 2 + math.erfc(
        (10.0055 - low) / 0.002 / math.sqrt(2)
    ) / 2 == (pytest.approx(0.01, abs=1e-9))
    assert found["guard_band"] > 2.3264 * 0.002 and low + high == pytest.approx(20.0)
    assert found["acceptance"] == pytest.approx([9.9985, 10.0015])
    job["tolerance"]["y"]["between"] = ["9.997 mm", "10.003 mm"]
    ran = carry_out(tmp_path, job)
    found = ran.details("y")["tolerance"]
    assert (found["acceptance"], found["acceptance_2017"], found["acceptance_guarded"]) == ([], [], [])
    assert math.isnan(found["guard_band"])
    assert any("the acceptance zone of ISO 14253-1 is empty" in line for line in ran.result.notes)
    assert any("guard band for a risk of 0.01: no value can be accepted" in line for line in ran.result.notes)


def test_samples_of_one_file_are_drawn_row_by_row(tmp_path: Path) -> None:
    """b = a^2 of a symmetric a: not correlated, and yet b - a^2 is always zero. A declared 0 takes them apart."""
    a = np.random.default_rng(5).normal(size=2000).round(3)
    a -= a.mean()
    rows = [f"{x!r},{x * x!r},{-x!r}" for x in a.tolist()]
    (tmp_path / "s.csv").write_text("a,b,c\n" + "\n".join(rows) + "\n")
    job: dict[str, Any] = {
        "quantities": {name: {"samples": "s.csv", "column": name} for name in "abc"},
        "measurands": {"zero": {"model": "b - a**2"}, "sum": {"model": "a + c"}},
        "monte_carlo": {"trials": 20_000},
    }
    ran = carry_out(tmp_path, job)
    assert ran.details("zero")["mc"]["std"] == pytest.approx(0.0, abs=1e-9)
    assert (ran.details("sum")["std"], ran.details("sum")["mc"]["std"]) == pytest.approx((0.0, 0.0), abs=1e-7)
    assert any("a and c are columns of one file" in line for line in ran.result.warnings)
    apart = [{"between": pair, "value": 0} for pair in (["a", "b"], ["a", "c"], ["b", "c"])]
    found = carry_out(tmp_path, {**job, "correlations": apart}, "apart").details("sum")
    assert found["std"] == pytest.approx(math.sqrt(2) * a.std())
    assert found["mc"]["std"] == pytest.approx(math.sqrt(2) * a.std(), rel=0.03)


def test_simultaneous_readings_are_correlated_as_their_rows_are(tmp_path: Path) -> None:
    """JCGM 100, H.2: impedance from five sets of readings; tables H.3 and H.4."""
    v, i = (5.007, 4.994, 5.005, 4.990, 4.999), (19.663, 19.639, 19.640, 19.685, 19.678)
    phi = (1.0456, 1.0438, 1.0468, 1.0428, 1.0433)
    rows = [",".join(map(repr, row)) for row in zip(v, i, phi, strict=True)]
    (tmp_path / "z.csv").write_text("v_V,i_mA,phi_rad\n" + "\n".join(rows) + "\n")
    columns = {"V": "v_V", "I": "i_mA", "phi": "phi_rad"}
    job: dict[str, Any] = {
        "quantities": {name: {"readings": "z.csv", "column": column} for name, column in columns.items()},
        "measurands": {name: {"model": f"V/I{factor}", "unit": "ohm"} for name, factor in (("R", "*cos(phi)"), ("X", "*sin(phi)"), ("Z", ""))},
        "monte_carlo": {"trials": 100000},
    }  # fmt: skip
    ran = carry_out(tmp_path, job)
    assert ran.result is not None
    for name, value, std in (("R", 127.732, 0.071), ("X", 219.847, 0.295), ("Z", 254.260, 0.236)):
        found = ran.details(name)
        assert (round(found["value"], 3), found["std"]) == (value, pytest.approx(std, abs=6e-4))
        assert found["dof"] == pytest.approx(4)
        assert found["mc"]["std"] == pytest.approx(std * math.sqrt(2), rel=0.05)
    correlation = ran.result.arrays["correlation"]
    assert [correlation[0, 1], correlation[0, 2], correlation[1, 2]] == pytest.approx([-0.588, -0.485, 0.993], abs=6e-4)
    assert len(ran.result.warnings) >= 3 and "V and I are columns of one file" in ran.result.warnings[0]
    apart = [{"between": pair, "value": 0} for pair in (["V", "I"], ["V", "phi"], ["I", "phi"])]
    ran = carry_out(tmp_path, {**job, "correlations": apart})
    assert ran.details("Z")["std"] == pytest.approx(math.hypot(0.0032094 / 4.999, 0.009471 / 19.661) * 254.26, rel=1e-3)


@pytest.mark.parametrize(("model", "value", "std"), [("a**2", 1e-6, 2**0.5 * 1e-6), ("1000*a - 1000*a", 0.0, 0.0)])
def test_where_slopes_are_zero_the_second_order_stays(
    model: str, value: float, std: float, tmp_path: Path, metrocli: Callable[..., Any]
) -> None:
    """A square at 0 has u = sqrt(2) u(a)^2; what cancels has nothing."""
    text = f"quantities: {{a: {{value: 0, std: 0.001}}}}\nmeasurands: {{s: {{model: {model}}}}}\nmonte_carlo: {{trials: 0}}\n"
    (tmp_path / "job.yaml").write_text(f"metrocli: 1\njob: report-uncertainty\n{text}output: u.h5\n")
    ran = metrocli("report-uncertainty", tmp_path / "job.yaml", "--json")
    found = json.loads(ran.out)["estimates"]["s"]["second_order"]
    assert (found["value"], found["std"]) == pytest.approx((value, std), abs=1e-15)
    assert ("U = 0 lacks what higher orders change" in ran.out + ran.err) == (value > 0)


@pytest.mark.parametrize("model", ["a*sin(b)", "a*cos(-b)", "a*sin(2*b)", "a*tan(-b/2)", "a*(1 + cos(b*3))"])
def test_a_plain_number_above_a_turn_is_no_angle(model: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """`sin(30)` was refused, and the same 30 as a quantity was taken for radians without a word."""
    job, quantities = tmp_path / "job.yaml", "quantities: {a: {value: 2 mm, std: 1 um}, b: {value: %s, std: 0.01}}"
    head, tail = "metrocli: 1\njob: report-uncertainty\n", f"\nmeasurands: {{y: {{model: {model}, unit: mm}}}}\n"
    codes = []
    for value in ("30", "0.5", "30 deg", "30 rad"):
        std = f"0.01{value.lstrip('0123456789.')}"
        job.write_text(head + quantities.replace("0.01", std) % value + tail)
        ran = metrocli("check", job)
        codes.append(ran.code)
        assert ("b = 30 is more than a turn" in ran.err and "30 deg for degrees" in ran.err) == (value == "30"), ran.err
    assert codes == [3, 0, 0, 0]


@pytest.mark.parametrize("model", ["a*sin(b*pi/180)", "a*sin(0.01745*b)", "a*sin(b/100)", "a*sin(2*pi*b)"])
def test_what_turns_a_plain_number_into_radians_is_an_angle(model: str, tmp_path: Path, metrocli: Metrocli) -> None:
    quantities = "quantities: {a: {value: 2 mm, std: 1 um}, b: {value: 400, std: 0.01}}"
    measurands = f"measurands: {{y: {{model: {model}, unit: mm}}}}"
    (job := tmp_path / "job.yaml").write_text(f"metrocli: 1\njob: report-uncertainty\n{quantities}\n{measurands}\n")
    assert metrocli("check", job).code == 0
