"""What `metrocli simulate` writes: tables, pictures and the truth behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from metrocli.table import Table

if TYPE_CHECKING:
    from metrocli.imageset import Picture


@dataclass(frozen=True)
class SimulationOptions:
    """What the command line says about a simulation."""

    seed: int = 0
    images: bool = False
    """Render pictures, not only the table of observed points."""


@dataclass(frozen=True)
class Simulation:
    """A simulated measurement."""

    files: Mapping[str, Table]
    """By file name relative to the folder that is written, such as `observations.csv`."""
    truth: Mapping[str, float] = field(default_factory=dict)
    """By the name of the estimate, in its internal unit."""
    pictures: Iterable[tuple[str, Callable[[], Picture]]] = ()
    """Path relative to the folder, and what renders the picture when it is its turn."""
