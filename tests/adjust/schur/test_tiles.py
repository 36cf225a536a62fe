"""Readings in tiles: the same answer however the readings lie and however they are split."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from adjust import dense
from adjust.dense import Array

from metrocli.adjust.adjustment import StoppingRule, adjust, covariance_at
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.movements import Affine, Listed, of_members, of_points
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.schur import tiles as tiles
from metrocli.adjust.schur.batched_cholesky import backward, cholesky, complement, forward
from metrocli.adjust.schur.layout import arrange
from metrocli.adjust.schur.tiles import tiling_of
from metrocli.adjust.solution import Solution, place_in_tiles, residuals_of
from metrocli.instruments import tracer

SIGMA = 0.002
PLACES = np.array(
    [
        [-0.4, -0.5, 0.1], [1.4, -0.4, -0.2], [0.5, 1.7, 0.0], [0.6, 0.4, 2.2],
        [1.5, 1.5, 1.2], [-0.5, 1.3, 1.4], [-0.3, -0.6, 1.8], [1.7, 0.6, 0.5],
    ]
) * 1000  # fmt: skip


@dataclass(frozen=True)
class Lengths:
    """A network of lengths at starting values."""

    blocks: tuple[Block, ...]
    groups: tuple[Group, ...]
    datum: Datum | None

    def solved(self) -> Solution:
        return adjust(self.blocks, self.groups, self.datum)

    def named(self) -> Mapping[str, Block]:
        return {block.name: block for block in self.blocks}


N = 36


def lengths(n: int = N, m: int = 5, seed: int = 0, seen: Array | None = None, shuffled: bool = False) -> Lengths:
    """Points read by tracers; `seen` (n, m) says by which, and how often."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (n, 3)) * [900, 700, 500]
    places = PLACES[:m] + rng.normal(0, 30, (m, 3))
    dead = rng.uniform(100, 500, m)
    seen = np.ones((n, m)) if seen is None else seen
    i, j = (np.repeat(index, seen[np.nonzero(seen)].astype(int)) for index in np.nonzero(seen))
    order = rng.permutation(len(i)) if shuffled else np.arange(len(i))
    i, j = i[order], j[order]
    sigma = SIGMA * rng.uniform(0.5, 2, len(i))
    read = np.linalg.norm(points[i] - places[j], axis=1) - dead[j] + sigma * rng.normal(size=len(i))
    names = tuple(f"P{k}" for k in range(n))
    about = np.column_stack([places + rng.normal(0, 2, (m, 3)), dead + rng.normal(0, 2, m), np.ones(m)])
    free = np.ones((m, 5), dtype=bool)
    free[:, 4] = False
    block = tracer.point_block(points + rng.normal(0, 0.05, (n, 3)), names, True, 1000.0)
    tracers = tracer.tracer_block(about, tuple(f"T{k}" for k in range(m)), free, 1000.0)
    group = Group("lengths", tracer.chain(), Observations(read[None], sigma[None], {"point": i, "tracer": j}))
    return Lengths((block, tracers), (group,), tracer.datum(block, np.ones(n)))


def holes(n: int, m: int, share: float, seed: int = 3) -> Array:
    seen = (np.random.default_rng(seed).uniform(size=(n, m)) > share).astype(float)
    seen[seen.sum(axis=1) < 3] = 1.0
    return seen


def with_priors() -> Lengths:
    """Some points known a little, one in part, some entries fixed, one tracer known, a scale bar's worth of weights."""
    made = lengths(m=6, seed=5)
    points, tracers = made.blocks
    free = np.ones(points.values.shape, dtype=bool)
    free[7], free[11, 1:], free[20, 0] = False, False, False
    of_tracers = tracers.free.copy()
    of_tracers[2, :3] = False
    fixed = replace(points, free=free)
    some = prior(fixed, np.array([1, 4, 30]), sigma=np.full((3, 3), 0.02))
    part = prior(fixed, np.array([2, 33]), sigma=np.full((2, 1), 0.01), columns=(2,))
    weights = np.random.default_rng(1).uniform(0.1, 1, made.groups[0].observations.count)
    return Lengths(
        (fixed, replace(tracers, free=of_tracers)), (replace(made.groups[0], weights=weights), some, part), None
    )


CASES = {
    "four tracers": lambda: lengths(m=4),
    "eight tracers": lambda: lengths(m=8),
    "some lengths missing": lambda: lengths(m=5, seen=holes(N, 5, 0.2)),
    "some lengths read twice": lambda: lengths(m=5, seen=1 + holes(N, 5, 0.7)),
    "in no order": lambda: lengths(m=6, seen=holes(N, 6, 0.2), shuffled=True),
    "priors and fixed entries": with_priors,
}
EACH = pytest.mark.parametrize("case", CASES)


@pytest.fixture(params=["whole", "in lots of five", "in no tiles", "in chunks"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How the readings are taken."""
    if request.param in ("in no tiles", "in chunks"):
        monkeypatch.setattr(tiles, "MOST_COLUMNS", 0)
        monkeypatch.setattr(tiles, "READINGS_OF_CHUNK", 25 if request.param == "in chunks" else 10**9)
        monkeypatch.setattr(tiles, "NUMBERS_OF_READING", 10**9)
    else:
        monkeypatch.setattr(tiles, "WORTH_TILES", 0)
        monkeypatch.setattr(tiles, "READINGS_OF_TILE", 25 if request.param == "in lots of five" else 10**9)
    return str(request.param)


@pytest.mark.alike
@EACH
def test_each_way_is_the_dense_inverse(case: str, way: str) -> None:
    made = CASES[case]()
    found = tiling_of(made.groups, made.named(), arrange(made.named(), made.groups))
    assert bool(found.tiles) is (way not in ("in no tiles", "in chunks"))
    if way == "in chunks":
        assert len(found.chunks) >= 5
    if way == "in lots of five":
        assert len(found.tiles) >= 6
    solution = made.solved()
    assert solution.outcome is Outcome.CONVERGED
    assert solution.covariance_or_raise().layout.eliminated == "point"
    plain = dense.at_solution(solution.blocks, made.groups)
    normal = plain.jacobian.T @ plain.jacobian
    scale = 1 / np.sqrt(np.diag(normal))
    conditions = solution.conditions
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    assert conditions == (0 if made.datum is None else 6)
    # any generalised inverse gives the redundancy numbers
    general = (vectors[:, conditions:] / values[conditions:]) @ vectors[:, conditions:].T * scale[:, None] * scale
    explained = np.einsum("ia,ab,ib->i", plain.jacobian, general, plain.jacobian)
    redundancy = np.concatenate([residuals_of(solution, group).redundancy.T.ravel() for group in made.groups])
    assert np.allclose(redundancy, 1 - explained, rtol=0, atol=1e-6)
    gradient = plain.jacobian.T @ plain.residual * scale
    assert np.abs(gradient).max() < 1e-4
    if not conditions:
        std = np.sqrt(np.array([general[i, i] for i, place in enumerate(plain.places) if place[0] == "point"]))
        assert np.allclose(solution.std("point")[solution.blocks["point"].free], std, rtol=1e-6)


@EACH
def test_all_ways_agree(case: str, way: str) -> None:
    solution = CASES[case]().solved()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiles, "MOST_COLUMNS", 0)
        patch.setattr(tiles, "READINGS_OF_CHUNK", 10**9)
        other = CASES[case]().solved()
    assert solution.cost == pytest.approx(other.cost, rel=1e-10)
    assert solution.iterations == other.iterations
    for name, block in solution.blocks.items():
        assert np.abs((block.values - other.blocks[name].values) / np.maximum(other.std(name), 1e-9)).max() < 1e-4
        mine, theirs = solution.covariance_or_raise().of(name), other.covariance_or_raise().of(name)
        size = np.sqrt(np.maximum(np.diag(theirs), 1e-12))
        assert np.abs((mine - theirs) / size[:, None] / size).max() < 1e-6
        assert np.allclose(
            solution.covariance_or_raise().members(name),
            other.covariance_or_raise().members(name),
            rtol=1e-5,
            atol=1e-12,
        )
    one, two = (residuals_of(s, s.groups[0]) for s in (solution, other))
    assert np.allclose(one.redundancy, two.redundancy, rtol=0, atol=1e-7)
    assert np.allclose(one.normalised, two.normalised, rtol=0, atol=1e-4)


def test_chunks_end_between_points() -> None:
    """No point's readings lie in two chunks, and every reading lies in one."""
    made = lengths(m=6, seen=holes(N, 6, 0.2), shuffled=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiles, "READINGS_OF_CHUNK", 25)
        patch.setattr(tiles, "NUMBERS_OF_READING", 10**9)
        chunks = tiles.chunks_of(made.groups[0], 0, arrange(made.named(), made.groups))
    point = made.groups[0].observations.index["point"]
    rows = [np.arange(len(point))[chunk.rows] for chunk in chunks]
    assert sorted(np.concatenate(rows).tolist()) == list(range(len(point)))
    assert sum(len(set(point[row].tolist())) for row in rows) == N
    assert all((chunk.group.observations.readings[0] == made.groups[0].observations.readings[0, row]).all()
               for chunk, row in zip(chunks, rows, strict=True))  # fmt: skip


@pytest.mark.alike
@EACH
def test_the_covariance_of_a_point_with_its_readings(case: str, way: str) -> None:
    """In tiles as from the covariances of all pairs of a point and what a reading touches, for every datum."""
    solution = CASES[case]().solved()
    covariance, group = solution.covariance_or_raise(), solution.groups[0]
    place = place_in_tiles(solution, group)
    assert (place is None) is (way in ("in no tiles", "in chunks"))
    if place is None:
        return
    point = group.observations.index["point"]
    expected = np.zeros((3, len(point)))
    for touch in group.linear(solution.blocks, covariance.layout.wanted).touches:
        pair = covariance.pairs("point", point, touch.block, touch.index)
        expected += (pair * touch.jacobian[0]).sum(axis=1)
    found = covariance.eliminated.cross_covariance(place, group.observations.readings.shape)[:, 0]
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_points_of_like_tracers_stand_together() -> None:
    seen = np.ones((600, 6))
    seen[::3, 0], seen[1::3, 4:] = 0, 0
    made = lengths(n=600, m=6, seen=seen, shuffled=True)
    found = tiling_of(made.groups, made.named(), arrange(made.named(), made.groups))
    assert len(found.tiles) == 3
    assert sorted(piece.group.observations.lattice.shape[0] for p in found.tiles for piece in p.pieces) == [4, 5, 6]  # type: ignore[union-attr]


def test_a_point_without_a_length_is_named() -> None:
    seen = np.ones((N, 5))
    seen[17] = 0
    solution = lengths(seen=seen).solved()
    assert solution.outcome is Outcome.UNDETERMINED
    assert "P17" in str(solution.undetermined[0])


def test_nothing_but_points_is_free() -> None:
    """Known tracers leave no frame open, with a datum as without."""
    made = lengths()
    points, tracers = made.blocks
    for datum in (made.datum, None):
        solution = adjust([points, tracers.fixed()], made.groups, datum)
        assert solution.outcome is Outcome.CONVERGED
        assert solution.conditions == 0
        known = covariance_at(solution.blocks.values(), made.groups, datum).covariance_or_raise()
        assert known.layout.width == 0
        index = np.array([3, 1, 2])
        for one, other in (("point", "tracer"), ("tracer", "point"), ("tracer", "tracer")):
            shape = (solution.blocks[one].size, solution.blocks[other].size, 3)
            assert np.array_equal(known.pairs(one, index, other, index), np.zeros(shape))


@pytest.mark.alike
@pytest.mark.parametrize("off", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("m", [4, 6])
def test_the_last_step_leaves_nothing_to_go(m: int, off: float) -> None:
    """Also where the steps shrink so fast that none is taken to see it."""
    made = lengths(m=m)
    points, tracers = made.blocks
    rng = np.random.default_rng(m)
    start = replace(points, values=points.values + off * rng.normal(size=points.values.shape))
    solution = adjust([start, tracers], made.groups, made.datum)
    assert solution.outcome is Outcome.CONVERGED
    plain = dense.at_solution(solution.blocks, made.groups)
    # the next Gauss-Newton step, in standard deviations: 1e-6 is asked for
    step = np.linalg.lstsq(plain.jacobian, plain.residual, rcond=1e-10)[0]
    assert np.linalg.norm(plain.jacobian @ step) < 1e-7 * np.sqrt(len(step))


def test_without_a_covariance_the_values_are_the_same() -> None:
    made = lengths(m=4)
    one = made.solved()
    two = adjust(made.blocks, made.groups, made.datum, StoppingRule(covariance=False))
    assert two.cost == one.cost
    assert all(np.array_equal(one.blocks[name].values, two.blocks[name].values) for name in one.blocks)


@pytest.mark.parametrize(("p", "s"), [(4, 3), (6, 3), (9, 4), (3, 1)])
def test_matrices_side_by_side(p: int, s: int) -> None:
    rng = np.random.default_rng(p)
    columns = rng.normal(size=(p, s, 50))
    normal = np.einsum("pak,pbk->abk", columns, columns)
    factor, rest = complement(columns)
    assert np.abs(np.einsum("pqk,psk->qsk", rest, columns)).max() < 1e-12
    assert np.allclose(np.einsum("pqk,prk->kqr", rest, rest), np.eye(p - s), atol=1e-12)
    right = rng.normal(size=(s, 2, 50))
    expected = np.moveaxis(np.linalg.solve(np.moveaxis(normal, -1, 0), np.moveaxis(right, -1, 0)), 0, -1)
    for of_normal in (factor, cholesky(normal)):
        assert np.allclose(backward(of_normal, forward(of_normal, right)), expected, rtol=1e-8)


def test_a_singular_matrix_among_others_is_refused() -> None:
    columns = np.random.default_rng(0).normal(size=(5, 3, 20))
    columns[:, 2, 7] = columns[:, 0, 7] - 2 * columns[:, 1, 7]
    for find in (complement, lambda j: cholesky(np.einsum("pak,pbk->abk", j, j))):
        with pytest.raises(np.linalg.LinAlgError):
            find(columns)


@pytest.mark.parametrize("uniform", [True, False])
@pytest.mark.parametrize("size", [3, 5, 6])
def test_movements_by_moments_are_those_member_by_member(size: int, uniform: bool) -> None:
    rng = np.random.default_rng(size)
    points = of_points(scale=True)
    affine: Affine = points if size == 3 else of_members(size, points, slice(3, 6) if size == 6 else None)
    affine = affine.mixed(rng.normal(size=(7, 4)))
    values, others, change = rng.normal(size=(3, 30, size))
    weights = rng.uniform(size=30) if uniform else rng.uniform(size=(30, size))
    everyone = np.arange(30)
    one, two = Listed(affine.at(values, everyone)), Listed(affine.at(others, everyone))
    assert np.allclose(affine.gram(values, affine, others, weights), one.gram(values, two, others, weights))
    assert np.allclose(affine.dot(values, change), one.dot(values, change))
    assert np.allclose(affine.step(values, np.arange(4.0)), one.step(values, np.arange(4.0)))
    x, y, z = values[:, :3].T
    turned = of_points().at(values[:, :3], everyone)[:, :, 5]
    assert np.allclose(turned, np.column_stack([-y, x, 0 * z]))


def test_a_datum_may_list_its_movements() -> None:
    made = lengths()
    points, tracers = made.blocks
    assert made.datum is not None
    affine = made.datum.movements

    def listed(blocks: Mapping[str, Block]) -> dict[str, Array]:
        assert not callable(affine)
        return {
            name: move.at(blocks[name].values, np.arange(len(blocks[name].members))) for name, move in affine.items()
        }

    one, two = made.solved(), adjust(made.blocks, made.groups, replace(made.datum, movements=listed))
    assert two.conditions == one.conditions == 6
    for name in (points.name, tracers.name):
        assert np.allclose(one.blocks[name].values, two.blocks[name].values, rtol=0, atol=1e-9)
        assert np.allclose(
            one.covariance_or_raise().members(name), two.covariance_or_raise().members(name), rtol=1e-8, atol=1e-15
        )
