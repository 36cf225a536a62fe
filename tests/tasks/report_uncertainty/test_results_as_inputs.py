"""Results of other jobs in a model: their covariance as it stands, their identity, their degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.report_uncertainty.jobs import carry_out

from metrocli.formats import hdf5
from metrocli.record import InputFile, Record
from metrocli.result import Estimate, Result

Metrocli = Callable[..., Any]
SUM = {"s": {"model": "part.a + part.b", "unit": "mm"}, "d": {"model": "part.a - part.b", "unit": "um"}}


def stored(folder: Path, name: str, covariance: Any, files: tuple[InputFile, ...] = (), **statistics: Any) -> str:
    std = np.sqrt(np.diag(covariance)).tolist()
    estimates = tuple(Estimate(n, v, s, "mm") for n, v, s in zip("ab", (10.0, 20.0), std, strict=True))
    result = Result("align-part", "", estimates, np.asarray(covariance, dtype=float), statistics)
    hdf5.write(folder / f"{name}.h5", result, Record("", files, "0", "2026-01-01T00:00:00Z"))
    return f"{name}.h5"


def job(measurands: dict[str, Any], trials: int = 100_000, **results: str) -> dict[str, Any]:
    return {"inputs": {"results": results}, "measurands": measurands, "monte_carlo": {"trials": trials}}


def test_the_covariance_is_used_as_it_stands(tmp_path: Path) -> None:
    ran = carry_out(tmp_path, job(SUM, part=stored(tmp_path, "part", [[4e-6, 3e-6], [3e-6, 9e-6]])))
    s, d = ran.details("s"), ran.details("d")
    assert (s["value"], d["value"]) == pytest.approx((30.0, -10000.0))
    assert (s["std"], d["std"]) == pytest.approx((math.sqrt(19e-6), 1e3 * math.sqrt(7e-6)))
    assert (s["mc"]["std"], d["mc"]["std"]) == pytest.approx((math.sqrt(19e-6), 1e3 * math.sqrt(7e-6)), rel=0.01)
    assert ran.result is not None
    assert ran.result.covariance[0, 1] == pytest.approx(1e3 * (4e-6 - 9e-6))
    assert s["dof"] == math.inf


def test_a_rank_deficient_covariance_gives_an_exact_difference(tmp_path: Path) -> None:
    ran = carry_out(tmp_path, job(SUM, part=stored(tmp_path, "part", [[4e-6, 4e-6], [4e-6, 4e-6]])))
    assert ran.details("d")["std"] == pytest.approx(0.0, abs=1e-9)
    assert ran.details("d")["mc"]["std"] == pytest.approx(0.0, abs=1e-9)
    assert ran.details("s")["std"] == pytest.approx(4e-3)


def test_estimated_noise_brings_its_degrees_of_freedom(tmp_path: Path) -> None:
    where = stored(tmp_path, "part", np.diag([4e-6, 9e-6]), noise_estimated=True, dof=6)
    found = carry_out(tmp_path, job(SUM, 200_000, part=where)).details("s")
    assert found["k"] == pytest.approx(2.4469, abs=1e-4)
    assert found["mc"]["std"] == pytest.approx(found["std"] * math.sqrt(6 / 4), rel=0.02)


def test_one_result_under_two_names_is_one_result(tmp_path: Path) -> None:
    where = stored(tmp_path, "part", np.diag([4e-6, 9e-6]))
    ran = carry_out(
        tmp_path,
        job(
            {"d": {"model": "part.a - same.a", "unit": "mm"}, "s": {"model": "part.a + same.b", "unit": "mm"}},
            part=where,
            same=where,
        ),
    )
    assert ran.code == 0
    assert ran.details("d")["std"] == pytest.approx(0.0, abs=1e-12)
    assert ran.details("d")["mc"]["std"] == pytest.approx(0.0, abs=1e-12)
    assert ran.details("s")["std"] == pytest.approx(math.sqrt(13e-6))


def test_an_estimate_under_another_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = stored(tmp_path, "part", [[4e-6, 3e-6], [3e-6, 9e-6]])
    wanted: dict[str, Any] = job({"s": {"model": "first + part.b", "unit": "mm"}}, part=where)
    ran = carry_out(tmp_path, wanted | {"quantities": {"first": {"estimate": "part.a"}}})
    assert ran.details("s")["value"] == pytest.approx(30.0)
    assert ran.details("s")["std"] == pytest.approx(math.sqrt(19e-6))
    assert ran.details("s")["mc"]["std"] == pytest.approx(math.sqrt(19e-6), rel=0.01)
    for given, message in (
        ({"estimate": "part.q"}, "no estimate 'q'"),
        ({"estimate": "pat.a"}, "no result 'pat'"),
        ({"estimate": "part.a", "std": "1 mm"}, "std is too much"),
    ):
        assert carry_out(tmp_path, wanted | {"quantities": {"first": given}}).code == 3
        assert message in capsys.readouterr().err


def test_results_with_a_common_source_are_named(tmp_path: Path) -> None:
    camera = InputFile("camera.h5", "c" * 64, 5)
    own = InputFile("one.csv", "1" * 64, 5)
    one = stored(tmp_path, "one", np.diag([4e-6, 9e-6]), (camera, own))
    two = stored(tmp_path, "two", np.diag([1e-6, 9e-6]), (camera,))
    wanted = {"d": {"model": "one.a - two.a", "unit": "mm"}}
    ran = carry_out(tmp_path, job(wanted, one=one, two=two))
    assert ran.result is not None
    assert any("common source, camera.h5" in line for line in ran.result.warnings)
    assert "one.csv" not in "".join(ran.result.warnings)
    three = stored(tmp_path, "three", np.diag([1e-6, 9e-6]))
    apart = carry_out(tmp_path, job(wanted, one=one, two=three))
    assert apart.result is not None and not apart.result.warnings


def test_a_result_and_what_it_was_made_from_are_named(tmp_path: Path) -> None:
    import hashlib

    camera = stored(tmp_path, "camera", np.diag([4e-6, 9e-6]))
    content = (tmp_path / camera).read_bytes()
    made_from = InputFile("camera.h5", hashlib.sha256(content).hexdigest(), len(content))
    part = stored(tmp_path, "part", np.diag([1e-6, 9e-6]), (made_from,))
    ran = carry_out(tmp_path, job({"d": {"model": "camera.a - part.a", "unit": "mm"}}, camera=camera, part=part))
    assert ran.result is not None
    assert any("camera and part have a common source, camera.h5" in line for line in ran.result.warnings)


def test_a_contributor_in_two_budgets_is_reported(tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert carry_out(tmp_path, {
            "quantities": {"thermometer": {"value": "0 K", "std": "0.1 K"}, name: {"value": "1 um", "std": "1 um"}, "c": "1 um/m/K", "l": "1 m"},
            "measurands": {"y": {"model": f"{name} + c*l*thermometer", "unit": "um"}},
        }, name).code == 0  # fmt: skip
    ran = carry_out(tmp_path, job({"d": {"model": "one.y + two.y", "unit": "um"}}, one="one.h5", two="two.h5"))
    assert ran.result is not None
    assert any(
        "'thermometer' is counted twice: it is in the budgets of one and of two" in line for line in ran.result.warnings
    )


def test_degrees_of_freedom_of_a_report_are_carried_on(tmp_path: Path) -> None:
    carry_out(
        tmp_path,
        {
            "quantities": {"a": {"value": "1 mm", "std": "1 um", "dof": 4}},
            "measurands": {"y": {"model": "a", "unit": "mm"}},
        },
        "one",
    )
    found = carry_out(tmp_path, job({"z": {"model": "2*one.y", "unit": "mm"}}, one="one.h5")).details("z")
    assert found["dof"] == pytest.approx(4)
    assert found["k"] == pytest.approx(2.776, abs=1e-3)


@pytest.mark.parametrize(("std", "invalid"), [(0.25, True), (1e-4, False)])
def test_a_report_that_monte_carlo_does_not_validate_is_named_where_it_is_used(
    std: float, invalid: bool, tmp_path: Path
) -> None:
    quantities = {"a": {"value": 1, "std": std}, "b": {"value": 1, "std": std}}
    first = {
        "quantities": quantities,
        "measurands": {"y": {"model": "a/b", "unit": "1"}},
        "monte_carlo": {"trials": 20_000},
    }
    assert carry_out(tmp_path, first, "ratio").code == 0
    ran = carry_out(tmp_path, job({"z": {"model": "2*ratio.y", "unit": "1"}}, 2000, ratio="ratio.h5"))
    assert ran.result is not None
    named = [text for text in ran.result.warnings if "does not validate its uncertainty" in text]
    assert [text.partition(":")[0] for text in named] == ["ratio.y"] * invalid


def test_a_report_of_measurands_with_different_degrees_of_freedom_is_carried_on(tmp_path: Path) -> None:
    """s + d - 2 a is exactly zero, whatever the degrees of freedom of the three."""
    quantities = {"a": {"value": 10, "std": 1, "dof": 5}, "b": {"value": 5, "std": 1, "dof": 50}}
    models = {"s": {"model": "a + b"}, "d": {"model": "a - b"}, "c": {"model": "a"}}
    assert carry_out(tmp_path, {"quantities": quantities, "measurands": models}, "first").code == 0
    zero = {"z": {"model": "r.s + r.d - 2*r.c"}}
    found = carry_out(tmp_path, job(zero, 10_000, r="first.h5")).details("z")
    assert found["std"] == pytest.approx(0.0, abs=1e-7)
    assert found["mc"]["std"] == pytest.approx(0.0, abs=1e-9)


def test_correlations_that_t_distributions_cannot_have_do_not_stop_a_report(tmp_path: Path) -> None:
    """One degree of freedom beside 7.2: no joint distribution of these two shapes is correlated so much."""
    quantities = {"a": {"value": 10, "std": 1, "dof": 1}, "b": {"value": 5, "std": 1.3}}
    models = {"y": {"model": "a"}, "z": {"model": "a + b"}}
    assert carry_out(tmp_path, {"quantities": quantities, "measurands": models}, "first").code == 0
    ran = carry_out(tmp_path, job({"d": {"model": "r.z - r.y"}}, 10_000, r="first.h5"))
    assert ran.code == 0
    assert ran.details("d")["std"] == pytest.approx(1.3)
    assert any("correlated with different degrees of freedom" in line for line in ran.result.warnings)


def test_a_correlation_with_a_result_is_taken(tmp_path: Path) -> None:
    where = stored(tmp_path, "part", np.diag([4e-6, 9e-6]))
    wanted = job({"y": {"model": "part.a + t*c", "unit": "mm"}}, part=where)
    wanted |= {
        "quantities": {"t": {"value": "0 K", "std": "0.1 K"}, "c": "20 um/K"},
        "correlations": [{"between": ["part.a", "t"], "value": 0.5}],
    }
    found = carry_out(tmp_path, wanted).details("y")
    assert found["std"] == pytest.approx(math.sqrt(4e-6 + 4e-6 + 4e-6))
    assert found["mc"]["std"] == pytest.approx(found["std"], rel=0.01)


BAD = [
    ({"y": {"model": "part.c", "unit": "mm"}}, "has no estimate 'c'", "part."), ({"y": {"model": "pat.a", "unit": "mm"}}, "no result 'pat'", "did you mean 'part'?"),
    ({"y": {"model": "part.a.real", "unit": "mm"}}, "has no estimate 'a.real'", "part.a"), ({"y": {"model": "part.a", "unit": "K"}}, "gives a length", "mm"),
    ({"y": {"model": "part.a*part", "unit": "mm"}}, "no quantity 'part'", ""),
]  # fmt: skip


@pytest.mark.parametrize(("measurands", "message", "hint"), BAD)
def test_names_that_a_result_lacks(
    measurands: dict[str, Any], message: str, hint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = carry_out(tmp_path, job(measurands, part=stored(tmp_path, "part", np.diag([4e-6, 9e-6]))))
    told = capsys.readouterr().err
    assert ran.code == 3
    assert message in told and hint in told


def test_a_covariance_that_is_none_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for covariance, message in (
        ([[4e-6, 9e-6], [9e-6, 4e-6]], "covariance is not positive"),
        ([[math.nan, 0], [0, 1e-6]], "no valid covariance"),
    ):
        assert carry_out(tmp_path, job(SUM, part=stored(tmp_path, "part", covariance))).code == 3
        assert message in capsys.readouterr().err


def test_a_project_runs_what_a_report_needs(tmp_path: Path, metrocli: Metrocli) -> None:
    first = "metrocli: 1\njob: report-uncertainty\nquantities: {a: {value: 1 mm, std: 1 um}}\nmeasurands: {y: {model: a, unit: mm}}\noutput: one.h5\n"
    second = "metrocli: 1\njob: report-uncertainty\ninputs: {results: {one: one.h5}}\nmeasurands: {z: {model: 2*one.y, unit: mm}}\noutput: two.h5\n"
    (tmp_path / "one.yaml").write_text(first)
    (tmp_path / "two.yaml").write_text(second)
    (tmp_path / "metrocli.yaml").write_text("project: p\njobs: [two.yaml, one.yaml]\n")
    assert metrocli("check", tmp_path).code == 0
    assert metrocli("run", tmp_path).code == 0
    assert hdf5.read(tmp_path / "two.h5")[0].estimates[0].std == pytest.approx(2e-3)
    assert "up to date" in metrocli("status", tmp_path).out
