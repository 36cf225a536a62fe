"""Laws: the terms mean what their texts mean, a planted law is found, and noise gives none."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import lengths as simulated_lengths
from simulated.network import network

from benchmarks.hidden import launch
from benchmarks.hidden import lengths as simulated
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.cli.diagnosis_report.laws import law_lines
from metrocli.diagnosis.adjusted_job import Ordered
from metrocli.diagnosis.diagnose import Attended, diagnose, no_interrupt
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.laws import steps
from metrocli.diagnosis.laws.definition import as_define, as_wanted, written
from metrocli.diagnosis.laws.law import near_effects
from metrocli.diagnosis.laws.library import Library
from metrocli.diagnosis.laws.terms import TermForm, columns_of, forms_of
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.status import status
from metrocli.diagnosis.verdict import as_data
from metrocli.effects.acting import measured
from metrocli.effects.own.columns import with_variables
from metrocli.effects.own.define import read
from metrocli.errors import Fault
from metrocli.expressions.derivatives import Jets
from metrocli.expressions.dimensions import compound
from metrocli.expressions.expression import parse
from metrocli.project import yaml_text
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load
from metrocli.tasks import KINDS

TASK = KINDS["multilaterate"].task()
PERIOD, SIZE, TAU = 410.0, 0.0012, 340.0


def test_the_columns_of_every_form_are_those_of_its_text() -> None:
    rng = np.random.default_rng(2)
    values = {
        "X": rng.uniform(-300, 800, 40),
        "t": rng.uniform(0, 900, 40),
        "T": rng.uniform(-1, 2, 40),
        "azimuth": rng.uniform(-3, 3, 40),
        "from_x": rng.choice([-1.0, 1.0], 40),
    }
    kinds = set()
    for form in forms_of(values, {"t": values["t"]}, 9):
        kinds.add(form.kind)
        found = columns_of([form], values)[:, 0]
        for column, text in enumerate(form.factors):
            expression = parse(text.replace("{s}", "s"))
            known = values | {"s": np.array(form.scanned or 0.0)}
            expected = expression.carried_out(Jets(expression, (), known, order=1)).value
            assert np.allclose(found[:, column], expected, rtol=1e-12, atol=1e-12), text
    assert kinds == {
        "constant", "powers", "products", "direction", "harmonics", "waves", "saturations", "steps",
    }  # fmt: skip


def diagnosed(
    size: float, seed: int, attended: Attended = no_interrupt, ordered: Ordered = map, settling: float = 0.0
) -> Diagnosis:
    """A network whose tracer T2 reads lengths with a wave in X of its points, or settles; plain formulas."""
    rng = np.random.default_rng(seed)
    net = simulated_lengths.network(40, 5).read(rng)
    error, t = np.zeros_like(net.readings), 20.0 * np.arange(net.readings.size)
    error[:, 2] = size * np.sin(2 * np.pi * net.nominal[:, 0] / PERIOD + 0.4)
    error[:, 2] += settling * (1 - np.exp(-t.reshape(error.shape)[:, 2] / TAU))
    net = replace(net, readings=net.readings + error)
    table = net.lengths()
    table = replace(table, columns={**table.columns, "t": t})
    job = TASK.job(simulated_lengths.settings(), lengths=table, points=net.point_table(), tracers=net.tracer_table())
    return diagnose(replace(TASK.diagnosed(job), places=TASK.places), attended=attended, ordered=ordered)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnosed(SIZE, 4)


@pytest.mark.slow
def test_a_wave_of_one_tracer_is_found_with_its_period_and_size(found: Diagnosis) -> None:
    assert found.verdict is Verdict.UNEXPLAINED
    law = found.law
    assert law is not None and len(law.terms) == 1
    texts = written(law)
    assert law.terms[0].spot.where == (("tracer", "T2"),)
    # along the beam of T2 a displacement of the point acts almost as the length does
    assert texts.adds == {"": "a1*sin(2*pi*X/s1) + a2*cos(2*pi*X/s1)"}
    assert texts.scan["s1"][0] == pytest.approx(PERIOD, rel=0.03) and texts.scan["s1"][1] == "mm"
    amplitude = np.hypot(*(value for value, _, _ in texts.parameters.values()))
    spread = max(std for _, std, _ in texts.parameters.values())
    assert abs(amplitude - SIZE) < 4 * spread
    assert law.gain.shown and law.part_of_structure > 0.9 and law.p_value < 1e-3


def test_what_settles_is_no_jump_although_it_is_much_like_one() -> None:
    """The law explains far more than a jump with a correlated error does, so it replaces them."""
    settled = diagnosed(0.0, 21, settling=2 * SIZE)
    assert settled.law is not None and not settled.findings
    (term,) = settled.law.terms
    assert (term.form.kind, term.form.variables, term.spot.where) == ("saturations", ("t",), (("tracer", "T2"),))
    near = ("dead-path-jump", ("T2",))
    assert near in [effect.spot for effect, _ in settled.law.near]
    # what a law stands for is not excluded
    assert {status(one) for one in settled.design.candidates if one.alternative.spot == near} == {"not-decided"}


def test_a_column_of_the_data_keeps_its_name_beside_those_of_a_law(found: Diagnosis) -> None:
    """Columns s1 and a1: a sine in s1 needs another name for its period, and its sizes need others than a1."""
    assert found.law is not None
    (term,) = found.law.terms
    more = [measured(name, name, compound("mm")) for name in ("s1", "a1")]
    (acting,) = with_variables((term.spot.acting,), more)
    spot = replace(term.spot, acting=acting)
    texts = [text.replace("X", "s1") for text in term.form.factors]
    wave = replace(term, spot=spot, form=replace(term.form, variables=("s1",), factors=tuple(texts)))
    line = replace(term, spot=spot, form=TermForm("powers", ("a1",), ("a1",)))
    law = replace(
        found.law, terms=(wave, line), sizes=(*found.law.sizes, np.ones(1)), stds=(*found.law.stds, np.ones(1))
    )
    shown = written(law)
    assert shown.adds == {"": "a2*sin(2*pi*s1/s2) + a3*cos(2*pi*s1/s2) + a4*a1"}
    assert set(shown.parameters) == {"a2", "a3", "a4"} and set(shown.scan) == {"s2"}


@pytest.mark.slow
def test_folds_that_travel_give_the_same_law(found: Diagnosis) -> None:
    cloudpickle = pytest.importorskip("cloudpickle", reason="the extra 'cluster' is not installed")
    sent = []

    def elsewhere(work: Callable[[int], Any], numbers: Iterable[int]) -> list[Any]:
        """Compute each fold with a copy that arrived as bytes, the last fold first."""
        order = list(numbers)
        sent.append(len(order))
        arrived = {number: cloudpickle.loads(cloudpickle.dumps(work))(number) for number in reversed(order)}
        return [arrived[number] for number in order]

    there = diagnosed(SIZE, 4, ordered=elsewhere)
    assert sent and min(sent) > 1
    assert json.dumps(as_data(there)) == json.dumps(as_data(found))


@pytest.mark.slow
def test_an_interrupted_search_has_the_best_that_it_had_found(found: Diagnosis) -> None:
    asked = []

    def attended(heeded: Callable[[], None]) -> AbstractContextManager[object]:
        """Interrupt when the search for laws asks for the second time, after its first term, whether it may go on."""
        budget = heeded.__self__  # type: ignore[attr-defined]
        spent = budget.spent

        def counted() -> bool:
            if sys._getframe(1).f_globals["__name__"] == steps.__name__:
                asked.append(True)
            if len(asked) == 2:
                heeded()
            return bool(spent())

        budget.spent = counted
        return nullcontext()

    ended = diagnosed(SIZE, 4, attended)
    assert ended.interrupted and not found.interrupted
    assert as_data(ended)["interrupted"] is True and ended.limited is None
    assert ended.law is not None and found.law is not None
    had, best = written(ended.law), written(found.law)
    # the search without the named effects had not begun
    assert had.adds == best.adds and had.scan["s1"][0] == pytest.approx(best.scan["s1"][0], rel=0.01)
    assert ended.law.gain.shown
    report = of_diagnosis(ended, None)
    assert "The search for laws was interrupted" in report and "so far (interrupted)" in report.splitlines()[0]


def test_effects_that_nearly_contain_a_law_are_named_with_their_cosine(found: Diagnosis) -> None:
    rng = np.random.default_rng(3)
    m = measurement_of(found.job)
    number = next(i for i, one in enumerate(m.families) if one.name == "dead-path-drift")
    at = next(i for i, one in enumerate(m.families[number].alternatives) if one.instance == ("T3",))
    column = m.system.seen(m.whole(number, at))[:, 0]
    other = m.system.seen(rng.normal(size=len(column)))
    other -= column * (column @ other) / (column @ column)
    other *= np.linalg.norm(column) / np.linalg.norm(other)
    (best, cosine), *_ = near_effects(State.of(m), column + 0.25 * other)
    assert best.spot == ("dead-path-drift", ("T3",))
    assert cosine == pytest.approx(1 / np.sqrt(1 + 0.25**2))
    assert near_effects(State.of(m), column + 3 * other) == ()
    # what a law explains is free of wrong readings: those that show the effect most had made it look like another one
    wrong = np.argsort(-np.abs(column[m.places]).max(axis=1))[:3]
    beside = State.of(m, [m.reading(int(number)) for number in wrong])
    (best, cosine), *_ = near_effects(beside, beside.seen(column))
    assert best.spot == ("dead-path-drift", ("T3",)) and cosine == pytest.approx(1.0)


def test_the_law_is_a_definition_without_fault(found: Diagnosis) -> None:
    assert found.law is not None
    define, wanted = as_define(found.law, "law-1"), as_wanted(found.law, "law-1")
    assert define["cause"] == "unknown" and wanted["tracer"] == "T2"
    text = str({"define": [define]}).replace("'", '"')
    faults: list[Fault] = []
    (effect,) = read(yaml_text.parse(text, "job.yaml", Path()).at("define").items, TASK.places, (), faults)
    assert not faults and [p.name for p in effect.parameters] == ["a1", "a2"]


def test_the_data_of_a_law_have_the_keys_of_the_contract(found: Diagnosis) -> None:
    (law,) = as_data(found)["laws"]
    assert set(law) == {
        "acts_on", "where", "adds", "parameters", "terms", "p_value", "gain", "part_of_structure", "near", "as_likely",
        "chosen", "data",
    }  # fmt: skip
    assert law["near"] == []
    assert all(set(other) == {"acts_on", "component", "where", "form"} for other in law["as_likely"])
    assert law["chosen"] and law["acts_on"] == "length" and law["parameters"]["a1"]["unit"] == "mm"


def test_a_law_of_an_angle_states_where_it_jumps(found: Diagnosis) -> None:
    assert found.law is not None
    assert not any("jumps" in line for line in law_lines(found, None))
    form, (term,) = TermForm("powers", ("azimuth",), ("azimuth",)), found.law.terms
    law = replace(found.law, terms=(replace(term, form=form),), sizes=(np.ones(1),), stds=(np.ones(1),))
    lines = list(law_lines(replace(found, laws=(law,)), None))
    assert "It jumps where the azimuth begins again after a full turn." in lines


def test_a_law_stands_beside_its_readings(found: Diagnosis) -> None:
    """Over X of the points: the readings of T2 are the planted wave with their noise; the law is that wave.

    A constant of T2 is left open, and three unknowns of each point take their part of the noise.
    """
    data = next(law for law in as_data(found)["laws"] if law["chosen"])["data"]
    assert (data["variable"], data["variable_unit"], data["unit"]) == ("X", "mm", "um")
    net = simulated_lengths.network(40, 5).read(np.random.default_rng(4))
    x, law, residual = (np.array(data[name]) for name in ("x", "law", "residual"))
    assert np.sort(x) == pytest.approx(np.sort(net.nominal[:, 0]), abs=0.5)
    planted = 1000 * SIZE * np.sin(2 * np.pi * x / PERIOD + 0.4)
    for values, bound in ((law, 0.15), (residual, 0.35)):
        off = values - planted
        assert (off - off.mean()).std() < bound * planted.std(), (off - off.mean()).std() / planted.std()


@pytest.mark.slow
def test_a_law_of_distances_stands_beside_distances() -> None:
    """The other readings are angles, which show nothing of it: +-30 um that go with the temperature."""
    m = launch.measurement(np.random.default_rng(2), True)
    planted = 0.03 * np.sin(6 * (m.temp - 20))
    read = m.read + np.outer(np.eye(5)[4], planted)
    job = replace(replace(m, read=read).adjusted(), places=KINDS["locate-launch-unit"].task().places)
    law = next(law for law in as_data(diagnose(job))["laws"] if law["chosen"])
    assert (law["acts_on"], law["data"]["unit"], len(law["data"]["x"])) == ("distance", "um", len(m.t))
    for name in ("law", "residual"):
        assert np.ptp(law["data"][name]) == pytest.approx(1000 * np.ptp(planted), rel=0.1)


def test_the_parts_of_a_gain_are_the_gain(found: Diagnosis) -> None:
    gain = next(law for law in as_data(found)["laws"] if law["chosen"])["gain"]
    folds = np.array(gain["folds"])
    assert len(folds) == 10 and folds.sum() == pytest.approx(gain["log_score"])
    assert folds.std(ddof=1) * np.sqrt(len(folds)) == pytest.approx(gain["log_score_std"])


def test_noise_alone_has_no_law() -> None:
    assert diagnosed(0.0, 5).laws == ()


def test_terms_at_a_place_take_the_memory_of_its_readings_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms of one tracer have a sixth of the rows; counted with all of them, they were left out of larger jobs."""
    measured = simulated.measurement(np.random.default_rng(4), 8)
    job = replace(measured.adjusted(), places=TASK.places)
    system = linearised(job.model)
    monkeypatch.setattr("metrocli.diagnosis.laws.library.MOST_NUMBERS", 100_000)
    library = Library(job, system)
    numbers = sum(part.values.size for family in library.families for part in family.columns.parts)
    places = {term.spot.where for terms in library.terms for term in terms}
    assert len(places) == 1 + len(measured.tracers)
    assert numbers <= 100_000 < sum(len(terms) for terms in library.terms) * system.rows


def test_a_formula_has_a_value_at_all_readings_on_which_it_acts(tmp_path: Path) -> None:
    """Interferometers without times beside a tracker with times: both read the points, one the directions."""
    net = replace(network(np.random.default_rng(61), 3, 14, mixed=True), times=True)
    job = adjusted_job_of(load(net.write(tmp_path)))
    library = Library(job, linearised(job.model), ())
    known = {carrier.spot.acting.name: set(carrier.values) for carrier in library._carriers}
    assert "t" in known["point-in-tracker"] and "t" not in known["point-in-machine"]
