"""Lens values that a job holds, against the readings: a noise that follows the residuals does not show a wrong one.

The readings are adjusted once more with all held values free, as for the principal point.
"""

from __future__ import annotations

from metrocli.adjust.adjustment import adjust
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.calibrate_camera.settings import Camera
from metrocli.tasks.shared.images.adjustment import Adjusted

_MUCH = 0.5
"""Share of the squared residuals below which a held value is doubted (decision 134)"""
_CENTRE = ("cx", "cy")
"""Tested against the image size"""


def held_doubts(problem: Problem, settings: Camera, adjusted: Adjusted) -> list[str]:
    """Return that the squared residuals are less than half with the held lens values free."""
    solution = adjusted.solution
    held = [name for name in settings.given() if name not in (*settings.estimate, *_CENTRE)]
    if not held:
        return []
    model = problem.with_blocks(solution.blocks).with_estimate([*settings.estimate, *held])
    freed = adjust(model.blocks.values(), [adjusted.group, *problem.others], problem.datum)
    if not freed.outcome.good or freed.cost >= _MUCH * solution.cost:
        return []
    known, found = (one.blocks[camera.LENS].named() for one in (solution, freed))
    told = ", ".join(f"{name} is held at {known[name]:g}, but the readings see {found[name]:.4g}" for name in held)
    return [
        f"{told}: with {' and '.join(held)} free the squared residuals are {freed.cost / solution.cost:.2g} times as "
        "large; estimate what is held, or correct it"
    ]
