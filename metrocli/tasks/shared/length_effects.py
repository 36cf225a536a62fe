"""Effects on the lengths of tracking interferometers, and quantities on which user-defined ones can act."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.chain import Link, LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.effects.acting import Acting, Variable, beam_from, scalar, seen_from
from metrocli.effects.effect import ELAPSED, WARMING, Effect, Parameter, change_points, sizes
from metrocli.effects.links.lengths import AirGradient, BeamScale, LengthTerms
from metrocli.effects.links.points import Shift
from metrocli.instruments.tracer import COS_2A, COS_A, INCIDENCE, SIN_2A, SIN_A, TRACER

AT = ("tracer", "point")
"""Kinds of place at which an effect on lengths can have sizes of its own"""


def _path(value: Array, local: LinkContext) -> Step:
    """Return the geometric distance `|x - x0| = (l + l0) / s` from the length l (1, n), with its derivatives."""
    tracer = local.rows(TRACER)
    dead_path, scale = tracer[3], tracer[4]
    path = (value[0] + dead_path) / scale
    by_tracer = np.zeros((1, len(tracer), len(path)))
    by_tracer[0, 3], by_tracer[0, 4] = 1 / scale, -path / scale
    return Step(path[None], np.broadcast_to(1 / scale, path.shape)[None, None], {TRACER: by_tracer})


def _azimuth(value: Array, local: LinkContext) -> Step:
    given = local.observations.conditions
    return Step(np.arctan2(given[SIN_A], given[COS_A])[None])


def _elevation(value: Array, local: LinkContext) -> Step:
    # 1 - cos i is `1 + dz/d` here, so that 1 less is the sine of the elevation
    return Step(np.arcsin(local.observations.conditions[INCIDENCE] - 1)[None])


DIRECTION = (Variable("azimuth", "rad", _azimuth), Variable("elevation", "rad", _elevation))
"""Constants within an adjustment: otherwise an effect would fix the orientation of a free network"""
BEAM = (*beam_from(TRACER), *seen_from(TRACER, ("distance",)))
"""Vector from the tracer to the point, and its length"""


def length(*more: Variable) -> Acting:
    """Return the length as a place to act: itself, time, temperature, nominal coordinates, its beam, and more."""
    path = Variable("distance", "mm", _path, (TRACER,))
    return scalar("length", Quantity.LENGTH, "mm", AT, path, *DIRECTION, *more)


_HARTIG = "Härtig et al., Coordinate Measurement Technique Considering the 3D-Abbe Principle,"


def _refraction(by: str, condition: str, need: str, rate: tuple[Parameter, ...], usual: str) -> Effect:
    def link(block: str, where: Mapping[str, str]) -> Link:
        return BeamScale(block, condition=condition)

    return Effect(
        "refraction-drift",
        "the refractive index of the air changes during the measurement without being corrected",
        rate,
        link,
        by=by,
        needs=(need,),
        confused_with=("dead-path-drift", "tracer-drift"),
        formula=f"l + l0 *= 1 + rate {by}",
        usual=usual,
        reveal="temperature and pressure of the air with each reading; the first points again at the end",
        source="Birch and Downs 1994, at 20 °C, 1013 hPa, 50 %: -0.955 ppm/K at constant relative humidity, "
        "-0.930 ppm/K at constant vapour pressure, +0.268 ppm/hPa",
    )


LENGTH_EFFECTS: tuple[Effect, ...] = (
    Effect(
        "tracer-scale",
        "the wavelength or the air correction of one tracer is wrong",
        sizes("scale", "ratio", "5 ppm"),
        lambda block, where: BeamScale(block),
        where=("tracer",),
        confused_with=("dead-path-drift", "sphere-form", "length-scale"),
        formula="l + l0 *= 1 + scale",
        note="1 K of air is 0.96 ppm, 1 hPa 0.27 ppm. With `scale:` in the job the scales are unknowns already.",
        usual="0.1 to 5 ppm",
        reveal="a calibrated length, or the same points from another place of this tracer",
        source=f"{_HARTIG} eq. 1; EUROMET 610: 14 to 460 nm/m between systems",
    ),
    Effect(
        "length-scale",
        "all lengths are too long or too short in proportion: the common wavelength, air correction or unit is wrong",
        sizes("scale", "ratio", "5 percent"),
        lambda block, where: BeamScale(block),
        confused_with=("length-offset",),
        formula="l + l0 *= 1 + scale",
        note="A free network absorbs it exactly: points and tracers grow with it.",
        usual="0.1 to 20 ppm",
        reveal="a calibrated length (inputs: distances), or points known by sigma_mm",
        source=f"{_HARTIG} eq. 4",
    ),
    Effect(
        "length-offset",
        "all absolute distances are off by the same amount: zero error of the instrument, delay of its electronics",
        sizes("offset", "length", "1 m"),
        lambda block, where: Shift(block, Quantity.LENGTH),
        confused_with=("length-scale",),
        formula="l += offset",
        note="With `measures: changes` the dead paths absorb it exactly.",
        usual="1 um to 1 m",
        reveal="distances from short to long, or the same line measured in parts",
        source="zero constant of distance meters: Rüeger, Electronic Distance Measurement",
    ),
    _refraction("T", WARMING, "temp", sizes("rate", "expansion", "2e-6 1/K"), "5e-7 to 2e-6 1/K"),
    _refraction("t", ELAPSED, "t", sizes("rate", "rate", "10 ppm/h"), "0.1 to 10 ppm/h"),
    Effect(
        "air-gradient",
        "the refractive index of the air changes with height: the room is warmer under its roof",
        sizes("gradient", "curvature", "5e-9 1/mm"),
        lambda block, where: AirGradient(block),
        confused_with=("length-scale", "tracer-scale"),
        formula="l *= 1 + gradient (z - z0)/2    # z, z0: heights of point and tracer, along z of the points' frame",
        note="1 K/m is 9.55e-10 1/mm, which changes 5 m upwards by 12 um.",
        usual="2e-10 to 5e-9 1/mm",
        reveal="the temperature of the air at two heights",
        source="Birch and Downs 1994: -0.955 ppm/K, so 1 K/m is -9.55e-10 1/mm",
    ),
    Effect(
        "dead-path-drift",
        "the dead path of one tracer grows: its stand, its optics or the air in it warm up",
        sizes("rate", "speed", "1 um/min"),
        lambda block, where: Shift(block, Quantity.LENGTH, condition=ELAPSED),
        where=("tracer",),
        needs=("t",),
        confused_with=("tracer-drift", "refraction-drift"),
        formula="l += rate t",
        note="Up to 1 um/h in good conditions, more on a fresh stand. A distant tracer that moves along its "
        "mean beam looks the same.",
        usual="0.05 um/h to 1 um/min",
        reveal="the first points again at the end, in widely different directions from this tracer",
        source="Schwenke et al. 2008, Geometric error measurement and compensation of machines, CIRP Annals 57",
    ),
    Effect(
        "dead-path-jump",
        "the beam of one tracer was interrupted and recovered, or the tracer was displaced along the beam",
        sizes("step", "length", "1 mm"),
        lambda block, where: Shift(block, Quantity.LENGTH, since="t"),
        where=("tracer",),
        scanned=(Parameter("at", "time", grid=change_points),),
        needs=("t",),
        confused_with=("dead-path-drift", "tracer-drift"),
        formula="l += step for t_s >= at",
        note="Often a multiple of half a wavelength, 0.316 um.",
        usual="0.3 um to 1 mm",
        reveal="points measured before and after the jump",
        source="Teunissen 2018, Distributional theory for the DIA method, J. Geodesy 92 (step in the mean)",
    ),
    Effect(
        "tracer-drift",
        "one tracer moves on its stand during the measurement",
        sizes("vx vy vz", "speed", "1 um/min"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, sign=-1.0, condition=ELAPSED),
        where=("tracer",),
        needs=("t",),
        turns=True,
        confused_with=("dead-path-drift",),
        formula="x0 += (vx, vy, vz) t",
        note="From far away only the movement along the beams shows.",
        usual="1 to 50 um/h",
        reveal="the first points again at the end, in three widely different directions from this tracer",
        source="Schwenke et al. 2008, CIRP Annals 57",
    ),
    Effect(
        "sphere-form",
        "the reference sphere of one tracer is out of round",
        sizes("c2 s2", "length", "10 um"),
        lambda block, where: LengthTerms(block, (COS_2A, SIN_2A)),
        where=("tracer",),
        confused_with=("tracer-scale",),
        formula="l += c2 cos 2a + s2 sin 2a    # a: azimuth of the beam",
        note="Points all around the tracer show it, points in one quadrant hardly do.",
        usual="0.02 to 0.3 um",
        reveal="the points again with this tracer turned by 45 degrees about its vertical axis",
        source="the first harmonic of the azimuth equals a shift of the centre; the second is the lowest observable",
    ),
    Effect(
        "reflector-incidence",
        "the length changes with the angle at which the beam enters the reflector",
        sizes("c", "length", "20 um"),
        lambda block, where: Shift(block, Quantity.LENGTH, condition=INCIDENCE),
        confused_with=("tracer-scale",),
        formula="l += c (1 - cos i)    # i: angle at the reflector between its axis, +z, and the beam",
        note="With one common reflector axis the positions and dead paths of the tracers absorb it exactly: it "
        "moves the tracers, not the points.",
        usual="0.5 to 20 um",
        reveal="points measured again with the reflector turned to another direction",
        source="Lin et al. 2002; Ouyang et al. 2007 (corner cubes within 20 degrees)",
    ),
    Effect(
        "reseated-reflector",
        "the reflector was taken out of its nest, put back, and sits in another place",
        sizes("dx dy dz", "length", "1 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, since="t"),
        scanned=(Parameter("at", "time", grid=change_points),),
        needs=("t",),
        confused_with=("tracer-drift", "dead-path-jump"),
        formula="x += (dx, dy, dz) for t_s >= at, in the lengths of all tracers",
        note="Points that are measured only once absorb it.",
        usual="0.5 to 20 um",
        reveal="some points measured both before and after the reflector is touched",
        source="geodetic practice: closing points",
    ),
    Effect(
        "moved-point",
        "one length is wrong",
        sizes("step", "length", "10 m"),
        lambda block, where: Shift(block, Quantity.LENGTH),
        where=("point", "tracer"),
        formula="l += step",
        note="`diagnose` lists it as a wrong reading. With four tracers every other length of the point "
        "explains it equally well.",
        reveal="this point measured again by this tracer",
        source="Baarda 1968 (mean shift of one reading)",
        of_one_reading=True,
    ),
)
"""The effects in the order of lists"""
