"""Starting values of tracers: where they stand and their dead paths, from lengths to points roughly known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_STEPS = 60
_FLAT = 1e-4
"""Points thinner than this share of their extent are taken as one plane"""
_AS_GOOD, _ROUNDING = 1.5, 1e-9
"""A place fits as well as the best where its misfit is not larger by more than this"""
_DRAWS, _COMPARED, _ENOUGH = 60, 300, 12
"""Draws of a few lengths, the lengths that they are compared by, and how many a tracer needs for it"""
_GROSS, _ROUNDS = 12.0, 30
"""Lengths that miss by this many times the median are held off; by so many rounds of reweighting at most"""
_STILL = 1e-7
"""Change by a round, as a share, below which the next would change nothing"""


def start(points: Array, lengths: Array, absolute: bool = False, near: Array | None = None) -> Array:
    """Return (x0, y0, z0, dead path) of one tracer from lengths (n,) to points (n, 3); nan where they do not tell.

    Squaring `l + l0 = |x - x0|` gives `|x|^2 - l^2 = 2 x.x0 + 2 l l0 - (|x0|^2 - l0^2)`, linear in five unknowns;
    points in one plane leave two mirrored places. All are refined by Gauss-Newton steps, and so is the place `near`
    which the tracer is said to be; of those that fit as well as the best, the nearest to it is taken. Where some
    lengths are far off, the sum of |v| is minimised, which they do not spoil.
    """
    centre = points.mean(axis=0)
    local = points - centre
    scale = float(np.abs(local).max()) or 1.0
    local, reading = local / scale, lengths / scale
    guesses = _guesses(local, reading, absolute)
    said = None if near is None else (near - centre) / scale
    if said is not None:
        dead = 0.0 if absolute else float(np.median(np.linalg.norm(local - said, axis=1) - reading))
        guesses.append(np.array([*said, dead]))
    candidates = [_refined(local, reading, guess, absolute) for guess in guesses]
    if not candidates:
        return np.full(4, np.nan)
    least = min(misfit for _, misfit in candidates)
    good = [state for state, misfit in candidates if misfit <= _AS_GOOD * least + _ROUNDING]
    best = good[0] if said is None else min(good, key=lambda state: float(np.linalg.norm(state[:3] - said)))
    return np.concatenate([best[:3] * scale + centre, best[3:] * scale])


def _guesses(local: Array, reading: Array, absolute: bool) -> list[Array]:
    _, spread, axes = np.linalg.svd(local, full_matrices=False)
    rank = int((spread > _FLAT * spread[0]).sum())
    plane = local @ axes[:rank].T
    columns = [2 * plane, *([] if absolute else [2 * reading[:, None]]), -np.ones((len(local), 1))]
    matrix = np.concatenate(columns, axis=1)
    if len(local) < matrix.shape[1]:
        return []
    solved = np.linalg.lstsq(matrix, (local**2).sum(axis=1) - reading**2, rcond=None)[0]
    inside, dead, constant = solved[:rank], 0.0 if absolute else float(solved[rank]), float(solved[-1])
    across = np.sqrt(max(constant + dead**2 - float(inside @ inside), 0.0))
    guesses = []
    for sign in (1.0, -1.0) if rank < 3 else (0.0,):
        place = inside @ axes[:rank]
        if rank < 3:
            place = place + sign * max(across, 0.1) * (axes[rank] if rank < len(axes) else np.array([0.0, 0.0, 1.0]))
        guesses.append(np.array([*place, dead]))
    if rank == 3 and len(local) >= _ENOUGH:
        guesses.append(_unspoiled(local, reading, absolute))
    return guesses


def _unspoiled(local: Array, reading: Array, absolute: bool) -> Array:
    """Return the place and dead path of the few lengths whose solution the others miss least, by the median.

    Lengths that are far off spoil the linear equations, whose unknowns they multiply; few that are drawn are mostly
    free of them (Rousseeuw 1984, least median of squares).
    """
    rng, n = np.random.default_rng(0), len(local)
    rows = rng.integers(n, size=(_DRAWS, 7))
    known, last = reading[rows][:, :, None], -np.ones((*rows.shape, 1))
    matrix = np.concatenate([2 * local[rows], *([] if absolute else [2 * known]), last], axis=2)
    right = (local[rows] ** 2).sum(axis=2) - reading[rows] ** 2
    states = (np.linalg.pinv(matrix) @ right[:, :, None])[:, :, 0]
    states[:, 3] *= not absolute
    some = np.linspace(0, n - 1, min(n, _COMPARED)).astype(int)
    miss = reading[some] + states[:, 3:4] - np.linalg.norm(local[some] - states[:, None, :3], axis=2)
    return np.asarray(states[np.argmin(np.median(np.abs(miss), axis=1)), :4])


def _weights(residual: Array) -> Array:
    """Return what residuals are multiplied by so that squares become |v|; 1 where none is far off."""
    miss = np.abs(residual)
    middle = max(float(np.median(miss)), _ROUNDING)
    if miss.max() <= _GROSS * middle:
        return np.ones(len(miss))
    return np.asarray(np.sqrt(middle / np.maximum(miss, middle)))


def _refined(local: Array, reading: Array, guess: Array, absolute: bool) -> tuple[Array, float]:
    """Return the solution near a guess and its mean |residual|, with lengths that are far off held off in both."""
    state = guess
    for turn in range(_ROUNDS):
        before, weights = state, _weights(_residual(local, reading, state, absolute)[0])
        if turn and (weights == 1).all():
            break
        state = _descended(local, reading, state, absolute, weights)
        if np.abs(state - before).max() < _STILL:
            break
    miss = np.abs(_residual(local, reading, state, absolute)[0])
    return state, float(np.minimum(miss, _GROSS * np.median(miss) + _ROUNDING).mean())


def _descended(local: Array, reading: Array, guess: Array, absolute: bool, weights: Array) -> Array:
    """Return the least squares solution near a guess, by damped Gauss-Newton steps; weights (n,) of the residuals."""
    state, damping = guess.copy(), 0.0
    residual, jacobian = _residual(local, reading, state, absolute, weights)
    for _ in range(_STEPS):
        normal = jacobian.T @ jacobian
        normal[np.diag_indices_from(normal)] += damping * np.diag(normal) + 1e-15
        step = np.zeros(4)
        step[: jacobian.shape[1]] = np.linalg.lstsq(normal, jacobian.T @ residual, rcond=None)[0]
        moved, by = _residual(local, reading, state + step, absolute, weights)
        if moved @ moved <= residual @ residual:
            state, residual, jacobian, damping = state + step, moved, by, damping / 10
            if np.abs(step).max() < 1e-13:
                break
        else:
            damping = max(10 * damping, 1e-6)
    return state


def _residual(
    local: Array, reading: Array, state: Array, absolute: bool, weights: Array | float = 1.0
) -> tuple[Array, Array]:
    """Return `l + l0 - |x - x0|` and the derivatives of the prediction by the free unknowns, times the weights."""
    away = local - state[:3]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    towards = -away / distance[:, None]
    jacobian = towards if absolute else np.column_stack([towards, -np.ones(len(distance))])
    return weights * (reading + state[3] - distance), (weights * jacobian.T).T
