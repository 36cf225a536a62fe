"""The chain of the axes of a machine from workpiece to tool, and the errors that words such as "rotary" mean there."""

from __future__ import annotations

import re
from collections.abc import Sequence

from metrocli.instruments.axes.rotary import SPINDLE_NAMES, location_names
from metrocli.instruments.machine import ANGLES, AXES, SQUARENESS_NAMES, errors_of

_MARKED = "such as wCAbXYZt (two tables), wCbXYZBt (head and table) or wbXYZCAt (two heads)"
_EACH_ONCE = f"each of X, Y, Z and at most two of A, B, C once, and b for the bed, {_MARKED}"
WORDS = ("all", "rotary", "locations", "linear", "squareness")
"""Words for several errors in `estimate:`"""


def chain_of(text: str) -> tuple[str, ...]:
    """Return the letters of the axes from the workpiece to the tool, and `b` for the bed, from a text like `wCAbXYZt`.

    A machine without rotary axes has three linear ones, and its bed need not be marked: what it splits makes no
    difference to first order. Raises ValueError if the text is not such a chain.
    """
    letters = tuple(re.sub(r"^w|t$", "", re.sub(r"[\s\[\]]", "", text)))
    linear, turning = ([letter for letter in letters if letter in kind] for kind in (AXES, ANGLES))
    if set(letters) - {*AXES, *ANGLES, "b"} or len(set(letters)) < len(letters) or len(turning) > 2:
        raise ValueError(f"'{text}' is not a chain of axes from workpiece to tool: {_EACH_ONCE}")
    if turning and "b" not in letters:
        raise ValueError(f"'{text}' does not mark the bed with b: it decides which axes turn the workpiece; {_MARKED}")
    if not turning and len(linear) != 3:
        raise ValueError(f"'{text}' is not a chain of the axes X, Y and Z from workpiece to tool, such as wXbYZt")
    return letters


def axis_order(chain: str) -> tuple[int, ...]:
    """Return the order of the linear axes (0 for X) from the workpiece to the tool; ValueError as in `chain_of`."""
    return tuple(AXES.index(letter) for letter in chain_of(chain) if letter in AXES)


def errors_by_word(chain: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the errors of a machine that each word stands for; chain holds its axes from workpiece to tool, and b.

    The zero position of a rotary axis is 0 by definition, except of a head that carries the tool, where it is the tilt
    of the spindle in that plane; then two angles of the spindle are unknown too. All other tools have the machine's
    axes. Of tables alone, with nothing that moves the tool, the axis next to the bed is the frame: it has no location.
    So it is in a mount, of heads alone. There no reading shows the other axis, or the tool, along it or about it.
    """
    linear, turning = ([name for name in kind if name in chain] for kind in (AXES, ANGLES))
    carries = chain[-1] if chain[-1] in ANGLES else ""
    mount = chain[0] == "b" and not linear
    frame = chain[1] if mount else chain[-2] if chain[-1] == "b" and not linear else ""
    placed = [letter for letter in turning if letter != frame]
    places = [
        name for letter in placed for name in location_names(letter)[: 5 if letter == carries and not mount else 4]
    ]
    if mount:
        places = [name for name in places if name[1] not in (frame, AXES[ANGLES.index(frame)])]
    else:
        places += [name for name in SPINDLE_NAMES if carries and name[1] != carries]
    tables = {letter: errors_of(letter) for letter in (*linear, *turning)}
    words = {
        "linear": tuple(name for letter in linear for name in tables[letter]),
        "squareness": tuple(
            name for name, pair in zip(SQUARENESS_NAMES, ("YZ", "XZ", "XY"), strict=True) if set(pair) <= set(linear)
        ),
        "locations": tuple(places),
        "rotary": (*(name for letter in turning for name in tables[letter]), *places),
    }
    return {"all": (*words["linear"], *words["squareness"], *words["rotary"]), **words}
