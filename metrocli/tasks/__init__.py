"""The kinds of job. A kind is one module here (its name with _ for -) and one line in the table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from types import ModuleType


@dataclass(frozen=True)
class Kind:
    """What the command line knows of a kind of job without importing its module."""

    module: str
    summary: str
    answers: Mapping[str, str] = field(default_factory=dict)
    """Options such as --compare, each with its help: instead of `run`, the module's function of that name is called,
    with the same arguments; it gives a Table, which is printed."""
    chunked: bool = False
    """Its `run` takes `workers`, which do the chunks of a long computation: --workers, --scheduler."""


KINDS: dict[str, Kind] = {
    "calibrate-camera": Kind(
        "metrocli.tasks.calibrate_camera.task",
        "camera model from images or observed points",
        {"compare": "Fit each lens model and print what it would gain, without writing a result."},
    ),
    "align-part": Kind("metrocli.tasks.align_part.task", "part location and orientation in the machine (6D/7D)"),
    "multilaterate": Kind("metrocli.tasks.multilaterate.task", "reflector positions from length changes of 4+ tracers"),
    "selfcal-grid": Kind(
        "metrocli.tasks.selfcal_grid.task",
        "machine and artefact errors from views of an uncalibrated ball grid",
        {"compare": "Adjust as the paper does, views fitted first, and print what that loses, without a result."},
    ),
    "locate-launch-unit": Kind(
        "metrocli.tasks.locate_launch_unit.task",
        "interferometer launch unit in the machine; measuring trajectories",
        {"compare": "Print what each of the three methods makes of the poses, without writing a result."},
    ),
    "calibrate-machine": Kind(
        "metrocli.tasks.calibrate_machine.task", "geometric errors of a 3-axis machine from tracker or 6-DoF data"
    ),
    "report-uncertainty": Kind(
        "metrocli.tasks.report_uncertainty.task", "GUM and Monte Carlo uncertainty, budget, capability", chunked=True
    ),
}


def load(kind: str) -> ModuleType:
    """Import the module of a kind."""
    return import_module(KINDS[kind].module)
