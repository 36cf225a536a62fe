"""Effects on points that are laid onto nominal ones."""

from __future__ import annotations

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import point, seen_from
from metrocli.effects.effect import Effect, sizes
from metrocli.effects.links.points import LinearTerms, Shift

MEASURED = Quantity.POINT_IN_PART
"""The points as measured"""
SCALE = "scale"
"""Block of the scale, less 1"""
EXPANSION = "part-expansion"
PLACES = (
    point("point-in-part", MEASURED, ("point",), *seen_from()),
    point("point-in-machine", Quantity.POINT_IN_MACHINE, ("point",), *seen_from()),
)
"""Quantities on which user-defined effects can act: points as measured, and in the frame of the nominal list"""
EFFECTS: tuple[Effect, ...] = (
    Effect(
        EXPANSION,
        "the part is warmer or colder than its nominal places are for, or one of the lists has a wrong scale",
        sizes("scale", "ratio", "2000 ppm"),
        columns_of=SCALE,
        confused_with=("machine-scale",),
        formula="X_nominal = (1 + scale) R X_measured + d",
        note="`scale: true` in the job is the same. A warm part has a negative scale.",
        usual="5 to 500 ppm",
        reveal="the temperature of the part; a calibrated length on it",
        source="ISO 1; 11.5 ppm/K for steel, 23 ppm/K for aluminium",
    ),
    Effect(
        "machine-scale",
        "the scale of one axis of the machine that measured is wrong",
        sizes("scale", "ratio", "2000 ppm"),
        lambda block, where: LinearTerms(block, MEASURED, (("xyz".index(where["axis"]), "xyz".index(where["axis"])),)),
        where=("axis",),
        confused_with=(EXPANSION, "machine-squareness"),
        formula="X_measured along the axis *= 1 + scale",
        usual="5 to 500 ppm",
        reveal="a calibrated length along each axis of that machine; the part measured again, turned",
        source="ISO 10360-2: lengths in several directions",
    ),
    Effect(
        "machine-squareness",
        "two axes of the machine that measured are not square to each other",
        sizes("angle", "angle", "2 mrad"),
        lambda block, where: LinearTerms(
            block, MEASURED, (("xyz".index(where["pair"][0]), "xyz".index(where["pair"][1])),)
        ),
        where=("pair",),
        confused_with=("machine-scale",),
        formula="xy: x_measured += angle y; xz: x_measured += angle z; yz: y_measured += angle z",
        usual="5 urad to 1 mrad",
        reveal="calibrated lengths along the diagonals of that machine; the part measured again, turned",
        source="ISO 10360-2: lengths in several directions; ISO 230-1: squareness",
    ),
    Effect(
        "moved-point",
        "a point is not at its nominal place: it was knocked, mistaken for another, or measured wrongly",
        sizes("dx dy dz", "length", "10 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, sign=-1.0),
        where=("point",),
        of_all="points deviate throughout: the part is not as its nominal list, or was measured less well than stated",
        formula="X_nominal = .. - (dx, dy, dz)    # (dx, dy, dz): from the nominal place to the measured one",
        usual="0.01 to 10 mm",
        reveal="this point measured again, from another station",
        source="Baarda 1968 (test of a group of readings)",
    ),
)
"""The table of effects in the order of lists"""
