"""A calibration with the shape of its lens: knots over the image, unknowns that leave the base lens alone, their size.

The base lens keeps its meaning: over the image, the shape has no part that its estimated parameters or a rotation of
the camera could take.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import LinkContext
from metrocli.adjust.model.groups import Group, joint_prior
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import SHAPE, Knots, LensShape
from metrocli.effects.model import Model
from metrocli.frozen import dataclass
from metrocli.instruments import camera
from metrocli.instruments.lenses.conventions import image_grid
from metrocli.instruments.lenses.lens import direction
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.shared.images.adjustment import IMAGES

_KNOTS = 12
"""Knots along the longer side of the image"""
_WIDE = 3.0
"""Standard deviation [px] of the coefficients with which the readings are asked"""
_REACHES = (0.1, 0.2, 0.4)
"""Lengths over which shapes are alike that are tried, in units of the longer side of the image"""
_STEPS = 100
_NEAR = 0.1
"""Last step, in standard deviations, of the adjustment by which the shape's size is estimated"""
# e^4: chance exceeds it in 0.7 % of cases (docs/decisions/202-shape-of-a-lens.md)
_SHOWN = 4.0
"""Gain in the logarithm of the likelihood below which the readings show no shape"""


def with_shape(problem: CameraProblem, noise_known: bool) -> CameraProblem:
    """Return the calibration with the shape of its lens as unknowns with a prior; as it is if they show no shape."""
    base = _adjusted(problem)
    if not base.outcome.good:
        return problem
    problem = problem.with_blocks({**problem.blocks, **base.blocks})
    shown = shape_of(problem, noise_known)
    return problem if shown is None else problem.with_model(extended(problem.model, *shown))


def shape_of(problem: CameraProblem, noise_known: bool) -> tuple[LensShape, Array] | None:
    """Return the shape that the readings of an adjusted calibration show, and the covariance of its unknowns."""
    link = link_free_of_base(problem)
    size = likely(_evidence(problem, link, noise_known), kernels(link, problem.image_size))
    return None if size.gain < _SHOWN else (link, size.covariance)


def link_free_of_base(problem: CameraProblem) -> LensShape:
    """Return the link of a shape that base lens and rotations of the camera leave; its unknowns have no scale yet."""
    return LensShape(_knots(problem.image_size), _free_of(problem))


def _adjusted(problem: CameraProblem, tolerance: float = StoppingRule.tolerance) -> Solution:
    control = StoppingRule(limit=_STEPS, tolerance=tolerance)
    return adjust(problem.blocks.values(), [problem.images, *problem.others], problem.datum, control)


def _knots(image_size: tuple[int, int]) -> Knots:
    spacing = max(image_size) / (_KNOTS - 3)
    across, down = (max(round(extent / spacing) + 3, 4) for extent in image_size)
    return Knots(image_size, (across, down))


def _free_of(problem: CameraProblem) -> Array:
    """Return N: coefficients whose shift over the image is orthogonal to base lens and rotations of the camera."""
    knots, lens = _knots(problem.image_size), problem.blocks[camera.LENS]
    uv = np.stack(image_grid(problem.image_size))
    seen = direction(lens.named(), uv[0], uv[1], problem.convention)
    known = np.isfinite(seen[0])
    uv, seen = uv[:, known], seen[:, known]
    local = LinkContext({camera.LENS: lens}, Observations(uv, np.ones(1), {}), frozenset({camera.LENS}))
    step = camera.lens_link(problem.convention).step(seen, local)
    # a turn of the camera moves directions by its cross product with them
    turned = np.cross(np.eye(3)[:, :, None], seen[None], axisa=1, axisb=1, axisc=1)  # (3, 3, n): about x, y, z
    by_turn = np.einsum("apn,kpn->akn", np.asarray(step.by_input), turned)
    change = np.concatenate([step.by_block[camera.LENS][:, lens.free[0]], by_turn], axis=1)
    basis = knots.basis(uv)
    overlap = np.concatenate([change[axis] @ basis for axis in (0, 1)], axis=1)
    overlap /= np.linalg.norm(overlap, axis=1, keepdims=True)
    _, values, rows = np.linalg.svd(overlap, full_matrices=True)
    # what the base lens or a turn could take is left to them, so that f, cx and k1 keep their meaning
    nothing: Array = rows[int((values > 1e-9).sum()) :].T
    return nothing


def kernels(link: LensShape, image_size: tuple[int, int]) -> list[Array]:
    """Return covariances of the unknowns for shapes that are alike over several lengths: `exp(-d^2 / 2 r^2)`."""
    places = link.knots.places()
    apart = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    alike = [np.exp(-apart / (2 * (reach * max(image_size)) ** 2)) for reach in _REACHES]
    n = link.to_coefficients
    # coefficients are N w, and the columns of N are orthonormal: w has the covariance N'KN
    return [n.T @ np.kron(np.eye(2), gram) @ n for gram in alike]


def extended(model: Model, link: LensShape, covariance: Array) -> Model:
    """Return a model whose image points are shifted by a shape, with the covariance of its unknowns as a prior."""
    size = link.to_coefficients.shape[1]
    block = Block(link.block, np.zeros((1, size)), tuple(f"w{k + 1}" for k in range(size)))
    prior = joint_prior([(block, np.zeros(size, dtype=np.intp), np.arange(size))], covariance)
    images = model.group(IMAGES)
    group = Group(images.name, images.chain.spliced([link]), images.observations, images.weights)
    model = model.with_group(group)
    return replace(model, groups=(*model.groups, prior), blocks={**model.blocks, link.block: block})


def _evidence(problem: CameraProblem, link: LensShape, noise_known: bool) -> Evidence:
    """Return what the readings know of the shape, from an adjustment with a wide prior that is taken off again."""
    size = link.to_coefficients.shape[1]
    wide = np.eye(size) * _WIDE**2
    solution = _adjusted(problem.with_model(extended(problem.model, link, wide)), _NEAR)
    values = solution.blocks[SHAPE].values[0]
    inverse = np.linalg.inv(solution.covariance_or_raise().of(SHAPE))
    right = inverse @ values
    dof = solution.dof
    return Evidence(inverse - np.eye(size) / _WIDE**2, right, solution.cost + float(values @ right), dof, noise_known)


_RATIOS = np.geomspace(1e-9, 1e9, 181)
"""Ratios of the variances that are tried first; each step is a tenth of a decade"""
_FINE, _ROUNDS = 21, 6
"""Ratios between the neighbours of the best one, and how often these are taken: to a millionth of a step"""


@dataclass(frozen=True)
class Evidence:
    """What readings know of the unknowns w, whitened by the declared noise."""

    normal: Array
    """A (m, m)"""
    right: Array
    """c (m,)"""
    squares: float
    """Weighted squares of the residuals without the shape"""
    dof: int
    """Readings less the other unknowns"""
    noise_known: bool


@dataclass(frozen=True)
class Size:
    """The most likely covariance of the unknowns, absolute."""

    covariance: Array
    gain: float
    """Logarithm of the likelihood over that without a shape"""


def likely(evidence: Evidence, kernels: Sequence[Array]) -> Size:
    """Return the covariance t2 K of the unknowns with the largest restricted likelihood, of kernels K (m, m)."""
    return max((_likely(evidence, kernel) for kernel in kernels), key=lambda size: size.gain)


def _likely(evidence: Evidence, kernel: Array) -> Size:
    # a smooth kernel is singular to rounding: its root needs a little of a diagonal one
    root = np.linalg.cholesky(kernel + 1e-10 * np.trace(kernel) / len(kernel) * np.eye(len(kernel)))
    values, vectors = np.linalg.eigh(root.T @ evidence.normal @ root)
    # in these directions the likelihood of a ratio is a sum, so that 181 ratios cost no decomposition each
    values, along = np.maximum(values, 0.0), (vectors.T @ (root.T @ evidence.right)) ** 2

    ratios, gains, variances = _RATIOS, np.zeros(1), np.ones(1)
    for _ in range(_ROUNDS + 1):
        grown = 1 + ratios[:, None] * values
        explained, log_det = (along * ratios[:, None] / grown).sum(axis=1), np.log(grown).sum(axis=1)
        if evidence.noise_known:
            gains, variances = (explained - log_det) / 2, np.ones(len(ratios))
        else:
            # an unknown noise is estimated beside the shape, from what it leaves
            variances = (evidence.squares - explained) / evidence.dof
            gains = -(evidence.dof * np.log(variances * evidence.dof / evidence.squares) + log_det) / 2
        at, tried = int(np.argmax(gains)), ratios
        ratios = np.geomspace(tried[max(at - 1, 0)], tried[min(at + 1, len(tried) - 1)], _FINE)
    return Size(tried[at] * variances[at] * (root @ root.T), float(gains[at]))
