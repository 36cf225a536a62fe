"""A simulated measurement, as `metrocli simulate` writes it: tables, pictures and true values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field

from metrocli.arrays import Picture
from metrocli.frozen import dataclass
from metrocli.table import Table


@dataclass(frozen=True)
class SimulationOptions:
    """Options of the command line for a simulation."""

    seed: int = 0
    """Seed of the random numbers."""
    images: bool = False
    """Render pictures, not only the table of observed points."""


@dataclass(frozen=True)
class Simulation:
    """A simulated measurement."""

    files: Mapping[str, Table]
    """By file name relative to the folder that is written, such as `observations.csv`."""
    truth: Mapping[str, float] = field(default_factory=dict)
    """True values by the name of the estimate, in its internal unit."""
    pictures: Sequence[tuple[str, Callable[[], Picture]]] = ()
    """Path relative to the folder, and a function that renders the picture when it is written."""
