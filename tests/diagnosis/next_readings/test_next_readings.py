"""What to measure next: powers against plain formulas, and the words and keys of the contract."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import f as fisher
from scipy.stats import ncf

from benchmarks.hidden import lengths, machine
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.next_readings.choice import Next, next_readings, revealing
from metrocli.diagnosis.next_readings.pool import pool_of
from metrocli.diagnosis.next_readings.proposals import Proposal, proposals, with_proposals
from metrocli.effects.effect import ELAPSED
from metrocli.errors import UsageError

Array = npt.NDArray[np.float64]
Metrocli = Callable[..., object]
RATE = 5e-7
"""Of a dead path that grows [mm/s]; another tracer and a drift of it explain it nearly as well"""


@cache
def network() -> lengths.Measurement:
    m = lengths.measurement(np.random.default_rng(12), 30)
    return replace(m, length=m.length + lengths.signature("dead-path-drift", 2, {"rate": RATE})(m))


@cache
def found() -> tuple[Diagnosis, Next]:
    diagnosis = diagnose(network().adjusted())
    return diagnosis, next_readings(diagnosis, 5)


def with_readings(m: lengths.Measurement, made: list[Proposal]) -> lengths.Measurement:
    """The network with further readings of given points at given times; lengths do not matter."""
    if not made:
        return m
    rows = [(int(o["point"][1:]), int(o["tracer"][1:])) for o in (one.where for one in made)]
    times = [m.t.min() + next(iter(one.added.values())).conditions[ELAPSED][0] for one in made]
    more = {"point": [p for p, _ in rows], "tracer": [j for _, j in rows], "t": times}
    filled = {"temp": np.full(len(made), 20.0), "length": np.zeros(len(made))} | more
    return replace(m, **{key: np.concatenate([getattr(m, key), np.array(one)]) for key, one in filled.items()})


RIVALS = {
    "dead-path-drift T4": ("dead-path-drift", 4, ("rate",)),
    "tracer-drift T2": ("tracer-drift", 2, ("vx", "vy", "vz")),
}


def plain_power(m: lengths.Measurement, rival: str, rate: float, noise: float) -> float:
    """Power of the test at 1 % whether the drift of T2's dead path is needed beside a rival."""
    taken = lengths.absorbed_by(m)
    name, at, names = RIVALS[rival]
    zero = dict.fromkeys(names, 0.0)
    other = np.stack([lengths.signature(name, at, zero | {one: 1e-9})(m) for one in names], axis=1)
    basis, _ = np.linalg.qr(lengths.visible(m, taken, other / np.linalg.norm(other, axis=0)))
    own = lengths.visible(m, taken, lengths.signature("dead-path-drift", 2, {"rate": rate})(m)[:, None])[:, 0] / noise
    own = own - basis @ (basis.T @ own)
    dof = len(m.t) - taken.shape[1] - basis.shape[1] - 1
    return float(ncf.sf(fisher.isf(0.01, 1, dof), 1, dof, float(own @ own)))


def plain_powers(made: list[Proposal]) -> list[float]:
    """The power against each rival with further readings."""
    diagnosis, _ = found()
    m, (finding,) = with_readings(network(), made), diagnosis.findings
    return [plain_power(m, rival, float(finding.effect.values[0]), diagnosis.noise.ratio) for rival in RIVALS]


def test_the_power_is_that_of_plain_formulas_before_and_after() -> None:
    diagnosis, following = found()
    (finding,) = diagnosis.findings
    assert str(finding.effect.alternative) == "dead-path-drift T2"
    aims = {one.why.partition(" from ")[2]: one for one in following.aims}
    before, after = plain_powers([]), plain_powers([one.proposal for one in following.readings])
    for number, rival in enumerate(RIVALS):
        assert aims[rival].before == pytest.approx(before[number], abs=0.01)
        assert aims[rival].after == pytest.approx(after[number], abs=0.01)
    assert after[0] > before[0] + 0.2


def test_what_is_proposed_raises_the_power_more_than_as_many_readings_at_random() -> None:
    diagnosis, following = found()
    best = sum(plain_powers([one.proposal for one in following.readings]))
    all_of_them, rng = proposals(diagnosis.job), np.random.default_rng(1)
    for _ in range(10):
        some = [all_of_them[i] for i in rng.choice(len(all_of_them), 5, replace=False)]
        assert sum(plain_powers(some)) < best


def test_a_reading_is_named_by_its_keys_and_when_it_is_made() -> None:
    _, following = found()
    for one in following.readings:
        point, tracer = one.proposal.where["point"], one.proposal.where["tracer"]
        assert one.proposal.do.startswith(f"point {point} once more ")
        assert one.proposal.do.endswith(f" with {tracer}")
        assert one.why.startswith("separates dead-path-drift T2 from ")


@cache
def points() -> AdjustedJob:
    return machine.measurement(np.random.default_rng(3), machine.SMALL).adjusted()


def test_gains_are_those_of_the_adjustment_with_the_readings_in_it() -> None:
    """Two proposals one after the other, against the projection of the whole measurement with both."""
    job = points()
    effect = next(one for one in job.effects if one.name == "tracker-range-zero")

    def shown(model, system) -> Array:  # type: ignore[no-untyped-def]
        return 0.02 * signature(model, system, effect, (), {})[:, 0]

    proposed = proposals(job)[::40]
    pool = pool_of(job.model, proposed, [], shown, 1.0)
    first, second = np.argsort(-pool.gains())[:2].tolist()
    after = pool.made(first)
    for made, expected in (
        ([], pool.noncentrality),
        ([first], pool.noncentrality + pool.gains()[first]),
        ([first, second], after.noncentrality + after.gains()[second]),
    ):
        model = with_proposals(job.model, [proposed[i] for i in made])
        system = linearised(model)
        seen = system.seen(shown(model, system))
        assert float(seen @ seen) == pytest.approx(expected, rel=1e-5)


def test_points_of_a_machine_come_from_the_other_side_or_with_another_tool() -> None:
    words = [one.do for one in proposals(points()) if one.where["point"] == "P7"]
    assert words[0] == "point P7 once more at the end"
    assert "point P7 at the end from the other side in x" in words
    tools = {word.rpartition(" ")[2] for word in words if "with tool" in word}
    assert len(tools) == 2 and tools < {"T1", "T2", "T3"}


def test_readings_that_reveal_an_effect_raise_the_power_to_find_it() -> None:
    diagnosis, _ = found()
    following = revealing(diagnosis.job, diagnosis.design, "reseated-reflector", 5)
    (aim,) = following.aims
    assert (aim.why, len(following.readings)) == ("shows reseated-reflector", 5)
    assert aim.before < 0.02
    assert aim.after > 0.99
    with pytest.raises(UsageError, match="there is no effect 'tracer-drift:T9'"):
        revealing(diagnosis.job, diagnosis.design, "tracer-drift:T9", 5)


def test_json_of_next(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert metrocli("init", "hall", "--sample", "laboratory-effects").code == 0  # type: ignore[attr-defined]
    ran = metrocli("diagnose", "hall/jobs/hall.yaml", "--next", "3", "--json")
    data = json.loads(ran.out)  # type: ignore[attr-defined]
    assert len(data["next"]) in (0, 3)
    for one in data["next"]:
        assert set(one) == {"do", "where", "why", "power"}
    assert all(0 <= aim["before"] <= aim["after"] <= 1 for aim in data["next_aims"])
    assert metrocli("diagnose", "hall/jobs/hall.yaml", "--next", "3", "--design").code == 2  # type: ignore[attr-defined]
    ran = metrocli("plan", "hall/jobs/hall.yaml", "--reveal", "sphere-form:LT5", "--json")
    data = json.loads(ran.out)  # type: ignore[attr-defined]
    assert [aim["why"] for aim in data["next_aims"]] == ["shows sphere-form LT5"]
    ran = metrocli("plan", "hall/jobs/hall.yaml", "--reveal", "sphere-from:LT5", "--force")
    assert ran.code == 2 and "sphere-form:LT5" in ran.err  # type: ignore[attr-defined]
