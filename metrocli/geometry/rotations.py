"""Rotations and angles."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array


def wrapped(angle: Array | float) -> Array:
    """Return an angle [rad] within -pi ... pi."""
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)), dtype=float)


_SMALL = 1e-5
"""Below this angle [rad] series of two terms are exact to double precision."""
_IDENTITY = np.eye(3)


def cross_matrix(vector: Array) -> Array:
    """Return the matrix [v]x with `[v]x w = v x w`, (..., 3) -> (..., 3, 3)."""
    vector = np.asarray(vector, dtype=float)
    matrix = np.zeros((*vector.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., k, j], matrix[..., j, k] = vector[..., i], -vector[..., i]
    return matrix


def rotation_from_vector(vector: Array) -> Array:
    """Return `R = Exp(v) = I + sin(t)/t [v]x + (1 - cos t)/t^2 [v]x^2`, t = |v|, (..., 3) -> (..., 3, 3)."""
    vector = np.asarray(vector, dtype=float)
    angle = _length(vector)[..., None, None]
    cross = cross_matrix(vector)
    return _IDENTITY + _sine_ratio(angle) * cross + _cosine_ratio(angle) * (cross @ cross)


def vector_from_rotation(rotation: Array) -> Array:
    """Return the rotation vector v, |v| <= pi, with `Exp(v) = R`, (..., 3, 3) -> (..., 3)."""
    quaternion = _quaternion(np.asarray(rotation, dtype=float))
    axis = quaternion[..., 1:]
    sine = _length(axis)
    angle = 2 * np.arctan2(sine, quaternion[..., 0])
    # angle / sin(angle / 2) for small angles is 2 + s^2 / 3 with s = sin(angle / 2)
    ratio = np.where(sine > _SMALL, angle / np.where(sine > _SMALL, sine, 1.0), 2.0 + sine**2 / 3)
    vector: Array = axis * ratio[..., None]
    return vector


def rotation_from_euler(alpha: Array | float, beta: Array | float, gamma: Array | float) -> Array:
    """Return `R = Rz(gamma) Ry(beta) Rx(alpha)`, angles in rad (...,) -> (..., 3, 3) (Mendikute eq. 2)."""
    alpha, beta, gamma = np.broadcast_arrays(alpha, beta, gamma)
    ca, sa, cb, sb, cg, sg = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta), np.cos(gamma), np.sin(gamma)
    return np.stack(
        [
            np.stack([cg * cb, cg * sb * sa - sg * ca, cg * sb * ca + sg * sa], -1),
            np.stack([sg * cb, sg * sb * sa + cg * ca, sg * sb * ca - cg * sa], -1),
            np.stack([-sb, cb * sa, cb * ca], -1),
        ],
        -2,
    )


def euler_from_rotation(rotation: Array) -> Array:
    """Return (alpha, beta, gamma) in rad with `R = Rz(gamma) Ry(beta) Rx(alpha)`, (..., 3, 3) -> (..., 3).

    At beta = +-90 degrees alpha and gamma act alike; gamma is then set to 0. alpha is that of `Rz(gamma)' R`, so that
    what rounding takes from gamma near there goes into alpha.
    """
    rotation = np.asarray(rotation, dtype=float)
    cosine = np.hypot(rotation[..., 0, 0], rotation[..., 1, 0])
    beta = np.arctan2(-rotation[..., 2, 0], cosine)
    gamma = np.where(cosine > 1e-15, np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]), 0.0)
    c, s = np.cos(gamma), np.sin(gamma)
    alpha = np.arctan2(
        s * rotation[..., 0, 2] - c * rotation[..., 1, 2], c * rotation[..., 1, 1] - s * rotation[..., 0, 1]
    )
    return np.stack([alpha, beta, gamma], -1)


def euler_by_vector(rotation: Array) -> Array:
    """Return d(alpha, beta, gamma) / d(d) of `Exp(d) R` at d = 0, (..., 3, 3) -> (..., 3, 3).

    From `d = Rz Ry x' da + Rz y' db + z' dg`: the inverse of the matrix of the three axes of turning.
    """
    _, beta, gamma = np.moveaxis(euler_from_rotation(rotation), -1, 0)
    zero, ones = np.zeros_like(beta), np.ones_like(beta)
    cb, sb, cg, sg = np.cos(beta), np.sin(beta), np.cos(gamma), np.sin(gamma)
    turning = np.stack(
        [np.stack([cg * cb, -sg, zero], -1), np.stack([sg * cb, cg, zero], -1), np.stack([-sb, zero, ones], -1)], -2
    )
    return np.linalg.inv(turning)


def vector_by_left_turn(vector: Array) -> Array:
    """Return d Log(Exp(d) Exp(v)) / d(d) at d = 0: the inverse left Jacobian, (..., 3) -> (..., 3, 3).

    `J^-1 = I - [v]x/2 + (1/t^2 - (1 + cos t)/(2 t sin t)) [v]x^2`, t = |v|.
    """
    vector = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    # below it `1/t^2 - ...` is a difference of two large numbers; two terms of the series are exact to 1e-15 there
    large = angle > 1e-3
    safe = np.where(large, angle, 1.0)
    factor = np.where(large, 1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.sin(safe)), 1 / 12 + angle**2 / 720)
    cross = cross_matrix(vector)
    jacobian: Array = np.eye(3) - cross / 2 + factor * (cross @ cross)
    return jacobian


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotation nearest to a 3 x 3 matrix in the least-squares sense, by its singular values, (..., 3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    sign = np.ones((*left.shape[:-2], 3))
    # the last singular value is the smallest: turning its direction over makes a
    # rotation of a reflection at the least cost
    sign[..., 2] = np.sign(np.linalg.det(left @ right))
    nearest: Array = (left * sign[..., None, :]) @ right
    return nearest


def _quaternion(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z), w >= 0, from whichever of the four forms divides by the largest component."""
    m = [[rotation[..., i, j] for j in range(3)] for i in range(3)]
    forms = np.empty((*rotation.shape[:-2], 4, 4))
    # the trace, and traces with two signs turned: 1 added, four times the square of a component
    forms[..., 0, 0] = m[0][0] + m[1][1] + m[2][2]
    forms[..., 1, 1] = m[0][0] - m[1][1] - m[2][2]
    forms[..., 2, 2] = m[1][1] - m[0][0] - m[2][2]
    forms[..., 3, 3] = m[2][2] - m[0][0] - m[1][1]
    diagonal = np.einsum("...ii->...i", forms)
    best = np.argmax(diagonal, axis=-1)
    diagonal += 1
    for (i, j), product in {
        (0, 1): m[2][1] - m[1][2], (0, 2): m[0][2] - m[2][0], (0, 3): m[1][0] - m[0][1],
        (1, 2): m[0][1] + m[1][0], (1, 3): m[0][2] + m[2][0], (2, 3): m[1][2] + m[2][1],
    }.items():  # fmt: skip
        forms[..., i, j] = forms[..., j, i] = product
    # at least 1/2 in size: dividing by a small component would lose digits near a half turn
    chosen = forms.reshape(-1, 4, 4)[np.arange(best.size), best.ravel()]
    quaternion = chosen.reshape(*best.shape, 4)
    length = _length(quaternion)[..., None]
    unit: Array = quaternion / np.where(quaternion[..., :1] < 0, -length, length)
    return unit


def _length(vector: Array) -> Array:
    # as `np.linalg.norm`, whose way there takes longer than the sum for a few vectors
    return np.asarray(np.sqrt((vector * vector).sum(axis=-1)))


def _sine_ratio(angle: Array) -> Array:
    small = angle < _SMALL
    return np.where(small, 1 - angle**2 / 6, np.sin(angle) / np.where(small, 1.0, angle))


def _cosine_ratio(angle: Array) -> Array:
    small = angle < _SMALL
    # `1 - cos t = 2 sin(t/2)^2` does not cancel
    half = np.sin(angle / 2)
    return np.where(small, 0.5 - angle**2 / 24, 2 * half**2 / np.where(small, 1.0, angle) ** 2)
