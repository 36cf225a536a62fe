"""Effects on the views of a ball grid."""

from __future__ import annotations

from dataclasses import replace

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import Acting, commanded, point, seen_from
from metrocli.effects.effect import ELAPSED, Effect, Parameter, change_points, sizes
from metrocli.effects.links.points import BallShift, Growth, LinearTerms, Shift
from metrocli.instruments.ball_grid import HOLLOW

AXES = ("x", "y", "z")


_PLACES = ("view", "ball", "axis")


def _place(name: str, quantity: Quantity) -> Acting:
    return replace(point(name, quantity, _PLACES, *seen_from()), of_place={"axis": lambda axis: commanded(axis)[:1]})


PLACES = (
    _place("coordinates", Quantity.MACHINE_READING),
    _place("point-in-machine", Quantity.POINT_IN_MACHINE),
    _place("point-on-table", Quantity.BALL_ON_TABLE),
    _place("point-in-artefact", Quantity.BALL_IN_ARTEFACT),
)
"""Quantities on which user-defined effects can act"""


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "artefact-expansion",
        "the artefact is warmer or colder in one view than in the first",
        sizes("scale", "ratio", "50 ppm"),
        lambda block, where: Growth(block, Quantity.BALL_IN_ARTEFACT),
        where=("view",),
        not_first=("view",),
        confused_with=("axis-expansion", "artefact-bending", "drift-in-view"),
        formula="x *= 1 + scale, for every ball x of the artefact in that view",
        note="In the first view it cannot be separated from the size of the artefact.",
        usual="1 to 50 ppm",
        reveal="the temperature of the artefact in each view; this view again after a rest",
        source="ISO 15530-3 (thermal effects); aluminium grows by 23 ppm/K, steel by 11.5 ppm/K",
    ),
    Effect(
        "artefact-bending",
        "the artefact bends under its own weight or its clamps in one view",
        sizes("b", "curvature", "1e-6 1/mm"),
        lambda block, where: Shift(block, Quantity.MACHINE_READING, sign=-1.0, condition=HOLLOW, first=2),
        where=("view",),
        confused_with=("artefact-expansion", "axis-expansion"),
        formula="z -= b (rho² - mean rho²)    # machine z; rho: horizontal distance from the artefact's centre",
        note="2 um at 100 mm from the centre is 2e-7 1/mm. Four views with one shift along x show only a part "
        "of it; the rest goes into the machine error.",
        usual="1e-8 to 1e-6 1/mm",
        reveal="views shifted along y and along z as well as along x",
        source="Roark, Formulas for stress and strain: a plate on supports; EURAMET guides on ball plates",
    ),
    Effect(
        "drift-in-view",
        "machine and artefact move against each other while one view is measured",
        sizes("vx vy vz", "speed", "20 um/h"),
        lambda block, where: Shift(block, Quantity.MACHINE_READING, condition=ELAPSED),
        where=("view",),
        needs=("t",),
        confused_with=("axis-expansion", "reseated-artefact", "artefact-expansion"),
        formula="x += (vx, vy, vz) t",
        note="Balls measured layer by layer make time nearly a coordinate: a drift then looks like a scale or "
        "squareness error in that view. The column `repeat` marks repeated balls.",
        usual="1 to 20 um/h",
        reveal="the first balls again at the end of the view, or the view forth and back",
        source="ISO 230-3 (drift with time)",
    ),
    Effect(
        "reseated-artefact",
        "the artefact was knocked or seated anew in the middle of one view",
        sizes("dx dy dz", "length", "0.1 mm"),
        lambda block, where: Shift(block, Quantity.MACHINE_READING, since="t"),
        where=("view",),
        scanned=(Parameter("at", "time", grid=change_points),),
        needs=("t",),
        confused_with=("drift-in-view",),
        formula="x += (dx, dy, dz) for t_s >= at, in that view",
        usual="1 to 100 um",
        reveal="the first balls again at the end of the view",
        source="Teunissen 2018, Distributional theory for the DIA method, J. Geodesy 92 (step in the mean)",
    ),
    Effect(
        "moved-ball",
        "one ball came loose and sits elsewhere from one view on",
        sizes("dx dy dz", "length", "0.1 mm"),
        lambda block, where: BallShift(block),
        where=("ball",),
        scanned=(Parameter("from_view", place="view"),),
        not_first=("view",),
        formula="x += (dx, dy, dz), for that ball in the view from_view and all later ones",
        note="Where from_view is the last view, it cannot be separated from a wrong reading.",
        usual="1 to 100 um",
        reveal="the first view again at the end",
        source="Baarda 1968 (mean shift of some readings)",
    ),
    Effect(
        "axis-expansion",
        "the scale of one axis of the machine is warmer or colder in one view",
        sizes("scale", "ratio", "50 ppm"),
        lambda block, where: LinearTerms(
            block, Quantity.MACHINE_READING, ((AXES.index(where["axis"]), AXES.index(where["axis"])),)
        ),
        where=("view", "axis"),
        confused_with=("artefact-expansion", "artefact-bending", "drift-in-view"),
        formula="x_axis *= 1 + scale, about the centre of the grid, in that view",
        note="In a view turned about one axis, the other two axes cannot be separated.",
        usual="1 to 50 ppm",
        reveal="the temperature of the scales in each view; this view again after a rest",
        source="ISO 230-1:2012 (EXX, EYY, EZZ); steel scales 11.5 ppm/K",
    ),
)
"""The effects in the order of lists"""
