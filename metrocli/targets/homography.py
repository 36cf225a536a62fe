"""Images of the points of a plane: by a homography, and by one with smooth distortion."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Mask

_ON_A_LINE = 1e-6
"""Smallest singular value of a homography, relative to the largest, that is not a rounding error"""
_AGAIN = 3
"""Rounds in which the points that fit a view follow it"""
_DEGREE, _SMOOTH = 3, 10
"""Degree of the distortion of one image, and its coefficients in each image coordinate"""


def homography(plane: Array, uv: Array) -> Array:
    """Return the homography (3, 3) from plane (n, 2) to image (n, 2) by the normalised linear method (DLT)."""
    (a, plane_), (b, uv_) = _normalised(plane), _normalised(uv)
    # four points give 8 rows of 9: the null vector is then only in the full matrix
    h = np.linalg.svd(_linear(plane_, uv_), full_matrices=len(uv) < 5)[2][-1].reshape(3, 3)
    return np.asarray(np.linalg.inv(b) @ h @ a)


def _linear(plane: Array, uv: Array) -> Array:
    """Return the linear equations (2n, 9) of a homography from plane (n, 2) to image (n, 2)."""
    x, y = plane.T
    u, v = uv.T
    ones, zero = np.ones_like(x), np.zeros_like(x)
    return np.concatenate(
        [
            np.stack([x, y, ones, zero, zero, zero, -u * x, -u * y, -u], axis=1),
            np.stack([zero, zero, zero, x, y, ones, -v * x, -v * y, -v], axis=1),
        ]
    )


def determines_homography(plane: Array) -> bool:
    """Return whether images of these points (n, 2) determine a homography: not where all but one lie on a line."""
    own = _normalised(plane)[1]
    size = np.linalg.svd(_linear(own, own), compute_uv=False)
    # a homography has eight unknowns, and the ninth singular value is 0 for any points
    return len(plane) >= 4 and bool(size[7] > _ON_A_LINE * size[0])


def projected(h: Array, plane: Array) -> Array:
    """Return the image points (n, 2) of plane points (n, 2)."""
    x = plane @ h[:, :2].T + h[:, 2]
    return np.asarray(x[:, :2] / x[:, 2:])


def seen_by_a_lens(plane: Array, uv: Array, at: Array) -> Array:
    """Return the image points (m, 2) of plane points `at` (m, 2), from others (n, 2) and their image points (n, 2).

    A homography and smooth distortion: a polynomial where there are points enough, their steps being short then.
    """
    view = homography(plane, uv)
    found = projected(view, at)
    if len(uv) >= 2 * _SMOOTH:
        middle, size = plane.mean(axis=0), np.ptp(plane, axis=0).max()
        own, other = (_terms((points - middle) / size) for points in (plane, at))
        found = found + other @ np.linalg.lstsq(own, uv - projected(view, plane), rcond=None)[0]
    return np.asarray(found)


def fitting_a_view(plane: Array, uv: Array, near: float) -> Mask:
    """Return which image points (n, 2) lie so near [px] to a view by a lens that most of them fit, (n,)."""
    import cv2  # which takes longer to load than a job without images

    _, found = cv2.findHomography(plane, uv, cv2.RANSAC, near)
    fitting = np.zeros(len(uv), dtype=bool) if found is None else found.ravel().astype(bool)
    for _ in range(_AGAIN):
        if not determines_homography(plane[fitting]):
            return np.zeros(len(uv), dtype=bool)
        off = np.linalg.norm(seen_by_a_lens(plane[fitting], uv[fitting], plane) - uv, axis=1)
        fitting = off < near
    return np.asarray(fitting)


def _terms(plane: Array) -> Array:
    """Return the terms (n, _SMOOTH) of a polynomial of the third degree in x and y."""
    x, y = plane.T
    return np.stack([x**i * y**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=1)


def _normalised(points: Array) -> tuple[Array, Array]:
    """Return the similarity (3, 3) that centres and scales the points for the linear method, and its result (n, 2)."""
    centre = points.mean(0)
    scale = np.sqrt(2) / max(float(np.sqrt(((points - centre) ** 2).sum(1).mean())), 1e-12)
    change = np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
    return change, (points - centre) * scale
