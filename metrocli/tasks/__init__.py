"""The kinds of job. A kind is one package here, of its name with _ for -, and one line in the table."""

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
    "report_uncertainty",
)


def _declared(package: str) -> Kind:
    kind: Kind = import_module(f"metrocli.tasks.{package}").KIND
    return kind


KINDS: dict[str, Kind] = {kind.name: kind for kind in map(_declared, _PACKAGES)}
"""By name, in the order of the help; their mathematics is not loaded"""
