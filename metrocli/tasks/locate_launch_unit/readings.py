"""Aligned poses of receiver and launch unit, and the columns of their files."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array, Mask
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import wrapped
from metrocli.instruments.launch_start import Beams
from metrocli.table import Columns, Table, columns
from metrocli.tasks.shared.environment import WEATHER, Air, Environment, air_of, unused
from metrocli.tasks.shared.lists import SIGMAS, sigmas

ANGLES = ("phi1", "phi2", "phi3", "phi4")
_PLACE = columns("pose [text]", "x y z [length]", "spindle [angle]")
_CONDITIONS = (*columns("t? [time]", "temp? [temperature]"), *WEATHER)
POSES = Columns(
    (*_PLACE, *columns("phi1 phi2 phi3 phi4 [angle]", "distance?* [length]"), *_CONDITIONS, *SIGMAS),
    ("pose",),
    "receiver positions and encoder angles of aligned poses",
    measured=ANGLES,
)
PLACES = Columns((*_PLACE, *_CONDITIONS), ("pose",), "receiver positions to measure at")
_STEEP = 1.7e-3
"""Cosine of the tilt of the steepest beam with a usable base angle, 0.1 degrees from vertical"""

_MOVED = 1e-3
"""An angle that changes by less than this [rad] keeps the sense of its last move"""


@dataclass(frozen=True)
class AlignedPoses:
    """n aligned poses."""

    names: tuple[str, ...]
    receiver: Array
    """Positions of the receiver's control point, (n, 3)"""
    sigma: Array
    """Standard uncertainties of these coordinates, (n, 3): 0 if exact, nan if unknown"""
    spindle: Array
    """Angle of the spindle, psi, (n,)"""
    angles: Array
    """Encoder angles phi1 phi2 phi3 phi4, (4, n)"""
    distance: Array
    """Distance of the control points, (n,), nan if not measured"""
    conditions: dict[str, Array]
    file: str = ""
    air: Air | None = None
    """The air at the distances, for which they are corrected, if the job gives it"""
    warnings: tuple[str, ...] = ()

    @property
    def level(self) -> Mask:
        """Poses with a base angle: their beam is more than 0.1 degrees from vertical, (n,)."""
        return np.asarray((np.abs(np.cos(self.angles[1:3])) > _STEEP).all(axis=0))

    @property
    def turned(self) -> Array:
        """Sense in which each angle reached its pose, by the shorter way from the pose before, (4, n).

        It is 1 or -1; 0 for an angle that never moves. The first pose has the sense of the move that follows it.
        """
        n = len(self.names)
        order = np.argsort(self.conditions.get("t", np.arange(n)), kind="stable")
        change = wrapped(np.diff(self.angles[:, order], prepend=self.angles[:, order[:1]]))
        sense = np.where(np.abs(change) > _MOVED, np.sign(change), 0.0)
        first = np.argmax(sense != 0, axis=1)[:, None]
        last = np.maximum(np.maximum.accumulate(np.where(sense != 0, np.arange(n), 0), axis=1), first)
        turn = np.zeros_like(sense)
        turn[:, order] = np.take_along_axis(sense, last, axis=1)
        return turn

    @property
    def beams(self) -> Beams:
        """The beams in the machine, as the angles of the receiver describe them."""
        phi1, phi2, phi3, phi4 = self.angles
        launch_base = phi1 + np.where(np.cos(phi2) < 0, np.pi, 0.0)
        return Beams(self.receiver, self.spindle + phi4, phi3, launch_base, self.distance)


def read(table: Table, environment: Environment | None = None) -> AlignedPoses:
    """Return the poses of a table, corrected for the air of the job; raises InputError that lists all its faults."""
    faults = list(_faults(table))
    if faults:
        raise InputError(faults)
    known = any(name.startswith("sigma") for name in table)
    receiver, distance = table.stacked("xyz"), table.numbers("distance", float("nan"))
    air = air_of(environment, table) if np.isfinite(distance).any() else None
    idle = environment is not None and air is None
    return AlignedPoses(
        tuple(table.texts("pose")),
        receiver,
        sigmas(table) if known else np.zeros_like(receiver),
        table.numbers("spindle"),
        np.stack([table.numbers(angle) for angle in ANGLES]),
        distance if air is None else distance * air.towards,
        table.conditions("t", "temp"),
        table.file,
        air,
        (f"{table.file}: no pose has a distance, so `environment:` changes nothing",)
        if idle
        else unused(environment, table),
    )


def _faults(table: Table) -> Iterator[Fault]:
    if len(table) == 0:
        yield table.fault("there are no poses")
    distance = table.numbers("distance", float("nan"))
    for row in np.flatnonzero(distance <= 0).tolist():
        yield table.fault_at(row, f"pose {table.texts('pose')[row]}: the distance is not above zero")
