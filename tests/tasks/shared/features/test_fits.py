"""Features of least squares and of the minimum zone against published values and independent computations."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares as minpack
from scipy.optimize import minimize
from simulated.features import AXES, Array, cloud

from metrocli.errors import UndeterminedError
from metrocli.tasks.shared.features.fit import FeatureFit, least_squares
from metrocli.tasks.shared.features.ideal import IdealFeature
from metrocli.tasks.shared.features.minimum_zone import minimum_zone

PIPE = """-3283.654 -79.927 194.917  -3271.578 -84.991 203.643  -3292.599 -64.647 196.517  -3308.806 -73.417 213.805
-3301.555 -87.819 210.971  -3289.428 -79.973 198.027  -3292.505 -57.849 200.595  -3303.342 -63.362 213.794"""
"""Eight points on a pipe; OpenIndy, test testVRadial of its plug-in of fits: radius 19.16, deviations to 1 um"""
PIPE_DEVIATIONS = np.array([0.026, -0.007, -0.037, 0.010, -0.003, -0.007, 0.030, -0.012])
TUBE = """10.50 0.50 1 9.13 5.49 1 5.48 9.13 1 0.50 10.53 1 -4.49 9.14 1 -8.13 5.49 1 -9.45 0.50 1 -8.18 -4.51 1
-4.52 -8.19 1 0.50 -9.47 1 5.51 -8.17 1 9.13 -4.48 1 10.69 3.60 50 8.07 8.07 50 3.58 10.64 50 -1.60 10.70 50
-6.05 8.05 50 -8.65 3.59 50 -8.70 -1.60 50 -6.05 -6.05 50 -1.59 -8.65 50 3.59 -8.67 50 8.05 -6.05 50 10.68 -1.59 50
10.27 3.66 100 7.57 8.06 100 3.00 10.48 100 -2.16 10.27 100 -6.57 7.58 100 -8.98 3.00 100 -8.83 -2.18 100
-6.04 -6.53 100 -1.49 -8.94 100 3.68 -8.84 100 8.05 -6.06 100 10.51 -1.50 100"""
"""Three sections of a tube; OpenIndy, test testBestFitCylinder5: radius 10.00, direction 0.999993, s = 0.197"""


def published(text: str) -> Array:
    return np.array(text.split(), dtype=float).reshape(-1, 3)


def test_a_published_cylinder_is_found() -> None:
    fit = least_squares(IdealFeature.CYLINDER, published(PIPE))
    assert fit.ideal.radius == pytest.approx(19.16, abs=0.005)
    assert fit.deviations == pytest.approx(PIPE_DEVIATIONS, abs=6e-4)


def test_a_published_tube_is_found() -> None:
    fit = least_squares(IdealFeature.CYLINDER, published(TUBE))
    assert fit.ideal.radius == pytest.approx(10.00, abs=0.01)
    assert fit.ideal.axis[2] == pytest.approx(0.999993, abs=1e-6)
    assert np.sqrt((fit.deviations**2).sum() / (36 - 5)) == pytest.approx(0.197, abs=5e-4)


def angles(vector: Array) -> Array:
    """Polar angle and azimuth of a direction."""
    return np.array([np.arccos(vector[2] / np.linalg.norm(vector)), np.arctan2(vector[1], vector[0])])


def distances(shape: IdealFeature, values: Array, points: Array) -> Array:
    """Distances by the textbook: values are a point, polar angle and azimuth, radius, half angle."""
    axis = np.array([np.sin(values[3]) * np.cos(values[4]), np.sin(values[3]) * np.sin(values[4]), np.cos(values[3])])
    away = points - values[:3]
    height, radial = away @ axis, np.linalg.norm(np.cross(away, axis), axis=1)
    return {
        IdealFeature.LINE: radial,
        IdealFeature.PLANE: height,
        IdealFeature.CIRCLE: np.concatenate([radial - values[5], height]),
        IdealFeature.SPHERE: np.linalg.norm(away, axis=1) - values[5],
        IdealFeature.CYLINDER: radial - values[5],
        IdealFeature.CONE: (radial - values[5]) * np.cos(values[6]) - height * np.sin(values[6]),
    }[shape]


def parameters(fit: FeatureFit) -> Array:
    return np.array([*fit.ideal.origin, *angles(fit.ideal.axis), fit.ideal.radius, fit.ideal.half_angle])


@pytest.mark.alike
@pytest.mark.parametrize("shape", IdealFeature)
def test_least_squares_are_those_of_minpack(shape: IdealFeature) -> None:
    """Another parametrisation, another program, starts that are off: the same sum of squares and deviations."""
    rng = np.random.default_rng(list(IdealFeature).index(shape) + 50)
    points = cloud(shape, 30, 0.05, rng)
    fit = least_squares(shape, points)
    start = parameters(fit) + np.array([0.3, -0.2, 0.25, 0.01, -0.01, 0.2, 0.01])
    found = minpack(lambda p: distances(shape, p, points), start, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=4000)
    own = distances(shape, parameters(fit), points)
    assert (own**2).sum() == pytest.approx((found.fun**2).sum(), rel=1e-9)
    assert (own**2).sum() <= (found.fun**2).sum() * (1 + 1e-12)
    assert fit.deviations == pytest.approx(distances(shape, found.x, points)[:30], abs=1e-5)


@pytest.mark.parametrize("shape", IdealFeature)
def test_points_of_an_ideal_feature_give_it_back(shape: IdealFeature) -> None:
    """Whatever its direction: also along the axes of the frame."""
    for axis in AXES[1:]:
        rng = np.random.default_rng(7)
        points = cloud(shape, 24, 0.0, rng, axis, radius=30.0, half_angle=0.3)
        for fit in (least_squares(shape, points), minimum_zone(shape, points)):
            assert fit.form < 1e-10
            if shape in (IdealFeature.SPHERE, IdealFeature.CIRCLE, IdealFeature.CYLINDER):
                assert fit.ideal.radius == pytest.approx(30.0, abs=1e-10)
            if shape is IdealFeature.CONE:
                assert fit.ideal.half_angle == pytest.approx(0.3, abs=1e-11)
            if shape is not IdealFeature.SPHERE:
                assert abs(fit.ideal.axis @ axis) == pytest.approx(1.0, abs=1e-12)


def width(values: Array) -> Array:
    return np.asarray(np.ptp(values, axis=-1))


def pairs(points: Array) -> tuple[Array, Array]:
    """Differences and midpoints of all pairs."""
    first, second = (points[list(rows)] for rows in zip(*itertools.combinations(range(len(points)), 2), strict=True))
    return first - second, (first + second) / 2


@pytest.mark.parametrize("seed", range(4))
def test_the_zone_of_a_plane_is_the_least_of_all_candidates(seed: int) -> None:
    """Its normal is square to two pairs of points: three points on one side and one, or two and two."""
    points = cloud(IdealFeature.PLANE, 14, 0.05, np.random.default_rng(seed))
    lines, _ = pairs(points)
    i, j = np.triu_indices(len(lines), 1)
    normals = np.cross(lines[i], lines[j])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    normals = normals[np.linalg.norm(normals, axis=1) > 0.5]
    assert minimum_zone(IdealFeature.PLANE, points).form == pytest.approx(width(normals @ points.T).min(), abs=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_the_zone_of_a_circle_is_the_least_of_all_candidates(seed: int) -> None:
    """Its centre has the same distance from the points of two pairs."""
    rng = np.random.default_rng(seed)
    points = cloud(IdealFeature.CIRCLE, 14, 0.05, rng, np.array([0.0, 0, 1]), flat=True)
    lines, middles = pairs(points[:, :2])
    i, j = np.triu_indices(len(lines), 1)
    matrix, wanted = np.stack([lines[i], lines[j]], axis=1), (lines * middles).sum(axis=1)
    good = np.abs(np.linalg.det(matrix)) > 1e-9
    wanted = np.stack([wanted[i], wanted[j]], axis=1)
    centres = np.linalg.solve(matrix[good], wanted[good][:, :, None])[:, :, 0]
    zones = width(np.linalg.norm(points[None, :, :2] - centres[:, None], axis=2))
    assert minimum_zone(IdealFeature.CIRCLE, points).form == pytest.approx(zones.min(), abs=1e-10)


def test_the_zone_of_a_sphere_is_the_least_of_all_candidates() -> None:
    """Its centre has the same distance from the points of three pairs."""
    points = cloud(IdealFeature.SPHERE, 10, 0.05, np.random.default_rng(3))
    lines, middles = pairs(points)
    chosen = np.array(list(itertools.combinations(range(len(lines)), 3)))
    good = np.abs(np.linalg.det(lines[chosen])) > 1e-6
    wanted = (lines * middles).sum(axis=1)[chosen[good]]
    centres = np.linalg.solve(lines[chosen[good]], wanted[:, :, None])[:, :, 0]
    zones = width(np.linalg.norm(points[None] - centres[:, None], axis=2))
    assert minimum_zone(IdealFeature.SPHERE, points).form == pytest.approx(zones.min(), abs=1e-10)


@pytest.mark.alike
@pytest.mark.parametrize("shape", [IdealFeature.LINE, IdealFeature.CYLINDER, IdealFeature.CONE])
@pytest.mark.parametrize("seed", range(1))
def test_no_other_program_finds_a_smaller_zone(shape: IdealFeature, seed: int) -> None:
    """SLSQP on the textbook distances, from two starts around the least squares."""
    rng = np.random.default_rng(seed)
    points = cloud(shape, 20, 0.05, rng)
    fit, plain = minimum_zone(shape, points), least_squares(shape, points)
    sides = (1,) if shape is IdealFeature.LINE else (1, -1)

    def left(p: Array) -> Array:
        return np.concatenate([p[7] - side * 20 * distances(shape, p[:7], points) for side in sides])

    found = []
    for _ in range(2):
        off = 0.02 * rng.normal(size=7) * [1, 1, 1, 0.02, 0.02, 1, 0.02]
        start = np.append(parameters(plain) + off, 20 * plain.form)
        bounds = [(None, None)] * 5 + ([(None, None)] * 2 if shape is IdealFeature.CONE else [(None, None), (0.0, 0.0)])
        if shape is not IdealFeature.CONE:
            start[6] = 0.0
        options = {"ftol": 1e-14, "maxiter": 600}
        solved = minimize(
            lambda p: p[7], start, constraints={"type": "ineq", "fun": left}, bounds=[*bounds, (None, None)],
            options=options,
        )  # fmt: skip
        found.append(2 * np.abs(distances(shape, solved.x[:7], points)).max())
    assert fit.form <= min(found) + 1e-9
    assert fit.form == pytest.approx(min(found), rel=2e-3)


@pytest.mark.alike
@pytest.mark.parametrize("shape", IdealFeature)
def test_the_points_in_contact_prove_the_zone(shape: IdealFeature) -> None:
    """Weighted by the contact, the gradients by differences of the textbook distances add up to zero."""
    points = cloud(shape, 25, 0.02, np.random.default_rng(11))
    fit = minimum_zone(shape, points)
    assert fit.contact is not None
    level = np.abs(fit.deviations[fit.contact.rows])
    assert np.ptp(level) < 1e-11 and level.max() >= np.abs(fit.deviations).max() - 1e-11
    assert fit.contact.weights.min() > 0 and fit.contact.weights.sum() == pytest.approx(1)
    assert np.sign(fit.deviations[fit.contact.rows]) == pytest.approx(fit.contact.sides)
    assert fit.form < least_squares(shape, points).form
    values, at = parameters(fit), points[fit.contact.rows]
    free = [0, 1, 2, 3, 4, 5, 6] if shape is IdealFeature.CONE else [0, 1, 2, 3, 4, 5]
    if shape is IdealFeature.CIRCLE:
        free = [5]
    for one in np.eye(7)[free]:
        change = distances(shape, values + 1e-5 * one, at) - distances(shape, values - 1e-5 * one, at)
        assert abs(fit.contact.weights * fit.contact.sides @ change[: len(at)]) / 2e-5 < 1e-5 * 100


@pytest.mark.alike
@pytest.mark.parametrize(
    ("number", "seed"), [pytest.param(5, 84, marks=pytest.mark.slow), (6, 166), (6, 230), (6, 321), (6, 478), (6, 783)]
)
def test_a_line_that_two_points_nearly_hold_has_its_least_zone(number: int, seed: int) -> None:
    """Two points at almost one height share nearly all of the weight: no line nearby has a smaller zone."""
    points = cloud(IdealFeature.LINE, number, 0.005, np.random.default_rng(seed))
    fit, rng = minimum_zone(IdealFeature.LINE, points), np.random.default_rng(1)
    values = parameters(fit)
    assert fit.form == pytest.approx(2 * distances(IdealFeature.LINE, values, points).max(), abs=1e-10)
    for size in (1e-5, 1e-4, 1e-3, 1e-2):
        for off in size * rng.normal(size=(500, 7)) * [1, 1, 1, 0.03, 0.03, 0, 0]:
            assert 2 * distances(IdealFeature.LINE, values + off, points).max() > fit.form - 1e-10


@pytest.mark.alike
@pytest.mark.parametrize("fitted", [least_squares, minimum_zone])
@pytest.mark.parametrize("shape", IdealFeature)
def test_a_feature_follows_its_points_as_stated(fitted, shape: IdealFeature) -> None:  # type: ignore[no-untyped-def]
    """The derivative of place, direction, radius, angle and form, against fits of points that are moved."""
    points = cloud(shape, 15, 0.005, np.random.default_rng(21))
    fit = fitted(shape, points)
    stated = fit.by_points(points)
    row = 0 if fit.contact is None else int(fit.contact.rows[0])
    for axis in (0, 2):
        ends = []
        for step in (1e-6, -1e-6):
            moved = points.copy()
            moved[row, axis] += step
            one = fitted(shape, moved)
            ends.append(np.append(np.real(one.ideal.numbers(moved.mean(axis=0))), one.form))
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(stated[:, row, axis], abs=2e-4)


def test_points_that_leave_a_feature_open_are_refused() -> None:
    turn = np.linspace(0, 6, 9)
    ring = np.column_stack([20 * np.cos(turn), 20 * np.sin(turn), np.zeros(9)])
    with pytest.raises(UndeterminedError, match="the 9 points do not determine a cylinder"):
        least_squares(IdealFeature.CYLINDER, ring)
    with pytest.raises(UndeterminedError, match="do not determine a plane"):
        least_squares(IdealFeature.PLANE, np.outer(np.arange(5.0), [1, 2, 3]))
    with pytest.raises(UndeterminedError, match="a sphere needs 4 points, and there are 3"):
        least_squares(IdealFeature.SPHERE, ring[:3])
