"""Effects on a laser that measures along lines of a machine; docs/effects describes each of them."""

from __future__ import annotations

from metrocli.effects.effect import ELAPSED, WARMING, Effect, Parameter
from metrocli.effects.links.motions import LineTerm
from metrocli.instruments.six_dof import FROM_START
from metrocli.tasks.calibrate_machine.effects.machine import SCHWENKE, size


def _refraction(by: str, condition: str, need: str, rate: Parameter, usual: str) -> Effect:
    return Effect(
        "laser-refraction-drift",
        "the refractive index of the air changes while the laser measures, without being corrected",
        (rate,),
        lambda block, where: LineTerm(block, (condition, FROM_START)),
        by=by,
        needs=(need,),
        confused_with=("thermal-growth", "laser-dead-path-drift"),
        usual=usual,
        reveal="temperature and pressure of the air with each reading; a line run again at the end",
        source="Birch and Downs 1994: -0.955 ppm/K, +0.268 ppm/hPa",
    )


OF_THE_LASER: tuple[Effect, ...] = (
    Effect(
        "laser-dead-path-drift",
        "the zero of the laser drifts on one line: dead path, stand and optics warm up",
        (size("rate", "speed", "1 um/min"),),
        lambda block, where: LineTerm(block, (ELAPSED,)),
        where=("line",),
        needs=("t",),
        confused_with=("laser-refraction-drift", "machine-drift", "backlash"),
        usual="0.05 um/h to 1 um/min",
        reveal="the line run to and fro, and its first target read again at the end",
        source=SCHWENKE,
    ),
    _refraction("T", WARMING, "temp", size("rate", "expansion", "2e-6 1/K"), "5e-7 to 2e-6 1/K"),
    _refraction("t", ELAPSED, "t", size("rate", "rate", "10 ppm/h"), "0.1 to 10 ppm/h"),
)
"""Effects on the displacement that the laser reads"""
