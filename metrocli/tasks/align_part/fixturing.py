"""Corrections of the fixture: how far each support of the part is raised until the part is level in the machine."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.errors import InputError
from metrocli.geometry.rotations import rotation_from_euler
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.units import format_quantity

SUPPORTS = Columns(
    (Column("support", TEXT), Column("x", "length"), Column("y", "length")),
    key=("support",),
    description="supports of the part, in the machine, that raise it along z",
)
FEWEST = 3
_STEP = 1e-6
"""Turn of a difference [rad]"""


def must_level(supports: Table) -> None:
    """Raise InputError if supports cannot turn a part about x and y: fewer than three, or all on one line."""
    places = supports.stacked(("x", "y"))
    if len(places) < FEWEST:
        raise InputError([supports.fault(f"{len(places)} supports; a part is levelled by {FEWEST} or more")])
    sizes = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if sizes[1] < 1e-3 * sizes[0]:
        raise InputError([supports.fault("all supports lie on one line", "add one beside it")])


def raises(angles: Array, places: Array) -> Array:
    """Return how far each support (n, 2) is raised so that the part's z axis is that of the machine (n,), least 0.

    With k = R e_z the part's plane falls by (kx, ky)/kz; what is raised by as much is level.
    """
    k = rotation_from_euler(*angles)[:, 2]
    heights = places @ (k[:2] / k[2])
    return np.asarray(heights - heights.min())


def corrections(values: Array, covariance: Array, supports: Table) -> Table:
    """Return the table `supports`: what to raise, by how much, in the order to turn the screws, the largest first.

    `values` (6,) and `covariance` (6, 6) are those of x, y, z, alpha, beta, gamma. Raises InputError as `must_level`.
    """
    must_level(supports)
    places = supports.stacked(("x", "y"))
    size = raises(values[3:6], places)
    lowest = int(size.argmin())

    def relative(angles: Array) -> Array:
        found = raises(angles, places)
        return np.asarray(found - found[lowest])

    by_angle = np.stack(
        [(relative(values[3:6] + h) - relative(values[3:6] - h)) / (2 * _STEP) for h in _STEP * np.eye(3)], axis=1
    )
    std = np.sqrt(np.einsum("na,ab,nb->n", by_angle, covariance[3:6, 3:6], by_angle))
    order = np.argsort(-size, kind="stable")
    return Table(
        {
            "support": np.array(supports.texts("support"), dtype=str)[order],
            "x": places[order, 0],
            "y": places[order, 1],
            "raise": size[order],
            "raise_std": std[order],
        },
        dict.fromkeys(("x", "y", "raise", "raise_std"), "mm"),
    )


def in_words(values: Array, covariance: Array, found: Table) -> Iterator[str]:
    """Yield what the operator does, and what is left for the zero point of the machine."""
    steps = zip(found.texts("support"), found.numbers("raise"), found.numbers("raise_std"), strict=True)
    yield "to level the part, raise the supports in this order:"
    for name, size, std in steps:
        yield f"    {name}: {format_quantity(size, 'mm', std)}" if std > 0 else f"    {name}: stays"
    turn = format_quantity(float(values[5]), "rad", float(np.sqrt(covariance[5, 5])))
    yield f"left for the machine: turn about z by gamma = {turn}; measure again for the zero point"
