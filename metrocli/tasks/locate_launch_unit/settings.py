"""Settings of a locate-launch-unit job."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from metrocli.frozen import dataclass
from metrocli.settings import Choice, Flag, ListOf, Quantity, Section, TableFile, setting
from metrocli.table import ABSENT, Table
from metrocli.tasks.locate_launch_unit.plan_settings import Planned
from metrocli.tasks.locate_launch_unit.readings import PLACES, POSES
from metrocli.tasks.shared.environment import Environment
from metrocli.tasks.shared.figures import adjusted
from metrocli.tasks.shared.noise import DECLARED, model_setting

METHODS = ("adjustment", "lines", "closed-loop")


@dataclass(frozen=True)
class Inputs:
    """Aligned poses, and positions to measure at."""

    poses: Path = setting(TableFile(POSES), "receiver positions and encoder angles of aligned poses")
    places: Path | None = setting(
        TableFile(PLACES), "receiver positions to measure at, for simulate and plan", default=None
    )


@dataclass(frozen=True)
class Files:
    """Contents of the inputs; the poses are absent before the measurement."""

    poses: Table = ABSENT
    places: Table | None = None


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the readings."""

    encoder: float = setting(Quantity("angle", positive=True), "standard deviation of each encoder angle")
    distance: float | None = setting(
        Quantity("length", positive=True), "standard deviation of a distance", default=None
    )
    model: str = model_setting()

    def with_noise_times(self, factor: float) -> Noise:
        """Return the noise with both parts times a factor."""
        distance = None if self.distance is None else factor * self.distance
        return replace(self, encoder=factor * self.encoder, distance=distance)


@dataclass(frozen=True)
class Truth:
    """True place of the unit, for `metrocli simulate`."""

    place: tuple[float, ...] = setting(ListOf(Quantity("length"), length=3), "x, y, z of the unit")
    gamma: float = setting(Quantity("angle"), "set-up angle of the unit about z", default=0.0)
    distances: bool = setting(Flag(), "whether distances are read", default=False)


@dataclass(frozen=True)
class Settings:
    """Find the launch unit of an interferometer from aligned poses (Kuprin et al.), and plan its measurements."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "no points of a part are measured here; the machine's growth is the effect machine-scale"
    }

    inputs: Inputs = setting(Section(Inputs), "the files of the job")
    noise: Noise = setting(Section(Noise), "standard deviations of the readings")
    method: str = setting(Choice(*METHODS), "adjustment, or one of the paper's two", default="adjustment")
    environment: Environment | None = setting(
        Section(Environment), "the air, and the one that the interferometer assumes for distances", default=None
    )
    plan: Planned | None = setting(Section(Planned), "the lines to measure from the located unit", default=None)
    outliers: str = setting(
        Choice("report", "remove"), "report outliers only, or also leave them out", default="report"
    )
    simulation: Truth | None = setting(Section(Truth), "the truth for `metrocli simulate`", default=None)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Check that distances have a standard deviation, and that the method can estimate the noise."""
        distances = self.simulation is not None and self.simulation.distances
        if self.noise.distance is None and (distances or self.method == "closed-loop"):
            yield "noise", "distances need their standard deviation: add `distance: 1 um`"
        if self.noise.model != DECLARED and self.method != "adjustment":
            yield (
                "noise.model",
                "only `method: adjustment` has the residuals from which noise is estimated",
            )


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; a method as printed has no sigma0."""
    unit = {"x": "mm", "y": "mm", "z": "mm", "gamma": "rad", "air.scale": "1"}
    return adjusted(unit, ("poses", "critical_w", "rejected", "noise_factor"), ["mm", "rad"])
