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
from diagnosis.test_command import write
from scipy.stats import f as fisher
from scipy.stats import ncf

from benchmarks.hidden import lengths, machine
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.candidates import Candidate, NotTested
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.next_readings.choice import Next, next_readings, revealing
from metrocli.diagnosis.next_readings.pool import KnownErrors, Pool, pool_of
from metrocli.diagnosis.next_readings.proposals import Proposal, proposals, with_proposals
from metrocli.diagnosis.next_readings.separation import chance_to_separate
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


def plain_columns(m: lengths.Measurement, rival: str) -> tuple[Array, Array]:
    """Unit changes of the readings by the drift of T2's dead path, and by a rival, (n, 1) and (n, q), in sigmas."""
    name, at, names = RIVALS[rival]
    zero = dict.fromkeys(names, 0.0)
    other = np.stack([lengths.signature(name, at, zero | {one: 1e-9})(m) for one in names], axis=1)
    own = lengths.signature("dead-path-drift", 2, {"rate": RATE})(m)[:, None]
    return own / m.sigma[:, None], other / np.linalg.norm(other, axis=0) / m.sigma[:, None]


def plain_noncentrality(m: lengths.Measurement, rival: str, rate: float, noise: float) -> float:
    """What of the drift of T2's dead path neither the unknowns nor a rival can absorb, in squared sigmas."""
    own, other = plain_columns(m, rival)
    taken, _ = np.linalg.qr(np.concatenate([lengths.absorbed_by(m), other], axis=1))
    left = own - taken @ (taken.T @ own)
    return float((left**2).sum()) * (rate / RATE / noise) ** 2


def plain_powers(made: list[Proposal]) -> float:
    """The sum of the powers against both rivals with further readings, of the test at 1 % of the drift."""
    diagnosis, _ = found()
    m, (finding,), noise = with_readings(network(), made), diagnosis.findings, diagnosis.noise.ratio
    shown = [plain_noncentrality(m, rival, float(finding.effect.values[0]), noise) for rival in RIVALS]
    return sum(float(ncf.sf(fisher.isf(0.01, 1, 70), 1, 70, one)) for one in shown)


def pool_with(made: list[Proposal], rival: str) -> tuple[Pool, Pool, float]:
    """The pool of a rival now and with further readings, and its odds."""
    diagnosis, _ = found()
    (finding,) = diagnosis.findings
    other = next(one for one in finding.effect.rivals if str(one.alternative) == rival)
    effects = [finding.effect.alternative, other.alternative]
    now = then = pool_of(diagnosis.job, made, effects, (), KnownErrors(diagnosis.noise.ratio))
    for number in range(len(made)):
        then = then.with_proposal(number)
    return now, then, other.odds


def plain_chance(made: list[Proposal], rival: str, odds: float) -> float:
    """Share of simulated further readings that leave the true one of the two causes in the confidence set only."""
    diagnosis, _ = found()
    before, rng = network(), np.random.default_rng(4)
    after = with_readings(before, made)
    sure, weighted = len(before.t), []
    taken = lengths.absorbed_by(after)
    # in the first readings, what they know of the unknowns is a generalised inverse
    old, new = taken[:sure], taken[sure:]
    values = (before.length - before.distance) / before.sigma / diagnosis.noise.ratio
    columns = [one / diagnosis.noise.ratio for one in plain_columns(after, rival)]

    def taken_off(read: Array, of: list[Array], unknowns: Array) -> Array:
        """Drop of the sums of squares (draws,) by columns beside the unknowns."""
        basis, _ = np.linalg.qr(unknowns)
        own = np.concatenate(of, axis=1)
        own = own - basis @ (basis.T @ own)
        left, sizes, _ = np.linalg.svd(own / np.linalg.norm(own, axis=0), full_matrices=False)
        return np.asarray(((read @ left[:, sizes > 1e-5]) ** 2).sum(axis=1))

    def evidences(read: Array, unknowns: Array, rows: int) -> tuple[Array, Array, list[Array]]:
        """ln of the ratio of the evidence of the rival to that of the drift; all squares; drops by each and both."""
        basis, _ = np.linalg.qr(unknowns)
        squares = (read**2).sum(axis=1) - ((read @ basis) ** 2).sum(axis=1)
        cut = [one[:rows] for one in columns]
        off = [taken_off(read, of, unknowns) for of in ([cut[0]], [cut[1]], cut)]
        dof = rows - unknowns.shape[1]
        mine, other = (dof * np.log(squares - drop) for drop in off[:2])
        return (mine - other - (columns[1].shape[1] - 1) * np.log(dof)) / 2, squares, off

    known, _, _ = evidences(values[None], lengths.absorbed_by(before), sure)
    for true in (0, 1):
        # flat prior: unknowns and sizes together are normal about their estimates from the first readings
        left, sizes, right = np.linalg.svd(np.concatenate([old, columns[true][:sure]], axis=1), full_matrices=False)
        seen = sizes > 1e-9 * sizes[0]
        along = values @ left[:, seen] + rng.normal(size=(1000, seen.sum()))
        all_unknowns = (along / sizes[seen]) @ right[seen]
        further = all_unknowns @ np.concatenate([new, columns[true][sure:]], axis=1).T
        further += rng.normal(size=further.shape)
        read = np.concatenate([np.broadcast_to(values, (1000, sure)), further], axis=1)
        log_odds, squares, (mine, other, both) = evidences(read, taken, len(after.t))
        log_odds = (log_odds - known + np.log(odds)) * (-1 if true else 1)
        mine, other = (other, mine) if true else (mine, other)
        ranks = [one.shape[1] for one in columns][:: -1 if true else 1]
        dof = len(after.t) - taken.shape[1]
        explained = [basis_of(one, taken) for one in columns][:: -1 if true else 1]
        inside = read @ explained[0] @ (explained[0].T @ explained[1])
        cosines = np.linalg.norm(inside, axis=1) / np.sqrt(mine)
        alike = (1 - cosines**2) * mine < 6.6 * (squares - mine) / (dof - ranks[0])
        more, rest = ranks[0], dof - sum(ranks)
        needless = fisher.sf((both - other) / more / ((squares - both) / rest), more, rest) > 0.01
        instead = needless & ((ranks[1] <= ranks[0]) | (cosines > 0.9))
        listed = (log_odds > np.log(1 / 20)) | ((cosines > 0.3) & (alike | instead))
        weighted.append(float((~listed & (log_odds < 0)).mean()))
    return (weighted[0] + odds * weighted[1]) / (1 + odds)


def basis_of(columns: Array, taken: Array) -> Array:
    left, _ = np.linalg.qr(columns - taken @ (taken.T @ columns))
    return np.asarray(left)


def some_readings() -> list[list[Proposal]]:
    """The first that is proposed, all five, and five at random twice."""
    diagnosis, following = found()
    best, all_of_them, rng = (
        [one.proposal for one in following.readings],
        proposals(diagnosis.job),
        np.random.default_rng(1),
    )
    drawn = [[all_of_them[i] for i in rng.choice(len(all_of_them), 5, replace=False)] for _ in range(2)]
    return [best[:1], best, *drawn]


@pytest.mark.alike
@pytest.mark.parametrize("rival", RIVALS)
def test_what_neither_unknowns_nor_a_rival_absorb_is_that_of_plain_formulas(rival: str) -> None:
    diagnosis, _ = found()
    (finding,) = diagnosis.findings
    sizes = finding.effect.values
    for made in some_readings():
        now, then, _ = pool_with(made, rival)
        for pool, m in ((now, network()), (then, with_readings(network(), made))):
            expected = plain_noncentrality(m, rival, float(sizes[0]), diagnosis.noise.ratio)
            assert pool.noncentrality(pool.gram[None], sizes)[0] == pytest.approx(expected, rel=0.02, abs=0.01)


@pytest.mark.parametrize("rival", RIVALS)
def test_the_chance_to_separate_is_that_of_simulated_readings(rival: str) -> None:
    chances = []
    for made in some_readings():
        now, then, odds = pool_with(made, rival)
        chances.append(chance_to_separate(now, then, 1, odds))
        assert chances[-1] == pytest.approx(plain_chance(made, rival, odds), abs=0.05)
        assert chance_to_separate(now, now, 1, odds) == 0
    assert rival != "dead-path-drift T4" or max(chances) > 0.9


def test_what_is_proposed_raises_the_power_more_than_as_many_readings_at_random() -> None:
    diagnosis, following = found()
    assert str(diagnosis.findings[0].effect.alternative) == "dead-path-drift T2"
    (other,) = (one for one in following.aims if one.why.endswith("dead-path-drift T4"))
    assert other.before == 0
    assert other.after > 0.95
    best = plain_powers([one.proposal for one in following.readings])
    all_of_them, rng = proposals(diagnosis.job), np.random.default_rng(1)
    for _ in range(10):
        some = [all_of_them[i] for i in rng.choice(len(all_of_them), 5, replace=False)]
        assert plain_powers(some) < best


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
    sizes, proposed = np.array([0.02]), proposals(job)[::40]
    pool = pool_of(job, proposed, [Candidate(effect, ())])
    first, second = np.argsort(-pool.gains()[:, 0, 0])[:2].tolist()
    after = pool.with_proposal(first)
    for made, gram in (
        ([], pool.gram),
        ([first], pool.gram + pool.gains()[first]),
        ([first, second], after.gram + after.gains()[second]),
        ([first, second], after.with_proposal(second).gram),
    ):
        model = with_proposals(job.model, [proposed[i] for i in made])
        system = linearised(model)
        seen = system.seen(Candidate(effect, ()).signature(system)[:, 0] * sizes)
        assert pool.noncentrality(gram[None], sizes)[0] == pytest.approx(float(seen @ seen), rel=1e-5)


def test_wrong_readings_of_another_group_leave_the_others_their_weight() -> None:
    """A place that no reading of the group has is none of its readings; a wrong reading that it has counts nothing."""
    job = points()
    effect = next(one for one in job.effects if one.name == "tracker-range-zero")
    first = {key: str(names[0]) for key, names in job.model.readings[0].observations.keys.items()}

    def known(*wrong: dict[str, str]) -> float:
        pool = pool_of(job, proposals(job)[:1], [Candidate(effect, ())], known=KnownErrors(wrong=wrong))
        return float(pool.gram[0, 0])

    assert known({"image": "I01"}) == known({**first, "image": "I01"}) == known()
    assert known(first) < known() * (1 - 1e-9)


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
    with pytest.raises(UsageError, match="'tracer-drift:T9' is not an effect that"):
        revealing(diagnosis.job, diagnosis.design, "tracer-drift:T9", 5)


def test_an_effect_that_the_readings_cannot_have_is_refused_with_the_reason() -> None:
    diagnosis, _ = found()
    (drift,) = [one for one in diagnosis.job.effects if one.name == "tracer-drift"]
    known = [one.name for one in diagnosis.design.candidates]
    with pytest.raises(UsageError) as unknown:
        revealing(diagnosis.job, diagnosis.design, "nonsense", 5)
    named = unknown.value.args[0].partition("allowed: ")[2].split(", ")
    assert named[0].partition(":")[0] == known[0].partition(" ")[0]
    timeless = replace(diagnosis.design, candidates=(), not_tested=(NotTested(drift, "no t_s"),))
    with pytest.raises(UsageError, match=r"'tracer-drift:T1' is not a candidate here: no t_s"):
        revealing(diagnosis.job, timeless, "tracer-drift:T1", 5)
    with pytest.raises(UsageError, match=r"'moved-point:P1' is not a candidate here: it spoils one reading"):
        revealing(diagnosis.job, diagnosis.design, "moved-point:P1", 5)


@pytest.mark.slow
def test_json_of_next(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    job = write(Path(), network())
    data = json.loads(metrocli("diagnose", job, "--next", "2", "--json").out)  # type: ignore[attr-defined]
    assert len(data["next"]) == 2
    for one in data["next"]:
        assert set(one) == {"do", "where", "why", "power"}
    assert all(0 <= aim["before"] <= aim["after"] <= 1 for aim in data["next_aims"])
    assert metrocli("diagnose", job, "--next", "3", "--design").code == 2  # type: ignore[attr-defined]
    ran = metrocli("plan", job, "--reveal", "sphere-form:T5", "--json")
    data = json.loads(ran.out)  # type: ignore[attr-defined]
    assert [aim["why"] for aim in data["next_aims"]] == ["shows sphere-form T5"]
    ran = metrocli("plan", job, "--reveal", "sphere-from:T5", "--force")
    assert ran.code == 2 and "sphere-form:T5" in ran.err  # type: ignore[attr-defined]


@pytest.mark.parametrize("count", [0, 1001])
def test_at_most_a_thousand_readings_are_proposed(count: int, tmp_path: Path, metrocli: Metrocli) -> None:
    assert metrocli("init", tmp_path / "hall", "--sample", "laboratory-effects").code == 0  # type: ignore[attr-defined]
    ran = metrocli("diagnose", tmp_path / "hall/jobs/hall.yaml", "--next", str(count))
    assert ran.code == 2 and "1<=x<=1000" in ran.err  # type: ignore[attr-defined]
