"""Points of a part at 20 degC: scaled about the origin, with one growth that all of them share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.lengths import network, places, settings

from metrocli.result import Result
from metrocli.settings import KnownQuantity
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.tasks.shared.part import Part

STEEL = Part(KnownQuantity(22.1), KnownQuantity(11.5e-6, 1e-6))
GROWN = 1 + 11.5e-6 * 2.1


def run(part: Part | None, **more: Table) -> Result:
    net = network(20, 5, noise=0.0)
    job = replace(settings(), part=part)
    return multilaterate.run(multilaterate.TASK.job(job, net.lengths(), net.point_table(), **more))


def test_points_are_given_at_20_degc() -> None:
    warm, cold = run(None), run(STEEL)
    assert places(cold.tables["points"]) == pytest.approx(places(warm.tables["points"]) / GROWN, rel=1e-12)
    # the mover's error is that at the measurement
    assert cold.tables["points"].numbers("error_x") == pytest.approx(warm.tables["points"].numbers("error_x"))
    assert any("20 degC" in note for note in cold.notes)


def test_distances_have_the_uncertainty_of_the_growth_once() -> None:
    """`u(L)^2 = u_0^2 + (L (T - 20) u(alpha))^2 + (L alpha u(T))^2`, by hand for the longest distance."""
    part = replace(STEEL, temperature=KnownQuantity(22.1, 0.2))
    warm, cold = run(None), run(part)
    of = max(range(1, 20), key=lambda i: distance(warm, "P0", f"P{i}").value)
    before, after = (distance(result, "P0", f"P{of}") for result in (warm, cold))
    more = before.value * np.sqrt((2.1e-6) ** 2 + (11.5e-6 * 0.2) ** 2 + (1e-6 * 0.2) ** 2)
    assert after.value == pytest.approx(before.value / GROWN, rel=1e-12)
    assert np.sqrt(after.std**2 - before.std**2) == pytest.approx(more, rel=1e-4)


def test_stated_growth_is_the_spread_of_many_draws() -> None:
    part, rng = Part(KnownQuantity(20.0, 0.5), KnownQuantity(23e-6, 2e-6)), np.random.default_rng(4)
    drawn = rng.normal(23e-6, 2e-6, 400_000) * rng.normal(0.0, 0.5, 400_000)
    assert part.std == pytest.approx(drawn.std(), rel=0.005)


def test_with_probing_the_corrected_points_are_those_of_the_part() -> None:
    net = network(20, 5, noise=0.0)
    columns = {"feature": np.array(["bore"] * 20), "point": np.array(net.names)}
    columns |= dict(zip("xyz", net.nominal.T, strict=True))
    probing = Table(columns, dict.fromkeys("xyz", "mm"), "probing.csv", tuple(range(2, 22)))
    warm, cold = run(None, probing=probing), run(STEEL, probing=probing)
    assert places(cold.tables["points"]) == pytest.approx(places(warm.tables["points"]), rel=1e-12)
    before, after = (places(result.tables["corrected"]) for result in (warm, cold))
    assert after == pytest.approx(before / GROWN, rel=1e-12)
    widened = cold.arrays["corrected_covariance"] - warm.arrays["corrected_covariance"] / GROWN**2
    assert widened == pytest.approx((2.1e-6) ** 2 * after[:, :, None] * after[:, None], rel=1e-6, abs=1e-12)


def test_an_expansion_that_no_solid_has_is_refused(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    """11.5 1/K is written for 11.5e-6 1/K: the part would shrink to a twentieth."""
    job = tmp_path / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: multilaterate\ninputs: {lengths: l.csv, points: p.csv}\nnoise: {constant: 1 um}\n"
        "part: {temperature: 22, expansion: 11.5 1/K}\noutput: o.h5\n"
    )
    wrong = metrocli("check", job).err
    assert "part.expansion: 11.5 1/K is outside what solids expand by: write e.g. 11.5e-6 1/K" in wrong
    assert "part.temperature: 22 has no unit" in wrong
    job.write_text(job.read_text().replace("22,", "22 degC,").replace("11.5 1/K", "-1e-6 1/K"))
    assert "part" not in metrocli("check", job).err.replace("part of", "")


def test_a_temperature_without_its_uncertainty_is_not_controlled() -> None:
    """1 K off moves the points as far as stated; with `std` it is in their uncertainty instead."""
    exact = Part(KnownQuantity(22.1), KnownQuantity(11.5e-6))
    warm, warmer = run(exact), run(replace(exact, temperature=KnownQuantity(23.1)))

    def hides(result: Result) -> list[float]:
        table = result.tables["not_controlled"]
        rows = zip(table.texts("effect"), table.numbers("hides"), strict=True)
        return [size for effect, size in rows if "stated without `std`" in effect]

    before, after = (places(one.tables["points"]) for one in (warm, warmer))
    ends = [float(np.linalg.norm(np.ptp(one, axis=0))) for one in (before, after)]
    assert hides(warm) == pytest.approx([ends[0] - ends[1]], rel=0.02)
    assert not hides(run(STEEL))


def test_a_coefficient_of_expansion_with_the_wrong_sign_is_refused(
    tmp_path: Path, metrocli: Callable[..., Any]
) -> None:
    assert metrocli("init", tmp_path / "gear", "--sample", "gear-m3d3").code == 0
    part = "part={temperature: 22 degC, expansion: -11.5e-6 1/K}"
    ran = metrocli("multilaterate", tmp_path / "gear/jobs/tip3.yaml", "--set", part)
    assert ran.code == 3, (ran.out, ran.err)
    assert "outside what solids expand by" in ran.err
