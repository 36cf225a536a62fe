"""Simulated image measurements: the image points that the camera model predicts, effects in them, and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask, Picture
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.links.lens_shape import KnownShape, shifted, unshifted
from metrocli.effects.model import Model
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError, UsageError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.camera import TARGET
from metrocli.instruments.lenses.lens import direction, equidistant, ideal_point, image_point
from metrocli.table import Table
from metrocli.targets import drawings, render
from metrocli.targets.coded_rings import codes
from metrocli.targets.pattern import GRIDS, Pattern
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.sightings import START_NOISE
from metrocli.tasks.shared.images.target_list import TargetCoordinates
from metrocli.tasks.shared.statistics import CONDITIONS

_MARGIN = 2.0
"""Least distance of a target from the border of the image [px]"""

_ASTRAY = 1e-6
"""Largest distance in the plane Z = 1 between a point and the ray of its image; beyond it the lens model folds over"""


@dataclass(frozen=True)
class SimulatedCamera:
    """A camera with its true parameters, the targets in front of it, and its images."""

    lens: Mapping[str, float]
    image_size: tuple[int, int]
    images: tuple[str, ...]
    to_camera: Array
    """Pose that takes targets into the camera's frame, for each image (images, 6)"""
    targets: TargetCoordinates
    convention: str = "forward"
    conditions: Mapping[str, Array] = field(default_factory=dict)
    """Time and temperature of each image, (images,)"""
    name: str = ""
    """Of one of several cameras"""
    shape: KnownShape | None = None
    """Shift of the image points over the image that the lens has besides"""


def true_targets(listed: TargetCoordinates, rng: np.random.Generator) -> TargetCoordinates:
    """Return the true targets: the listed places with normal errors of the listed standard deviations."""
    return replace(
        listed, points=listed.points + rng.normal(0.0, 1.0, listed.points.shape) * np.nan_to_num(listed.sigma)
    )


@dataclass(frozen=True)
class ExactImagePoints:
    """Exact image points of the targets inside each image, before noise is added."""

    view: Index
    target: Index
    uv: Array
    """Image coordinates (2, n) px"""


def sights(cameras: Sequence[SimulatedCamera], only: Callable[[int], list[int]] | None = None) -> ExactImagePoints:
    """Return the image points of the targets inside each image of all cameras, whose images count on.

    `only` returns the targets that an image shows; None: all. Raises InputError if no target is inside any image of a
    camera.
    """
    views, targets, points, before = list[Index](), list[Index](), list[Array](), 0
    for shown in cameras:
        every = np.arange(len(shown.targets.names))
        chosen = [every if only is None else np.array(only(i), dtype=np.intp) for i in range(len(shown.images))]
        projections = [_projected(shown, i, shot) for i, shot in enumerate(chosen)]
        if not any(inside.any() for _, inside in projections):
            of = f"camera {shown.name}: " if shown.name else ""
            raise InputError(f"{of}simulation: no target is inside any image; check the poses and the distance")
        views += [np.full(int(inside.sum()), before + i) for i, (_, inside) in enumerate(projections)]
        targets += [shot[inside] for shot, (_, inside) in zip(chosen, projections, strict=True)]
        points += [uv[inside] for uv, inside in projections]
        before += len(shown.images)
    return ExactImagePoints(np.concatenate(views), np.concatenate(targets), np.concatenate(points).T)


def sightings_table(
    cameras: Sequence[SimulatedCamera], seen: ExactImagePoints, noise: float | str, rng: np.random.Generator
) -> Table:
    """Return the table of observations with normal noise [px], 0.1 px if the job estimates it, and conditions."""
    sigma = noise if isinstance(noise, float) else START_NOISE
    uv = seen.uv + rng.normal(0.0, sigma, seen.uv.T.shape).T
    targets = np.array(cameras[0].targets.names)
    names = {"image": np.array(all_images(cameras))[seen.view], "target": targets[seen.target]}
    when = {f"{name} [{CONDITIONS[name]}]": values[seen.view] for name, values in _conditions(cameras).items()}
    return Table.of({**names, "u v [px]": uv.T, **when})


def all_images(cameras: Sequence[SimulatedCamera]) -> tuple[str, ...]:
    """Return the names of the images of all cameras, those of one behind those of the other."""
    return tuple(image for shown in cameras for image in shown.images)


def _conditions(cameras: Sequence[SimulatedCamera]) -> dict[str, Array]:
    return {name: np.concatenate([shown.conditions[name] for shown in cameras]) for name in cameras[0].conditions}


def _projected(shown: SimulatedCamera, image: int, chosen: Index) -> tuple[Array, Mask]:
    """Return image points (n, 2) and whether the image of the whole target, radius included, is inside the image."""
    points = poses.apply(shown.to_camera[image], shown.targets.points[chosen])
    fisheye = shown.convention == "fisheye"
    front = (points[:, 2] > 0) | fisheye
    # the size of a target shrinks with its distance, which of a fisheye is not Z
    z = np.linalg.norm(points, axis=1) if fisheye else np.where(front, points[:, 2], 1.0)
    flat = equidistant(points.T) if fisheye else None
    x, y = (points[:, 0] / z, points[:, 1] / z) if flat is None else (flat.x, flat.y)
    u, v = shifted(np.stack(_distorted(shown, x, y)), shown.shape)
    size = (
        max(shown.lens.get("f", 0.0), shown.lens.get("fx", 0.0)) * np.nan_to_num(shown.targets.radius[chosen]) / z
        + _MARGIN
    )
    w, h = shown.image_size
    inside = front & (u > size) & (u < w - 1 - size) & (v > size) & (v < h - 1 - size)
    # only for those that seem inside: the inverse of the lens costs most
    inside[inside] = _mapped(shown, x[inside], y[inside], u[inside], v[inside])
    return np.column_stack([u, v]), inside


def _mapped(shown: SimulatedCamera, x: Array, y: Array, u: Array, v: Array) -> Mask:
    """Return whether the image of each point is real.

    The lens polynomial folds over far outside the image, so that points out of sight are mapped back into it.
    """
    base_u, base_v = unshifted(np.stack([u, v]), shown.shape)
    back_x, back_y = ideal_point(shown.lens, base_u, base_v, shown.convention)
    return np.hypot(back_x - x, back_y - y) < _ASTRAY


def _distorted(shown: SimulatedCamera, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the image points u, v [px] of ideal points x, y in the plane Z = 1; a backward lens is iterated."""
    if shown.convention != "backward":
        return image_point(shown.lens, x, y, shown.convention == "fisheye")
    # without distortion: a start for the iteration
    u, v = image_point(
        {name: value for name, value in shown.lens.items() if name[0] not in "kps" or name == "skew"}, x, y
    )
    for _ in range(50):
        back_x, back_y = ideal_point(shown.lens, u, v, "backward")
        fx, fy = shown.lens.get("f", shown.lens.get("fx", 1.0)), shown.lens.get("f", shown.lens.get("fy", 1.0))
        u, v = u + fx * (x - back_x), v + fy * (y - back_y)
    return u, v


_ROUNDS = 50
"""Iteration limit for the image points of a backward lens"""
_SETTLED = 1e-10
"""The image points have converged when a round changes them by less than this [px]"""


def image_group(cameras: Sequence[SimulatedCamera], seen: ExactImagePoints, chain: Chain) -> Group:
    """Return the image points as readings of a chain, with the image of each as its view."""
    targets = cameras[0].targets
    conditions = {name: values[seen.view] for name, values in _conditions(cameras).items()}
    conditions["radius"] = targets.radius[seen.target]
    index = {"view": seen.view, TARGET: seen.target}
    return Group(IMAGES, chain, Observations(seen.uv, np.ones(1), index, conditions=conditions))


def planted(
    model: Model, seen: ExactImagePoints, effects: Sequence[RequestedEffect]
) -> tuple[ExactImagePoints, dict[str, float]]:
    """Return the image points with effects in them, and the true values of the effects by name.

    `model` is the model of the job at the truth.
    """
    if not effects:
        return seen, {}
    model = extended(model, effects)
    return replace(seen, uv=_image_points(model)), true_values(model)


def _image_points(model: Model) -> Array:
    """Return the readings that agree with their prediction, (2, n) px.

    A forward lens predicts them directly. A backward lens takes its correction at the reading, so they are iterated.
    Raises InputError if the camera no longer sees a target.
    """
    group = model.readings[0]
    for _ in range(_ROUNDS):
        uv = group.chain.predict(model.blocks, group.observations)
        if not np.isfinite(uv).all():
            raise InputError("simulation: with this effect the camera does not see every target; check its size")
        change = float(np.abs(uv - group.observations.readings).max(initial=0.0))
        group = group.with_observations(group.observations.with_readings(uv))
        if change < _SETTLED:
            break
    return group.observations.readings


Draw = Callable[[], "Picture"]


def pictures(
    cameras: Sequence[SimulatedCamera],
    pattern: Pattern | None,
    rng: np.random.Generator,
    only: Callable[[int], list[int]] | None = None,
    effects: Sequence[RequestedEffect] = (),
) -> list[tuple[str, Draw]]:
    """Return the path of each image and a function that renders it; none without a pattern.

    Each image has a random seed of its own. Raises InputError for a board that cannot be drawn, and UsageError for
    effects: they are planted in image points, not in pictures.
    """
    if pattern is None:
        return []
    if effects:
        raise UsageError("effects are planted in image points, not in pictures: leave out --images or --effect")
    drawn = []
    if pattern.type in GRIDS:
        drawings.board(pattern)
    for shown in cameras:
        # one seed for each image, drawn in order: images may be rendered alone or by several processes
        seeds = rng.integers(0, 2**63, len(shown.images))
        for i, image in enumerate(shown.images):
            chosen = list(range(len(shown.targets.names))) if only is None else only(i)
            drawn.append((f"images/{image}", drawer(shown, pattern, i, chosen, int(seeds[i]))))
    return drawn


def drawer(shown: SimulatedCamera, pattern: Pattern, image: int, chosen: list[int], seed: int) -> Draw:
    """Return a function that renders one image with the chosen targets."""

    def draw() -> Picture:
        scene = _scene(shown, pattern, image, chosen)
        look = render.RETRO_REFLECTIVE if pattern.type in ("dot", "coded-rings") else replace(render.Look(), noise=2.0)
        return render.render(shown.image_size, lambda uv: _rays(shown, uv), scene, look, np.random.default_rng(seed))

    return draw


def _rays(shown: SimulatedCamera, uv: Array) -> Array:
    base_u, base_v = unshifted(uv.T, shown.shape)
    seen = direction(shown.lens, base_u, base_v, shown.convention).T
    unit: Array = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    return unit


def _scene(shown: SimulatedCamera, pattern: Pattern, image: int, chosen: list[int]) -> list[render.PlacedDrawing]:
    rotation = poses.rotation_of(shown.to_camera[image])
    if pattern.type not in ("dot", "coded-rings"):
        return [render.PlacedDrawing(drawings.board(pattern), rotation, shown.to_camera[image, :3])]
    points = poses.apply(shown.to_camera[image], shown.targets.points)
    return [render.PlacedDrawing(_drawing(shown, pattern, i), rotation, points[i]) for i in chosen if points[i, 2] > 0]


def _drawing(shown: SimulatedCamera, pattern: Pattern, target: int) -> drawings.Drawing:
    radius = float(shown.targets.radius[target])
    if not np.isfinite(radius):
        raise InputError(
            "rendering needs the targets' size: give pattern: diameter, or a column radius_mm in the targets file"
        )
    name = shown.targets.names[target]
    if pattern.type == "dot":
        return drawings.Dot(radius)
    if not name.isdigit() or int(name) not in codes():
        known = ", ".join(str(code) for code in codes()[:6])
        raise InputError(f"target '{name}' is not a 12-bit code; coded targets are named by their code: {known}, ...")
    return drawings.CodedRing(int(name), radius)
