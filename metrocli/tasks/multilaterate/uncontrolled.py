"""Errors that no residual of a multilateration can show, because the points absorb them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from metrocli import units
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.multilaterate.problem import DISTANCES, Network

if TYPE_CHECKING:
    from metrocli.table import Values


def uncontrolled(network: Network) -> Table:
    """Return effects that the points absorb, the error of the points from each, and what would control it.

    The error in `hides` is that of the plausible cause in `assumed`, and is proportional to it.
    """
    rows = list(_rows(network)) if network.unknown[network.seen > 0].any() else []
    types = {"effect": str, "assumed": str, "hides": float, "control": str}
    columns: dict[str, Values] = {
        name: np.array([row[i] for row in rows], dtype=kind) for i, (name, kind) in enumerate(types.items())
    }
    return Table(columns, {"hides": "mm"})


def in_words(hidden: Table) -> tuple[str, ...]:
    """Return the lines of a summary of the uncontrolled effects; empty if every point is known."""
    if not len(hidden):
        return ()
    rows = zip(*(hidden.texts(name) for name in ("effect", "assumed")), hidden.numbers("hides"), strict=True)
    lines = [f"  {effect}: {units.roughly(size, 'um')} by {assumed}" for effect, assumed, size in rows]
    return ("", "not controlled by this design (table not_controlled lists what would control it):", *lines)


def _rows(network: Network) -> Iterator[tuple[str, str, float, str]]:
    seen = network.nominal[network.seen > 0]
    extent = float(np.linalg.norm(np.ptp(seen, axis=0)))
    index, growth = units.parse_quantity("0.96 ppm", "ratio"), units.parse_quantity("1.15 ppm", "ratio")
    moved = units.parse_quantity("2 um", "length")
    if not _scaled(network):
        control = (
            "a known length (inputs: distances), or two points known by sigma_mm; temperature and pressure of the air"
        )
        yield "common error of the refractive index", "1 K of air temperature (0.96 um/m)", index * extent, control
    yield (
        "common drift of tracers or part",
        "2 um over the measurement",
        moved,
        "closing points: the first points measured again at the end, under new names",
    )
    yield (
        "growth of part or mover",
        "0.1 K of steel (1.15 um/m)",
        growth * extent,
        "temperature of the part with each point; closing points",
    )
    yield (
        "re-seated reflector",
        "2 um in its seat",
        moved,
        "closing points measured before and after each time the reflector is touched",
    )


def _scaled(network: Network) -> bool:
    """Return whether known lengths or places determine the scale."""
    known = int((~network.unknown & (network.seen > 0)).sum())
    fixed = int((~network.blocks[t.TRACER].free[:, :3]).all(axis=1).sum())
    bars = any(group.name == DISTANCES for group in network.others)
    held = {
        i
        for group in network.others
        if group.name == DISTANCES
        for i in group.observations.index[t.POINT].ravel().tolist()
    }
    return bars or known - len(held) >= 2 or fixed >= 2
