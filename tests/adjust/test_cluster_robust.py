"""The covariance over clusters is the one that whole matrices give: CR2, shrunk, with Satterthwaite's degrees of freedom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from adjust import dense, problems
from adjust.dense import Array
from simulated import lengths

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.clusters.likelihood import Likelihood, most_likely
from metrocli.adjust.clusters.robust import ClusterRobust, Clusters, cluster_robust
from metrocli.adjust.clusters.spread import Excess
from metrocli.errors import UndeterminedError
from metrocli.instruments import camera, tracer
from metrocli.tasks.multilaterate import problem as multilaterate
from metrocli.tasks.multilaterate.settings import Files


def bent(problem: problems.Problem, size: float = 0.5) -> problems.Problem:
    """The problem with smooth errors of its own in each image: waves along u and along v."""
    group, rng = problem.groups[0], np.random.default_rng(17)
    seen = group.observations
    view = seen.index[camera.VIEW]
    phase, amplitude = rng.uniform(0, 6, (2, 2, view.max() + 1)), rng.normal(0, size, (2, 2, view.max() + 1))
    waves = amplitude[:, :, view] * np.sin(seen.readings[:, None] / 200 + phase[:, :, view])
    moved = group.with_observations(seen.with_readings(seen.readings + waves.sum(axis=0)))
    return problems.Problem(problem.blocks, (moved, *problem.groups[1:]), problem.datum)


def robust(problem: problems.Problem, *first: str) -> ClusterRobust:
    solution = adjust(problem.blocks.values(), problem.groups, problem.datum)
    group = problem.groups[0]
    return cluster_robust(solution, Clusters({group.name: group.observations.index[camera.VIEW]}, first=first))


@dataclass
class Plain:
    """The same by whole matrices: all readings, all unknowns."""

    found: ClusterRobust
    problem: problems.Problem
    first: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        whole = dense.at_solution(self.found.white.blocks, self.problem.groups)
        self.places, residual, j = whole.places, whole.residual, whole.jacobian
        q = whole.noise
        view = np.repeat(self.problem.groups[0].observations.index[camera.VIEW], 2)
        images = np.unique(view)
        hat = j @ q @ j.T
        own = [np.flatnonzero(view == image) for image in images]
        used = np.array([(np.abs(j[rows]) > 0).any(axis=0) for rows in own]).sum(axis=0)
        used[(np.abs(j[len(view) :]) > 0).any(axis=0)] = len(images)
        self.shared = used > 1
        joint = q[np.ix_(self.shared, self.shared)]
        # unknowns that all images use come first, or those of some blocks
        ahead = np.array([name in self.first for name, *_ in whole.places]) if self.first else used == len(images)
        order = np.argsort(~ahead[self.shared], kind="stable")
        self.lower = np.linalg.cholesky(joint[np.ix_(order, order)])[np.argsort(order)]
        first = int(ahead[self.shared].sum())
        self.parts = [part for part in (np.arange(first), np.arange(first, len(joint))) if len(part)]
        free = np.eye(len(hat)) - hat
        self.residual = residual
        self.acting = []
        for rows in own:
            alone = j[rows][:, ~self.shared]
            basis = np.linalg.qr(alone[:, (np.abs(alone) > 0).any(axis=0)])[0]
            f = (j[rows][:, self.shared] - basis @ (basis.T @ j[rows][:, self.shared])) @ self.lower
            u, t, _ = np.linalg.svd(f[:, :first], full_matrices=False)
            self.acting.append((rows, u[:, t > 1e-9], t[t > 1e-9] ** 2))
        self.free = free
        self.errors = self.expected(self.found.sample.excess)
        weights = []
        for rows in own:
            omega = self.errors[np.ix_(rows, rows)]
            root = power(omega, 0.5)
            of_residuals = (free @ self.errors @ free)[np.ix_(rows, rows)]
            weight = np.zeros((len(q), len(residual)))
            weight[:, rows] = q @ j[rows].T @ root @ power(root @ of_residuals @ root, -0.5) @ root
            weights.append(np.linalg.solve(self.lower, weight[self.shared]))
        z = np.array([weight @ residual for weight in weights])
        weights = [weight @ free for weight in weights]
        target = np.sum([weight @ self.errors @ weight.T for weight in weights], axis=0)
        sample = z.T @ z
        self.factors = [np.trace(sample[np.ix_(p, p)]) / np.trace(target[np.ix_(p, p)]) for p in self.parts]
        scale = np.sqrt(np.repeat(self.factors, [len(part) for part in self.parts]))
        aim = target * scale * scale[:, None]
        scatter = np.sum([((len(z) * np.outer(one, one) - sample) ** 2).sum() for one in z]) / len(z) ** 2
        self.share = min(scatter / ((sample - aim) ** 2).sum(), 1.0)
        others = j[len(view) :][:, self.shared] @ self.lower
        self.prior, self.target, self.weights = others.T @ others, target, weights
        shrunk = (1 - self.share) * sample + self.share * aim + self.prior
        values, vectors = np.linalg.eigh(shrunk)
        self.covariance = self.lower @ (vectors * np.maximum(values, 1)) @ vectors.T @ self.lower.T

    def expected(self, excess: Excess) -> Array:
        """The covariance of all readings for an excess."""
        errors = np.eye(len(self.residual))
        for rows, u, strength in self.acting:
            more = (1 + excess.level) * (1 + excess.size * strength) - 1
            errors[np.ix_(rows, rows)] += (u * more) @ u.T
        return errors

    def misfit(self, excess: Excess) -> float:
        """-2 ln of the restricted likelihood from contrasts of the residuals, but for a constant."""
        values, vectors = np.linalg.eigh(self.free)
        contrasts = vectors[:, values > 0.5]
        covariance = contrasts.T @ self.expected(excess) @ contrasts
        y = contrasts.T @ self.residual
        return float(np.linalg.slogdet(covariance)[1] + len(y) * np.log(y @ np.linalg.solve(covariance, y)))

    def dof(self, at: int) -> float:
        """2 E^2 / Var of the variance of a shared unknown as a quadratic form of readings with expected errors."""
        line = self.lower[at] / np.linalg.norm(self.lower[at])
        most = int(np.argmax([(line[part] ** 2).sum() for part in self.parts]))
        part, factor = self.parts[most], self.factors[most]
        inside = np.diag(np.isin(np.arange(len(line)), part).astype(float))
        rest = self.share * (line @ self.target @ line) / np.trace(self.target[np.ix_(part, part)])
        form = (1 - self.share) * np.outer(line, line) + rest * inside
        whole = np.sum([weight.T @ form @ weight for weight in self.weights], axis=0) * factor
        whole = whole @ self.errors
        mean = np.trace(whole) + line @ self.prior @ line
        return float(2 * mean**2 / (2 * (whole * whole.T).sum()))


def power(matrix: Array, exponent: float) -> Array:
    """A power of a symmetric matrix, without the directions in which it is zero."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    kept = values > 1e-9
    return np.asarray((vectors[:, kept] * values[kept] ** exponent) @ vectors[:, kept].T)


def seen_in_part() -> problems.Problem:
    """Targets of which each image shows two thirds, so that only the lens is common to all images."""
    problem = problems.with_control()
    group = problem.groups[0]
    index = group.observations.index
    part = group.selected((index[camera.TARGET] + index[camera.VIEW]) % 3 > 0)
    return problems.Problem(problem.blocks, (part, *problem.groups[1:]), problem.datum)


CASES: dict[str, tuple[Callable[[], problems.Problem], tuple[str, ...]]] = {
    "poses eliminated": (lambda: bent(problems.board_camera()), ()),
    "targets eliminated": (lambda: bent(problems.with_control()), ()),
    "lens apart from targets in all images": (lambda: bent(problems.with_control()), (camera.LENS,)),
    "poses eliminated, lens apart from targets": (lambda: bent(problems.with_control(16)), (camera.LENS,)),
    "targets in some images": (lambda: bent(seen_in_part()), ()),
    "with scale bars": (lambda: bent(problems.with_scale_bars()), ()),
    "white": (problems.board_camera, ()),
}


@pytest.fixture(scope="module", params=CASES)
def both(request: pytest.FixtureRequest) -> tuple[ClusterRobust, Plain]:
    made, first = CASES[request.param]
    problem = made()
    found = robust(problem, *first)
    return found, Plain(found, problem, first)


def of_shared(found: ClusterRobust, plain: Plain) -> Array:
    names = list(found.white.blocks)
    whole = found.solution.joint([name for name in names if found.white.blocks[name].free.any()])
    return np.asarray(whole[np.ix_(plain.shared, plain.shared)])


def test_the_covariance_is_that_of_whole_matrices(both: tuple[ClusterRobust, Plain]) -> None:
    found, plain = both
    size = np.sqrt(np.diag(plain.covariance))
    assert abs((of_shared(found, plain) - plain.covariance) / size / size[:, None]).max() < 1e-5
    assert found.sample.factors == pytest.approx(plain.factors, rel=1e-5)
    assert found.sample.shrinkage == pytest.approx(plain.share, rel=1e-4)


def test_the_expected_errors_are_the_most_likely(both: tuple[ClusterRobust, Plain]) -> None:
    found, plain = both
    excess = found.sample.excess
    least = plain.misfit(excess)
    for change in (0.7, 1.4):
        # where readings see the first unknowns in all directions, the level is that of all errors and changes nothing
        assert plain.misfit(Excess((1 + excess.level) * change - 1, excess.size)) > least - 1e-6 or excess.level == 0
        assert plain.misfit(Excess(excess.level, excess.size * change)) > least or excess.size == 0
    assert least <= plain.misfit(Excess()) + 1e-9


@pytest.mark.alike
def test_degrees_of_freedom_are_those_of_the_quadratic_form(both: tuple[ClusterRobust, Plain]) -> None:
    found, plain = both
    names = [name for name, *_ in plain.places]
    for block in (camera.LENS, camera.TARGET):
        places = [at for at, shared in enumerate(np.flatnonzero(plain.shared)) if names[shared] == block][:12]
        assert found.dof([block])[:12] == pytest.approx([plain.dof(at) for at in places], rel=1e-3)


def test_the_lens_has_its_own_factor_where_images_show_other_targets() -> None:
    found = robust(bent(seen_in_part())).sample
    assert [part.stop - part.start for part in found.parts] == [7, 3 * (len(problems.CUBE) - 4)]
    assert len(robust(bent(problems.board_camera())).sample.parts) == 1


def test_the_lens_has_its_own_factor_where_all_images_show_all_targets() -> None:
    problem = bent(problems.with_control())
    assert len(robust(problem).sample.parts) == 1
    lens = robust(problem, camera.LENS).sample.parts[0]
    assert lens.stop - lens.start == 7


def test_poses_take_over_what_the_shared_unknowns_have() -> None:
    """`pose = noise + K lens`: their covariance with the lens is K times that of the lens, in both solutions."""
    found = robust(bent(problems.board_camera()))
    size = found.white.blocks[camera.LENS].size
    regression = []
    for solution in (found.white, found.solution):
        known = solution.covariance_or_raise()
        regression.append(known.between(camera.VIEW, camera.LENS) @ np.linalg.inv(known.of(camera.LENS)))
        assert regression[-1].shape == (8 * 6, size)
    assert np.allclose(regression[0], regression[1], rtol=1e-5, atol=1e-8 * abs(regression[0]).max())
    assert found.sample.factor > 2
    rest = [
        one.covariance_or_raise().of(camera.VIEW)
        - regression[0] @ one.covariance_or_raise().between(camera.LENS, camera.VIEW)
        for one in (found.white, found.solution)
    ]
    assert np.allclose(np.diag(rest[1]), max(found.sample.factor, 1) * np.diag(rest[0]), rtol=1e-4)


def test_no_uncertainty_is_smaller_than_for_independent_errors() -> None:
    for seed in range(5):
        found = robust(problems.board_camera(seed=seed + 60))
        names = [camera.LENS, camera.VIEW]
        assert (np.linalg.eigvalsh(found.solution.joint(names) - found.white.joint(names)) > -1e-9).all()
        assert 1 - 1e-9 <= found.inflation([camera.LENS]) < 2


def test_errors_shared_in_images_are_seen() -> None:
    assert robust(bent(problems.board_camera())).inflation([camera.LENS]) > 2


def test_four_clusters_are_refused() -> None:
    with pytest.raises(UndeterminedError, match="4 clusters are too few"):
        robust(problems.board_camera(views=4))
    assert robust(problems.board_camera(views=5)).clusters == 5


@pytest.fixture(scope="module")
def lengths_in_time() -> ClusterRobust:
    """A free network of lengths whose points, with the datum on them, each belong to one of six blocks in time."""
    net = lengths.network(30, 5, seed=8)
    settings = lengths.settings()
    network = multilaterate.build(settings, Files(net.lengths(), net.point_table(), net.tracer_table()))
    group = network.lengths
    creep = 3 * group.observations.sigma[0] * np.sin(np.arange(group.observations.count) / 9)
    moved = group.with_observations(group.observations.with_readings(group.observations.readings + creep))
    solution = adjust(network.blocks.values(), [moved], network.datum)
    assert solution.covariance_or_raise().eliminated.gauge is not None
    blocks = group.observations.index[tracer.POINT] // 5
    return cluster_robust(solution, Clusters({group.name: blocks}))


def whole_matrices(found: ClusterRobust) -> tuple[Array, Array, Array, int]:
    """Derivatives, residuals and rigid motions of all unknowns (points, then tracers), and the number of the points'."""
    blocks, group = found.white.blocks, found.white.groups[0]
    places = [one for one in dense.entries(blocks) if one[0] == tracer.POINT]
    first = len(places)
    places += [one for one in dense.entries(blocks) if one[0] == tracer.TRACER]
    motions = np.zeros((len(places), 6))
    for row, (name, member, column) in enumerate(places):
        at = blocks[name].values[member, :3]
        if column < 3:
            turned = [np.cross(axis, at)[column] for axis in np.eye(3)]
            motions[row] = [*np.eye(3)[column], *turned]
    return dense.jacobian(blocks, [group], places), dense.whitened(group, blocks), motions, first


def test_members_of_one_cluster_follow_from_the_others_in_the_datum(lengths_in_time: ClusterRobust) -> None:
    """`point = noise + K tracers` in any frame, then laid onto the listed points: the whole covariance by plain matrices."""
    found = lengths_in_time
    j, _, motions, first = whole_matrices(found)
    points, others = j[:, :first], j[:, first:]
    own = np.linalg.inv(points.T @ points)
    follow = np.concatenate([-own @ points.T @ others, np.eye(others.shape[1])])
    known = follow @ found.sample.of_shared() @ follow.T
    known[:first, :first] += found.sample.own_factor * own
    datum = np.concatenate([motions[:first], np.zeros((others.shape[1], 6))])
    into = np.eye(len(known)) - motions @ np.linalg.solve(datum.T @ motions, datum.T)
    expected = into @ known @ into.T
    stated = found.solution.joint([tracer.POINT, tracer.TRACER])
    size = np.sqrt(np.diag(expected))
    assert found.sample.own_factor > 1.5
    # the datum has the motions of the listed points, which lie 20 um beside those found, in a volume of 1 m
    assert abs((stated - expected) / size / size[:, None]).max() < 2e-4
    each = found.solution.covariance_or_raise().members(tracer.POINT)
    assert each == pytest.approx(np.array([stated[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(30)]), rel=1e-9)


def test_what_blocks_change_is_that_of_whole_matrices(lengths_in_time: ClusterRobust) -> None:
    """Sum of `x x'` with `x = Q J' A r` of each block, for the tracers without rigid motion."""
    found = lengths_in_time
    j, residual, motions, first = whole_matrices(found)
    normal = j.T @ j
    scale = 1 / np.sqrt(np.diag(normal))
    q = np.linalg.pinv(normal * scale[:, None] * scale, rcond=1e-11, hermitian=True) * scale[:, None] * scale
    block = found.white.groups[0].observations.index[tracer.POINT] // 5
    total, errors, hat = np.zeros((len(q) - first,) * 2), np.eye(len(j)), j @ q @ j.T
    excess, each = found.sample.excess, [np.flatnonzero(block == at) for at in range(6)]
    for rows in each:
        # what the tracers give to the rows of a block, without its own points
        points = j[rows][:, :first]
        own = points @ np.linalg.pinv(points)
        strength, u = np.linalg.eigh(hat[np.ix_(rows, rows)] - own)
        u, strength = u[:, strength > 1e-9], strength[strength > 1e-9]
        errors[np.ix_(rows, rows)] += (u * ((1 + excess.level) * (1 + excess.size * strength) - 1)) @ u.T
    of_residuals = (np.eye(len(j)) - hat) @ errors @ (np.eye(len(j)) - hat)
    for rows in each:
        root = power(errors[np.ix_(rows, rows)], 0.5)
        weight = root @ power(root @ of_residuals[np.ix_(rows, rows)] @ root, -0.5) @ root
        x = q @ j[rows].T @ weight @ residual[rows]
        total += np.outer(x[first:], x[first:])
    still = motions[first:]
    without = np.eye(len(still)) - still @ np.linalg.pinv(still)
    stated = found.sample.root @ found.sample.empirical @ found.sample.root.T
    expected = without @ total @ without.T
    size = np.sqrt(np.diag(expected).max())
    assert abs(without @ stated @ without.T - expected).max() < 1e-4 * size**2


def test_a_direction_of_the_unknowns_may_be_left_without_information() -> None:
    """Rounding makes its information negative: of rational terms of a lens, of which two do the same."""
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(6, 6)))[0]
    known = Likelihood(turn[:3] * (1 + 1e-12), np.full(6, 1e16), turn[3], 20.0, 30.0)
    assert np.isfinite(known.misfit(Excess(0.0, 1.0)))
    assert np.isfinite(most_likely(known).at(known.strength)).all()
