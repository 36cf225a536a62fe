"""The settings of a report-uncertainty job: its keys and the checks of their combination."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from metrocli.errors import Fault
from metrocli.tasks.report_uncertainty.entries import Entries


@dataclass(frozen=True)
class Settings(Entries):
    """Propagate uncertainties of inputs and of other jobs' results to measurands or a volume, and to a decision."""

    def faults(self) -> Iterable[tuple[str, ...] | Fault]:
        """Yield the faults that show without the files of the job."""
        from metrocli.tasks.report_uncertainty import problem, volume_problem

        if self.volume is not None or self.contributors:
            yield from volume_problem.faults(self)
        else:
            yield from problem.faults(self)
