"""The kinds of job.

Each kind is one package here, named as the kind with _ instead of -, and one line in the table `_PACKAGES`. In
each, as far as it needs them: `settings` (keys, files) -> `readings` (observations) -> `problem` (blocks and
groups) -> `solve` -> `report` (the result), called by `task`; `plan`, `simulation`, `diagnosis`, `effects`
besides. `shared` has what two need.
"""

from __future__ import annotations

from importlib import import_module

from metrocli.tasks.kind import Kind

_PACKAGES = (
    "calibrate_camera",
    "align_part",
    "multilaterate",
    "selfcal_grid",
    "locate_launch_unit",
    "calibrate_machine",
    "adjust_network",
    "fit_part",
    "fit_points",
    "report_uncertainty",
)


def _declared(package: str) -> Kind:
    kind: Kind = import_module(f"metrocli.tasks.{package}").KIND
    return kind


KINDS: dict[str, Kind] = {kind.name: kind for kind in map(_declared, _PACKAGES)}
"""Every kind by name, in the order of the help; importing this does not load their mathematics"""
