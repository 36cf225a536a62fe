"""Effects: physical causes that a model can leave out, and a job can add by name.

A kind of job has a module here with its table `EFFECTS`, and one line below; each effect has a page in docs/effects.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrocli.effects.effect import Effect

TABLES: dict[str, str] = {
    "calibrate-camera": "metrocli.tasks.calibrate_camera.effects",
    "align-part": "metrocli.tasks.align_part.effects",
    "calibrate-machine": "metrocli.tasks.calibrate_machine.effects",
    "multilaterate": "metrocli.tasks.multilaterate.effects",
    "locate-launch-unit": "metrocli.tasks.locate_launch_unit.effects",
    "selfcal-grid": "metrocli.tasks.selfcal_grid.effects",
}
"""For each kind of job the module that has its table"""


def effects_of(kind: str) -> tuple[Effect, ...]:
    """Return the effects that a job of this kind may name under `effects:`."""
    if kind not in TABLES:
        return ()
    table: tuple[Effect, ...] = import_module(TABLES[kind]).EFFECTS
    return table


def forms(kind: str, name: str) -> tuple[Effect, ...]:
    """Return the forms of the effect of this name; none where it is unknown."""
    return tuple(effect for effect in effects_of(kind) if effect.name == name)
