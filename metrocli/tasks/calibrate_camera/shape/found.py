"""The shape of a lens that an adjustment found: its table, its size over the image, and its derivatives."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import SHAPE, LensShape
from metrocli.geometry import poses
from metrocli.instruments.camera import LENS, TAPER
from metrocli.instruments.lenses.conventions import image_grid
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.shared.images.calibrated import DIRECTIONS, LENS_SHAPE, SHAPE_COVARIANCE
from metrocli.tasks.shared.images.settings import SPLINE

_KNOWN = 1e-3
"""Share of the largest standard deviation below which a direction of the shape counts as known"""


def link_of(problem: CameraProblem) -> LensShape | None:
    """Return the link of the shape in a calibration; None without one."""
    return next((link for link in problem.images.chain.links if isinstance(link, LensShape)), None)


def by_shape(link: LensShape, uv: Array) -> Array:
    """Return the derivatives of image points (2, n) by the unknowns of the shape, u of all before v of all."""
    half = len(link.to_coefficients) // 2
    at = link.knots.basis(uv)
    return np.concatenate([at @ link.to_coefficients[:half], at @ link.to_coefficients[half:]])


def shape_table(problem: CameraProblem, solution: Solution) -> dict[str, Table]:
    """Return the coefficients of the shift [px] at their knots, with standard uncertainties; {} without a shape."""
    link = link_of(problem)
    return {} if link is None else {LENS_SHAPE: Table.of(coefficients(link, solution))}


def coefficients(link: LensShape, solution: Solution) -> dict[str, Array]:
    """Return the coefficients of a shift [px] at their knots, with standard uncertainties, by heading."""
    n, places = link.to_coefficients, link.knots.places()
    shift = (n @ solution.blocks[link.block].values[0]).reshape(2, -1)
    std = np.sqrt(np.einsum("ka,ab,kb->k", n, solution.covariance_or_raise().of(link.block), n)).reshape(2, -1)
    columns = {"u [px]": places[:, 0], "v [px]": places[:, 1], "du [px]": shift[0], "dv [px]": shift[1]}
    return {**columns, "std_du [px]": std[0], "std_dv [px]": std[1]}


def shape_arrays(problem: CameraProblem, solution: Solution) -> dict[str, Array]:
    """Return how uncertain the shape is together with lens and pose; {} without a shape, and unless the rig is cmm."""
    from scipy.linalg import block_diag

    link = link_of(problem)
    if link is None or problem.rig != "cmm":
        return {}
    values, vectors = np.linalg.eigh(solution.joint((SHAPE,)))
    unknown = values > _KNOWN**2 * values[-1]
    lens, pose = solution.blocks[LENS], solution.blocks[TAPER].values[0]
    change = block_diag(np.eye(int(lens.free.sum())), poses.euler_form_by_step(pose), vectors.T)
    change = np.delete(change, len(change) - len(values) + np.flatnonzero(~unknown), axis=0)
    covariance = change @ solution.joint((LENS, TAPER, SHAPE)) @ change.T
    return {DIRECTIONS: link.to_coefficients @ vectors[:, unknown], SHAPE_COVARIANCE: covariance}


def shape_rms(problem: CameraProblem, solution: Solution) -> float:
    """Return the root mean square shift over the image [px]; 0 without a shape."""
    link = link_of(problem)
    return 0.0 if link is None else rms_of(link, solution)


def rms_of(link: LensShape, solution: Solution) -> float:
    """Return the root mean square shift of a shape over its image [px]."""
    shift = by_shape(link, np.stack(image_grid(link.knots.image_size))) @ solution.blocks[link.block].values[0]
    return float(np.sqrt(2 * (shift**2).mean()))


def shape_notes(problem: CameraProblem, solution: Solution, model: str | None) -> list[str]:
    """Return how large the shape is, or that the model spline of the job has found no shape."""
    if link_of(problem) is not None:
        return [f"shape of the lens beside its base: {shape_rms(problem, solution):.2g} px (rms over the image)"]
    nothing = "the readings show no shape of the lens beside its base: the result is that of the base"
    return [nothing] if model == SPLINE else []
