"""What `metrocli plan` is asked for."""

from __future__ import annotations

from metrocli.frozen import dataclass
from metrocli.nc_program import CONTROLS
from metrocli.settings import Choice, ListOf, Number, Whole, WithUnit, setting


@dataclass(frozen=True)
class PathPlan:
    """What the path, points or lines of `metrocli plan` must reach, and what they may cost."""

    length: float | None = setting(
        WithUnit("length", positive=True),
        "on-the-fly: longest path (default: length of all edges and diagonals)",
        default=None,
    )
    ratio: float = setting(Number(above=1.0), "largest ratio of volume error to path misfit", default=4.0)
    feed: float = setting(WithUnit("speed", positive=True), "feed of the NC program", default=40.0)
    sampling: float = setting(WithUnit("time", positive=True), "time between points of the tracker", default=0.002)
    tracker: tuple[float, ...] | None = setting(
        ListOf(WithUnit("length"), 3), "place of the tracker in the machine", default=None
    )
    time: float = setting(WithUnit("time", positive=True), "lengths: longest measurement", default=4 * 3600.0)
    uncertainty: float | None = setting(
        WithUnit("length", positive=True),
        "lengths, rotary axes: wanted standard uncertainty of the error vector over the volume",
        default=None,
    )
    setup: float = setting(WithUnit("time", minimum=0.0), "lengths: time to set up a station", default=900.0)
    seed: int = setting(Whole(0), "on-the-fly: seed of the random chords", default=1)
    control: str = setting(Choice(*CONTROLS), "control that the NC program is for", default="linuxcnc")
