"""Effects and laws beside each other: two waves of one period are one, and an effect that pays stays."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import five_axis

from benchmarks.hidden import lengths
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.laws import search
from metrocli.diagnosis.laws.library import Library
from metrocli.diagnosis.laws.steps import among_terms, are_apart, forward
from metrocli.tasks import KINDS


def waved(seed: int, size: float, turns: float, effect: str = "") -> AdjustedJob:
    """Return a network in which the lengths of tracer T1 have a wave in X, perhaps with an effect."""
    rng = np.random.default_rng([6, seed])
    m = lengths.measurement(rng, 60)
    m = lengths.planted(m, rng, effect, 2.5)[0] if effect else m
    x = m.points[m.point][:, 0]
    wave = size * np.sin(2 * np.pi * x / (np.ptp(x) / turns)) * (m.tracer == 1)
    return replace(replace(m, length=m.length + wave).adjusted(), places=KINDS["multilaterate"].task().places)


def test_an_effect_that_pays_beside_a_law_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """The law may be sought beside less than was found: a smooth error had taken a skew's place in white noise."""
    bases = search._bases
    monkeypatch.setattr(search, "_bases", lambda plain: list(bases(plain))[-1:])
    found = diagnose(waved(1, 0.0011, 4.3, "tracer-scale"))
    assert found.law is not None and not found.law.replaced
    assert [str(one.effect.alternative) for one in found.findings] == ["tracer-scale T0"]


def test_two_waves_of_one_period_do_not_stand_together() -> None:
    """Each would be as large as their difference is small, and predict nothing between the readings."""
    state = State.of(measurement_of(waved(2, 0.003, 3.0)))
    start = among_terms(state, Library(state.measurement.job, state.measurement.system))
    assert start is not None
    first = forward(start, 0.0, most=1)
    ((term, _),) = first.steps
    assert term.form.scanned is not None
    for factor, apart in ((1.001, False), (0.7, True)):
        other = term.at(factor * term.form.scanned)
        assert are_apart(first, other, first.library.columns(other)[:, None]).tolist() == [apart]


def test_later_terms_are_those_of_the_place_and_no_others() -> None:
    """Their columns, Gram matrices and products are those that they have among all terms."""
    m = measurement_of(waved(2, 0.003, 3.0))
    library = Library(m.job, m.system)
    rng, compared = np.random.default_rng(3), 0
    for family, terms in zip(library.families, library.terms, strict=True):
        chosen = [at for at, term in enumerate(terms) if term.place[1] == (("tracer", "T1"),)]
        compared += len(chosen)
        some, visible = family.only(chosen), rng.normal(size=(m.system.rows, 4))
        assert np.array_equal(
            some.columns.whole(range(len(chosen)), m.system.rows), family.columns.whole(chosen, m.system.rows)
        )
        assert np.allclose(
            some.columns.products(visible), family.columns.products(visible)[chosen], rtol=1e-12, atol=1e-9
        )
        assert np.array_equal(some.gram, family.gram[chosen])
    assert compared > 50


def test_a_wrong_reading_that_does_not_pay_beside_a_law_goes_and_one_that_does_stays() -> None:
    """A search that sees no law yet takes readings for wrong that it explains."""
    job = waved(2, 0.003, 3.0)
    m = measurement_of(job)
    plain = State.of(m)
    start = among_terms(plain, Library(m.job, m.system))
    assert start is not None
    ((_, law),) = forward(start, 0.0, most=1).steps
    gain, _, _ = plain.gains_of_readings()
    innocent, wrong = m.reading(int(np.argsort(gain)[len(gain) // 2])), m.reading(7)
    spoilt = replace(m, system=replace(m.system, residual=m.system.residual + 20 * m.system.seen(wrong.columns[:, 0])))
    found = State.of(spoilt, (innocent, wrong, law))
    assert search._with_those_beside(found, State.of(spoilt)).fixed == (wrong, law)


def test_what_undoes_the_positions_is_no_law(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    """`x += X` left no noise where x and y are exchanged in half of the rows, "1.4e-8 times that declared"."""
    rng = np.random.default_rng(4)
    job = five_axis.probed(tmp_path, five_axis.drawn(five_axis.KINDS["table-table"], rng, linear=False), rng, 90, 5e-4)
    job.write_text(job.read_text().replace("estimate: rotary", "estimate: locations"))
    head, *rows = (tmp_path / "probing.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    mixed = [[row[0], row[2], row[1], *row[3:]] if at % 2 else row for at, row in enumerate(cells)]
    (tmp_path / "probing.csv").write_text("\n".join([head, *map(",".join, mixed)]) + "\n")
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert found["noise"]["ratio"] > 1 and not any(law["chosen"] for law in found["laws"])
