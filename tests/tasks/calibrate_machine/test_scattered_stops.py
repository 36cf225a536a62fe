"""A carrier that does not return to its places: planted by plain formulas at each stop, named, estimated and declared."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.hidden import machine, stops
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.diagnosis.status import candidates
from metrocli.units import parse_quantity

Metrocli = Callable[..., Any]


def made(seed: int, scatter: float, count: int = 80, alone: bool = False) -> stops.Measurement:
    rng = np.random.default_rng([480, seed])
    return stops.measurement(rng, count).read(rng, scatter, alone=alone)


def row_of(job: AdjustedJob) -> dict[str, Any]:
    (row,) = (one for one in candidates(job, what_can_be_seen(job)) if one["name"] == "repeatability")
    return row


@pytest.mark.slow
@pytest.mark.parametrize(("scatter", "declared"), [(2e-3, None), pytest.param(3e-3, 1e-3, marks=pytest.mark.slow)])
def test_stops_that_scatter_are_one_finding(scatter: float, declared: float | None) -> None:
    found = diagnose(made(1, scatter).adjusted(declared))
    assert (found.verdict, found.findings, found.noise.as_declared) == ("explained", (), True)
    (one,) = found.scatters
    assert one.effect.name == "repeatability"
    more = np.sqrt(scatter**2 - (declared or 0.0) ** 2)
    assert abs(one.std - more) < 3 * one.spread < 0.5 * more


def test_a_declared_repeatability_that_is_too_small_is_that_effect() -> None:
    """It is not a wrong sigma of given values: a user gives none of a stop."""
    found = diagnose(made(1, 3e-3, 30).adjusted(1e-3), quick=True)
    assert ([one.effect.name for one in found.scatters], found.variance_groups) == (["repeatability"], ())


@pytest.mark.slow
def test_a_declared_repeatability_that_is_too_large_is_a_wrong_sigma() -> None:
    found = diagnose(made(1, 1e-3).adjusted(5e-3))
    ((group,), scatters) = found.variance_groups, found.scatters
    assert (group.name, scatters) == ("prior of stop", ()) and 0.1 < group.ratio < 0.4


@pytest.mark.slow
def test_stops_as_declared_are_no_finding() -> None:
    for declared in (None, 2e-3):
        found = diagnose(made(2, declared or 0.0).adjusted(declared))
        assert (found.verdict, found.scatters) == ("clean", ())
    assert row_of(made(3, 0.0).adjusted())["status"] == "excluded"


@pytest.mark.slow
def test_stops_of_one_length_look_like_noise() -> None:
    """Each length has a stop of its own: its noise and the return of the carrier are one."""
    row = row_of(made(4, 0.0, alone=True).adjusted(alone=True))
    assert row["status"] == "not-testable"
    assert "several readings at each stop" in row["reason"]
    assert row_of(machine.measurement(np.random.default_rng(1), machine.SMALL).adjusted())["status"] == "not-testable"


@pytest.mark.slow
def test_the_job_declares_what_was_found(tmp_path: Path, metrocli: Metrocli) -> None:
    m = made(5, 2e-3)
    lines = ["point,station,x_mm,y_mm,z_mm,length_mm,t_s,tool"]
    for i, (place, tool, t) in enumerate(zip(m.at.tolist(), m.tool.tolist(), m.t.tolist(), strict=True)):
        at = ",".join(map(repr, place))
        lines += [f"P{i},S{j},{at},{length!r},{t!r},T{tool + 1}" for j, length in enumerate(m.length[i].tolist())]
    (tmp_path / "lengths.csv").write_text("\n".join(lines) + "\n")
    tools = ", ".join(f"{name}: [{', '.join(f'{x} mm' for x in v)}]" for name, v in machine.TOOLS.items())
    axes = zip("xyz", machine.LOW, machine.HIGH, strict=True)
    ranges = ", ".join(f"{axis}: {{range: [{low} mm, {high} mm], knots: 4}}" for axis, low, high in axes)
    job = tmp_path / "job.yaml"
    job.write_text(
        f"metrocli: 1\njob: calibrate-machine\nmethod: lengths\ninputs: {{lengths: lengths.csv}}\n"
        f"machine: {{chain: wXbYZt, axes: {{{ranges}}}, tools: {{{tools}}}}}\n"
        "noise: {constant: 0.2 um, proportional: 0.2 um/m, repeatability: 0.5 um}\noutput: result.h5\n"
    )
    data = json.loads(metrocli("diagnose", job, "--json").out)
    (effect,) = data["effects"]
    assert (effect["name"], effect["where"]) == ("repeatability", {})
    assert [one["status"] for one in data["candidates"] if one["name"] == "repeatability"] == ["named"]
    extended = yaml.safe_load(Path(data["extended_job"]).read_text())
    assert "effects" not in extended
    declared = extended["noise"]["repeatability"]
    assert declared.endswith(" um")
    value = parse_quantity(declared, "length")
    assert value == pytest.approx(np.hypot(0.0005, effect["parameters"]["std"]["value"]), rel=0.01)
    again = json.loads(metrocli("diagnose", data["extended_job"], "--json").out)
    assert (again["verdict"], again["effects"]) == ("clean", [])
    ran = json.loads(metrocli("calibrate-machine", data["extended_job"], "--json").out)
    assert ran["statistics"]["sigma0"] == pytest.approx(1.0, abs=0.15)
