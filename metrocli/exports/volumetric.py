"""Common parts of formats that hold the whole rigid-body model: comments, and a model of the control."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from metrocli.exports.error_tables import AXES, Array, Curve, ErrorTables

_CHAIN = re.compile(r"axes from the workpiece to the tool: (\w+); tool ([^ ]+) ([^ ]+) ([^ ]+) mm")


def chain_note(tables: ErrorTables) -> list[str]:
    """Return the comments with what the rigid-body model needs besides the tables: order of axes, tool and units."""
    tool = " ".join(f"{offset:.6f}" for offset in tables.tool)
    return [
        f"axes from the workpiece to the tool: {tables.order}; tool {tool} mm",
        "mm and rad; straightness is free of its end-point line, squareness is the angle of these lines",
    ]


def trial_move(tables: ErrorTables) -> list[str]:
    """Return the comment that describes a test move, by which the user checks the sign on the machine."""
    own = [(name, curve) for name, curve in tables.curves.items() if name[1] == name[2]]
    name, curve = (own or list(tables.curves.items()))[0]
    k = int(np.argmax(np.abs(curve.values)))
    return [
        "no public manual confirms whether the control expects errors or corrections. Test move: switch the "
        f"compensation on and go to {name[2]} = {curve.positions[k]:.3f} mm. {name[1]} must move by "
        f"{-curve.values[k]:+.4f} mm (the part of {name} alone). If it moves the other way, set the control's switch "
        "that negates the values"
    ]


def moved_by_errors(
    curves: Mapping[str, Curve], squareness: Mapping[str, float], comments: Iterable[str], commanded: Array
) -> Array:
    """Return the movement, (n, 3) mm, by a control with the same rigid-body model: the negative error.

    Raises ValueError if the comments do not name the order of the axes and the tool.
    """
    found = _CHAIN.search("\n".join(comments))
    if found is None:
        raise ValueError("the comments do not name the chain")
    tool = (float(found[2]), float(found[3]), float(found[4]))
    ranges = {axis: (float(where.min()), float(where.max())) for axis, where in zip(AXES, commanded.T, strict=True)}
    held = ErrorTables(dict(curves), dict(squareness), found[1], tool, ranges)
    return -held.at(commanded)
