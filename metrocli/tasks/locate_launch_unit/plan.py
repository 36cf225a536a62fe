"""The plan of a measurement with a located launch unit: lines, margins, further poses, and NC programs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.plan import Plan
from metrocli.result import ShownTable
from metrocli.table import Table
from metrocli.tasks.locate_launch_unit import KIND
from metrocli.tasks.locate_launch_unit.lines import (
    AXES,
    ProgramMotion,
    Reach,
    ReceiverLine,
    commanded,
    farthest_corner,
    line_program,
    measurable,
)
from metrocli.tasks.locate_launch_unit.margin import (
    Further,
    Margin,
    SafetyRequirements,
    Uncertainty,
    Window,
    beam_position,
    candidates,
    further,
    information,
)
from metrocli.tasks.locate_launch_unit.report import place_of_unit
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise, PlannedLines
from metrocli.tasks.locate_launch_unit.solve import Located
from metrocli.units import find_unit

_SHOWN_OF_LINES = (
    "line", "points", "near", "far", "probability", "probability_at_range", "safe_distance", "probability_aligned",
)  # fmt: skip


@dataclass(frozen=True)
class Prospect:
    """The measurable lines of a located unit, with the noise that limits their beams."""

    located: Located
    planned: PlannedLines
    noise: LaunchUnitNoise
    lines: tuple[ReceiverLine, ...]

    @property
    def uncertain(self) -> Uncertainty:
        """Uncertainty of the location and of the encoders."""
        return Uncertainty(self.located.covariance, self.noise.encoder)

    @property
    def wanted(self) -> SafetyRequirements:
        """What further poses must achieve."""
        return SafetyRequirements(self.lines, self.window, self.planned.confidence)

    @property
    def window(self) -> Window:
        """Range of the receiver."""
        return Window(self.planned.range.straightness, self.planned.range.angle)


def planned_measurement(located: Located, planned: PlannedLines, noise: LaunchUnitNoise) -> Plan:
    """Return the plan; raises UndeterminedError if no line can be measured from the place of the unit."""
    reach = Reach(planned.axes.box, planned.step, planned.standoff, planned.range.distance)
    lines, refused = measurable(located.place, [*AXES, *planned.diagonals], reach)
    reasons = tuple(f"line {name} cannot be measured: {reason}" for name, reason in refused.items())
    if not lines:
        cure = (
            "what would allow it: a unit within the ranges of the axes, near a corner; a smaller `standoff` or `step`"
        )
        raise UndeterminedError("\n  ".join(["no line can be measured from where the unit stands", *reasons, cure]))
    prospect = Prospect(located, planned, noise, tuple(lines))
    margins = _margins(prospect)
    more = _further(prospect, reach)
    files, blocked = _programs(prospect)
    return Plan(
        kind=KIND.name,
        notes=(*_notes(prospect, more), *_notes_on_alignment(prospect, more)),
        figures=place_of_unit(located, located.covariance),
        tables={"lines": margins, "points": _points(lines), **_further_table(prospect, more)},
        files=files,
        warnings=(*reasons, *blocked),
        shown=(
            ShownTable("lines", _SHOWN_OF_LINES),
            *((ShownTable("further_poses"),) if more else ()),
        ),
    )


def _margins(prospect: Prospect) -> Table:
    """Return /lines: points and distances, angles to command, and probabilities that the beam stays in range."""
    planned, lines = prospect.planned, prospect.lines
    errors, limit = prospect.uncertain.draws(), planned.range.distance
    margins = [Margin(line, prospect.window, errors) for line in lines]
    spread = np.array(
        [np.sqrt(np.diag(beam_position(line, prospect.uncertain, line.distance.max()))) for line in lines]
    )
    aims = [commanded(line.beam, float(prospect.located.values[3]), planned.spindle) for line in lines]
    return Table.of(
        {
            "line": [line.name for line in lines],
            "points": [len(line.points) for line in lines],
            "near [mm]": [line.distance.min() for line in lines],
            "far [mm]": [line.distance.max() for line in lines],
            **{f"{name} [rad]": [aim[name] for aim in aims] for name in aims[0]},
            "probability": [margin.probability() for margin in margins],
            "probability_at_range": [margin.probability(limit) for margin in margins],
            "safe_distance [mm]": np.minimum([margin.safe_distance(planned.confidence) for margin in margins], limit),
            "probability_aligned": [margin.probability_aligned() for margin in margins],
            "s_beside s_above [mm]": spread,
        }
    )


def _points(lines: Sequence[ReceiverLine]) -> Table:
    """Return /points: every receiver position, in the order of the programs and the columns of calibrate-machine."""
    parts = []
    for line in lines:
        name = np.repeat(line.name, len(line.points))
        at = {"position [mm]": line.position, "x y z [mm]": line.points, "distance [mm]": line.distance}
        parts.append(Table.of({"line": name, "axis": name, **at}))
    return Table.stack(parts)


def _further(prospect: Prospect, reach: Reach) -> list[Further]:
    located, noise = prospect.located, prospect.noise
    places = candidates(located.place, reach)
    if not len(places):
        return []
    distances = bool(located.readings.beams.measured.any())
    gained = information(located.values, places, noise, distances)
    return further(located.covariance, prospect.wanted, noise.encoder, places, gained)


def _further_table(prospect: Prospect, more: Sequence[Further]) -> dict[str, Table]:
    """Return /further_poses, if any, with the probabilities of the least certain line after each."""
    if not more:
        return {}
    wanted, encoder = prospect.wanted, prospect.noise.encoder
    known = [Uncertainty(motion.location, encoder) for motion in more]
    columns = {
        "poses": len(prospect.located.readings.names) + 1 + np.arange(len(more)),
        "x y z [mm]": [motion.receiver for motion in more],
        "probability": [wanted.worst(each) for each in known],
        "probability_aligned": [wanted.worst_aligned(each) for each in known],
    }
    return {"further_poses": Table.of(columns)}


def _programs(prospect: Prospect) -> tuple[dict[str, Table | str], list[str]]:
    """Return the NC programs by file name, and a warning for each line without one."""
    planned, place = prospect.planned, prospect.located.place
    park = farthest_corner(place, planned.axes.box)
    motion = ProgramMotion(planned.feed, planned.dwell, planned.standoff, park, planned.control)
    files: dict[str, Table | str] = {}
    blocked = []
    for line in prospect.lines:
        text = line_program(line, prospect.located.values, planned.spindle, motion)
        if text is None:
            blocked.append(f"line {line.name} has no NC program: no path of single-axis moves keeps clear of the unit")
        else:
            files[f"{line.name}.nc"] = text
    return files, blocked


def _notes(prospect: Prospect, more: Sequence[Further]) -> list[str]:
    """Return notes on the probability along the least certain line, what limits it, and what would improve it."""
    wanted, planned, uncertain = prospect.wanted, prospect.planned, prospect.uncertain
    now, limit = wanted.worst(uncertain), wanted.worst(uncertain.without_location())
    radius, angle = find_unit("um", "length"), find_unit("urad", "angle")
    n = len(prospect.located.readings.names)
    lines = [
        f"range of the receiver: +-{radius.outside(planned.range.straightness):g} um, "
        f"+-{angle.outside(planned.range.angle):g} urad, to {planned.range.distance:g} mm",
        f"aimed by the encoders, the beam stays in range along the least certain line with {percent(now)} probability",
    ]
    if now >= planned.confidence:
        return lines
    lines.append(f"with a unit whose place is known exactly it would be {percent(limit)}; the encoders cause the rest")
    if more:
        best = wanted.worst(Uncertainty(more[-1].location, prospect.noise.encoder))
        at = ", ".join(f"{axis} = {value:.0f}" for axis, value in zip(AXES, more[0].receiver, strict=True))
        lines.append(f"the pose to add first is the receiver at {at} mm")
        lines.append(
            f"{n + len(more)} poses make it safe ({percent(best)})"
            if best >= planned.confidence
            else f"{n + len(more)} poses would give {percent(best)}; "
            f"no number of poses gives more than {percent(limit)}"
        )
    return lines


def _notes_on_alignment(prospect: Prospect, more: Sequence[Further]) -> list[str]:
    """Return notes on the probability after the units are aligned at the far end of each line."""
    aligned = prospect.wanted.worst_aligned(prospect.uncertain)
    lines = [
        f"aligned at the far end by the receiver's own readings, it stays in range with {percent(aligned)} probability"
    ]
    if aligned < prospect.planned.confidence and more:
        known = [Uncertainty(motion.location, prospect.noise.encoder) for motion in more]
        enough = [
            i for i, each in enumerate(known) if prospect.wanted.worst_aligned(each) >= prospect.planned.confidence
        ]
        if enough:
            lines.append(f"{len(prospect.located.readings.names) + enough[0] + 1} poses make that safe")
    return lines


def percent(probability: float) -> str:
    """Return a probability as text; its own uncertainty is about 0.3 %."""
    return "more than 99.9 %" if probability > 0.999 else f"{100 * probability:.1f} %"
