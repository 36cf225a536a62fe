"""Effects that may disturb the calibration of a machine, and where those of one's own can act."""

from metrocli.effects.effect import Effect
from metrocli.tasks.calibrate_machine.effects.machine import OF_THE_MACHINE
from metrocli.tasks.calibrate_machine.effects.places import PLACES
from metrocli.tasks.calibrate_machine.effects.tracker import OF_THE_LASER, OF_THE_TRACKER
from metrocli.tasks.shared.length_effects import LENGTH_EFFECTS

OF_MACHINES: tuple[Effect, ...] = (*OF_THE_MACHINE, *OF_THE_TRACKER)
"""Effects on machine and tracker. A single tracker cannot separate machine-drift and tracker-drift."""
OF_LINES = (*OF_MACHINES, *OF_THE_LASER)
"""For lines: with effects on the laser; those on a tracker are listed as not seen"""
OF_LENGTHS = (*OF_THE_MACHINE, *LENGTH_EFFECTS)
"""Effects on the machine and on lengths"""
EFFECTS = (*OF_LINES, *LENGTH_EFFECTS)
"""All effects in the order of lists; each method has those that act on what it reads"""

__all__ = ["EFFECTS", "OF_LENGTHS", "OF_LINES", "OF_MACHINES", "PLACES"]
