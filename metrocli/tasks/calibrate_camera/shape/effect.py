"""The shape of a lens as an effect: a smooth shift over the image whose size a job states, or `diagnose` finds.

Its unknowns z are independent and scatter alike: `w = N R z`, `R R' = N' K N`, with N of `spline` and K the mean of the
covariances over all its lengths. So the standard deviation of z is that of the shift over the image [px].
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.effects.effect import Effect, Parameter, sizes
from metrocli.effects.links.lens_shape import SHAPE, Knots, LensShape
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.shape.spline import kernels, link_free_of_base

_LEAST_VARIANCE = 3e-3
"""Share of the largest variance below which a direction of the shape is left out: 5 % of its standard deviation"""
_EXAMPLE = Knots((2592, 1944), (8, 7))
"""Knots where no calibration gives the image; the shape is then a bump in its middle"""
_BUMP = np.eye(_EXAMPLE.size)[:, [_EXAMPLE.size // 4 + _EXAMPLE.counts[0] // 2]]

LENS_SHAPE = Effect(
    SHAPE,
    "the lens images in a way that its polynomial does not have: a wide angle, a cover glass",
    sizes("z", "pixel", "3 px"),
    lambda block, where: LensShape(_EXAMPLE, _BUMP, block),
    confused_with=("radial-distortion", "thin-prism", "sensor-tilt"),
    formula="(u, v) += sum_k B_k(u, v) (N R z)_k    # cubic B-splines on knots over the image",
    note="It has no part that the estimated lens or a turn of the camera could take. `std` is the size of the shift; "
    "`camera: {model: spline}` estimates that, too.",
    usual="0.02 to 3 px",
    reveal="corners all over the image, each place in several images with the board otherwise",
    source="mrcal, splined stereographic lens model; Patterson and Thompson 1971 for its size",
    of_all="a smooth shift over the image that all images share",
    throughout=True,
)
"""The entry of the table; `lens_shape` returns the effect in the image and beside the lens of a calibration"""


def lens_shape(problem: CameraProblem) -> Effect:
    """Return the effect beside the base lens of a calibration, with a parameter for each direction of its shape."""
    link = link_free_of_base(problem)
    values, vectors = np.linalg.eigh(np.mean(kernels(link, problem.image_size), axis=0))
    kept = values > _LEAST_VARIANCE * values[-1]
    modes: Array = link.to_coefficients @ (vectors[:, kept] * np.sqrt(values[kept]))
    z = LENS_SHAPE.parameters[0]
    parameters = tuple(Parameter(f"z{i + 1}", z.dimension, z.plausible) for i in range(modes.shape[1]))
    return replace(LENS_SHAPE, parameters=parameters, link=lambda block, where: LensShape(link.knots, modes, block))


def beside_base(problem: CameraProblem, requests: Iterable[RequestedEffect]) -> tuple[RequestedEffect, ...]:
    """Return the effects that a job names, a lens shape as that beside its base lens.

    Raises InputError if its size is not stated.
    """
    requests = tuple(requests)
    of_shape = [request for request in requests if request.name == SHAPE]
    if not of_shape:
        return requests
    hint = "write std: 0.3 px, the size of the shift, or camera: {model: spline}, which estimates it"
    faults = [request.node.fault("lens-shape: std is missing", hint) for request in of_shape if not request.std]
    if faults:
        raise InputError(faults)
    form = lens_shape(problem)
    return tuple(replace(request, forms=(form,)) if request.name == SHAPE else request for request in requests)
