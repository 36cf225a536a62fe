"""Pictures of simulated targets, rendered one by one on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.instruments.lens import ideal_point
from metrocli.targets import drawings, render
from metrocli.targets.codes import codes
from metrocli.targets.pattern import Pattern
from metrocli.tasks.shared.images.simulation import Shown

if TYPE_CHECKING:
    from metrocli.imageset import Picture

Draw = Callable[[], "Picture"]


def pictures(
    shown: Shown, pattern: Pattern, rng: np.random.Generator, only: Callable[[int], list[int]] | None = None
) -> Iterator[tuple[str, Draw]]:
    """Yield the path of each image and a function that renders it; each image has a random seed of its own."""
    seeds = rng.integers(0, 2**63, len(shown.images))
    for i, image in enumerate(shown.images):
        chosen = list(range(len(shown.targets.names))) if only is None else only(i)
        yield f"images/{image}", drawer(shown, pattern, i, chosen, int(seeds[i]))


def drawer(shown: Shown, pattern: Pattern, image: int, chosen: list[int], seed: int) -> Draw:
    """Return a function that renders one image with the chosen targets."""

    def draw() -> Picture:
        scene = _scene(shown, pattern, image, chosen)
        look = render.RETRO_REFLECTIVE if pattern.type in ("dot", "coded-rings") else replace(render.Look(), noise=2.0)
        return render.render(shown.image_size, lambda uv: _rays(shown, uv), scene, look, np.random.default_rng(seed))

    return draw


def _rays(shown: Shown, uv: Array) -> Array:
    x, y = ideal_point(shown.lens, uv[:, 0], uv[:, 1], shown.convention)
    both = np.column_stack([x, y, np.ones_like(x)])
    unit: Array = both / np.linalg.norm(both, axis=1, keepdims=True)
    return unit


def _scene(shown: Shown, pattern: Pattern, image: int, chosen: list[int]) -> list[render.Placed]:
    rotation = poses.rotation_of(shown.to_camera[image])
    if pattern.type not in ("dot", "coded-rings"):
        return [render.Placed(drawings.board(pattern), rotation, shown.to_camera[image, :3])]
    points = poses.apply(shown.to_camera[image], shown.targets.points)
    return [render.Placed(_drawing(shown, pattern, i), rotation, points[i]) for i in chosen if points[i, 2] > 0]


def _drawing(shown: Shown, pattern: Pattern, target: int) -> drawings.Drawing:
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
