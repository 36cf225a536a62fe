"""What a job of report-uncertainty says: its keys, and what is wrong with them together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from metrocli.errors import Fault
from metrocli.tasks.report_uncertainty.entries import Entries


@dataclass(frozen=True)
class Settings(Entries):
    """Carry uncertainties of inputs and of other jobs' results to measurands or to a volume, and to a decision."""

    def faults(self) -> Iterable[tuple[str, ...] | Fault]:
        """Yield what does not fit together, as far as it shows without the files of the job."""
        from metrocli.tasks.report_uncertainty import problem, volume_problem

        if self.volume is not None or self.contributors:
            yield from volume_problem.faults(self)
        else:
            yield from problem.faults(self)
