"""Settings of a job of the tests' kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from metrocli.imageset import ImageSet
from metrocli.result import Result
from metrocli.settings import (
    Choice,
    Either,
    FileOf,
    Flag,
    ImageFiles,
    ListOf,
    MapOf,
    Number,
    Section,
    TableFile,
    Text,
    Whole,
    WithUnit,
    setting,
)
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.shared.figures import with_std
from straight_line import KIND

READINGS = Columns(columns("point [text]", "x y [length]"), key=("point",), description="readings")


@dataclass(frozen=True)
class Known:
    """A slope known from elsewhere."""

    slope: float = setting(WithUnit("slope"), "known slope")


@dataclass(frozen=True)
class Files:
    """Files of the job; readings are absent before the measurement."""

    readings: Table = content(TableFile(READINGS), default=ABSENT)
    known: Result | Known | None = content(
        FileOf(results=(KIND.name,), section=Known), "slope from elsewhere", needed=False
    )
    images: ImageSet | None = content(ImageFiles(), "pictures", needed=False)


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class Limits:
    """Limits of the fit."""

    range: tuple[float, float] = setting(ListOf(WithUnit("length"), length=2), "range of x")
    robust: bool = setting(Flag(), "reweight", default=False)


@dataclass(frozen=True)
class Settings:
    """A straight line through readings."""

    inputs: Any = setting(Section(Inputs), "files")
    noise: float | str = setting(Either(WithUnit("length", positive=True), Choice("estimated")), "noise of y")
    estimate: tuple[str, ...] = setting(
        ListOf(Choice("slope", "offset"), distinct=True), "what to estimate", default=("slope", "offset")
    )
    limits: Limits | None = setting(Section(Limits), "limits", default=None)
    iterations: int = setting(Whole(minimum=1, maximum=50), "most iterations", default=10)
    weight: float = setting(Number(above=0), "a factor", default=1.0)
    alpha: float = setting(WithUnit("expansion"), "expansion", default=0.0)
    labels: Mapping[str, str] = setting(MapOf(Text()), "labels of points", default={})

    def faults(self) -> Iterable[tuple[str, str]]:
        """Two keys that do not go together."""
        if self.iterations == 1 and self.limits is not None and self.limits.robust:
            yield "limits.robust", "reweighting needs more than one iteration"


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures."""
    statistics = ("observations", "unknowns", "dof", "sigma0", "rms.mm")
    return with_std({"slope": "rad", "offset": "mm"}) | dict.fromkeys(statistics, "")
