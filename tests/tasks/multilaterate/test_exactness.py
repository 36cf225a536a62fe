"""Coordinates and covariance are those of the bordered normal equations (Härtig et al. eq. 10), in any datum."""

from __future__ import annotations

import numpy as np
import pytest
from simulated.lengths import NOISE, Network, network, places, settings

from metrocli.result import Result
from metrocli.tasks.multilaterate import task as multilaterate

Wide = np.typing.NDArray[np.longdouble]
CASES = [pytest.param(m, scale, marks=pytest.mark.slow if m == 6 else ()) for m in (4, 5, 6) for scale in (None, 5e-7)]


def inverse(matrix: Wide) -> Wide:
    """Gauss-Jordan with complete rows in extended precision (numpy's own stops at double)."""
    n = len(matrix)
    size = np.sqrt(np.maximum(np.abs(matrix).max(axis=1), 1e-300))
    work = np.concatenate([matrix / size[:, None] / size, np.eye(n, dtype=np.longdouble)], axis=1)
    for k in range(n):
        pivot = k + int(np.argmax(np.abs(work[k:, k])))
        work[[k, pivot]] = work[[pivot, k]]
        work[k] /= work[k, k]
        others = np.arange(n) != k
        work[others] -= work[others, k][:, None] * work[k]
    found: Wide = work[:, n:] / size[:, None] / size
    return found


def dense(net: Network, scale: float | None) -> tuple[Wide, Wide, float]:
    """Points, their covariance and the sum of squares by eq. 10 in extended precision, weights from the last paths."""
    n, m = net.readings.shape
    wide = np.longdouble
    read = net.readings.astype(wide)
    nominal = net.nominal.astype(wide)
    x, x0 = nominal.copy(), net.tracers.astype(wide)
    dead, s = (
        (np.linalg.norm(net.points[:, None] - net.tracers, axis=2) - net.readings).mean(axis=0).astype(wide),
        np.ones(m, wide),
    )
    k = 5 if scale is not None else 4
    g = np.zeros((3 * n + k * m, 6), wide)
    for i in range(n):
        g[3 * i : 3 * i + 3, :3] = np.eye(3)
        a, b, c = nominal[i]
        g[3 * i : 3 * i + 3, 3:] = np.array([[-b, c, 0], [a, 0, -c], [0, -a, b]])
    for _ in range(12):
        away = x[:, None] - x0
        distance = np.sqrt((away**2).sum(axis=2))
        weight = 1 / (wide(NOISE.constant) ** 2 + (wide(NOISE.proportional) * (read + dead)) ** 2)
        jacobian = np.zeros((n * m + (m if scale else 0), 3 * n + k * m), wide)
        residual = np.concatenate([(read + dead - s * distance).ravel(), 1 - s if scale else np.zeros(0, wide)])
        p = np.concatenate([weight.ravel(), np.full(m, 1 / wide(scale) ** 2) if scale else np.zeros(0, wide)])
        for i in range(n):
            for j in range(m):
                unit = s[j] * away[i, j] / distance[i, j]
                row = i * m + j
                jacobian[row, 3 * i : 3 * i + 3] = unit
                jacobian[row, 3 * n + k * j : 3 * n + k * j + 3] = -unit
                jacobian[row, 3 * n + k * j + 3] = -1
                if scale:
                    jacobian[row, 3 * n + k * j + 4] = distance[i, j]
        if scale:
            for j in range(m):
                jacobian[n * m + j, 3 * n + k * j + 4] = 1
        normal = (jacobian.T * p) @ jacobian
        zero = np.zeros((6, 6), wide)
        bordered = inverse(np.block([[normal, g], [g.T, zero]]))
        shift = np.concatenate([(x - nominal).ravel(), np.zeros(k * m, wide)])
        right = np.concatenate([(jacobian.T * p) @ residual, -g.T @ shift])
        step = (bordered @ right)[: 3 * n + k * m]
        x = x + step[: 3 * n].reshape(n, 3)
        of_tracers = step[3 * n :].reshape(m, k)
        x0, dead = x0 + of_tracers[:, :3], dead + of_tracers[:, 3]
        if scale:
            s = s + of_tracers[:, 4]
    return x, bordered[: 3 * n, : 3 * n], float((p * residual**2).sum())


def rounding_of_chi2(net: Network, chi2: float) -> float:
    """Bound of what the last digit of each length changes chi2 by: `2 |v| |L eps|`, both whitened (Cauchy-Schwarz)."""
    lengths = net.readings[np.isfinite(net.readings)]
    sigma = np.hypot(NOISE.constant, NOISE.proportional * lengths)
    return 2 * np.sqrt(chi2) * float(np.linalg.norm(np.finfo(float).eps * lengths / sigma))


def run(net: Network, scale: float | None) -> Result:
    return multilaterate.run(multilaterate.TASK.job(settings(scale), net.lengths(), net.point_table()))


@pytest.mark.alike
@pytest.mark.parametrize(("m", "scale"), CASES)
def test_as_the_bordered_equations_in_extended_precision(m: int, scale: float | None) -> None:
    net = network(30, m, seed=m, scale=scale or 0.0)
    points, covariance, cost = dense(net, scale)
    result = run(net, scale)
    assert np.abs(places(result.tables["points"]) - points).max() < 1e-9
    each = result.arrays["points_covariance"]
    expected = np.array([covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(30)], dtype=float)
    assert np.abs(each - expected).max() < 1e-6 * np.abs(expected).max()
    assert np.abs(each / expected - 1)[:, range(3), range(3)].max() < 1e-6
    assert result.statistics["chi2"] == pytest.approx(cost, rel=0, abs=rounding_of_chi2(net, cost))


@pytest.mark.alike
@pytest.mark.parametrize(("m", "scale"), CASES)
def test_residuals_do_not_depend_on_the_datum(m: int, scale: float | None) -> None:
    net = network(30, m, seed=10 + m, scale=scale or 0.0)
    inner = run(net, scale)
    moved = net.nominal + np.random.default_rng(1).normal(0, 0.05, net.nominal.shape)
    other = multilaterate.run(
        multilaterate.TASK.job(
            settings(scale), net.lengths(), type(net)(**{**vars(net), "nominal": moved}).point_table()
        )
    )
    sigma = {name: np.full(30, np.nan) for name in ("sigma_x", "sigma_y", "sigma_z")}
    for point, axes in ((0, "xyz"), (1, "xy"), (2, "x")):
        for axis in axes:
            sigma[f"sigma_{axis}"][point] = 0.0
    # six coordinates that hold the frame and no more
    fixed = multilaterate.run(multilaterate.TASK.job(settings(scale), net.lengths(), net.point_table(**sigma)))
    chi2 = inner.statistics["chi2"]
    for found in (other, fixed):
        assert found.statistics["chi2"] == pytest.approx(chi2, rel=0, abs=rounding_of_chi2(net, chi2))
        assert found.statistics["dof"] == inner.statistics["dof"]
        for column, tolerance in (("residual", 1e-9), ("redundancy", 1e-6), ("normalised", 1e-4)):
            gap = found.tables["residuals"].numbers(column) - inner.tables["residuals"].numbers(column)
            assert np.abs(gap).max() < tolerance, column
    assert np.abs(places(fixed.tables["points"])[0] - net.nominal[0]).max() == 0
    assert not np.allclose(places(fixed.tables["points"]), places(inner.tables["points"]), atol=1e-4)


def test_the_frame_is_the_nominal_points() -> None:
    """Eq. 8: the corrections have no shift and no turn in common."""
    net = network(30, 5, seed=3)
    step = places(run(net, None).tables["points"]) - net.nominal
    assert np.abs(step.sum(axis=0)).max() < 1e-10
    assert np.abs(np.cross(net.nominal, step).sum(axis=0)).max() < 1e-6
