"""The settings of a report-uncertainty job: its keys and the checks of their combination."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import ClassVar

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.tasks.report_uncertainty.entries import Entries
from metrocli.tasks.shared.figures import with_std


@dataclass(frozen=True)
class Settings(Entries):
    """Propagate uncertainties of inputs and of other jobs' results to measurands or a volume, and to a decision."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "the growth of a part belongs to the job that measures it; here it is an entry with `expansion`"
    }

    def faults(self) -> Iterable[tuple[str, ...] | Fault]:
        """Yield the faults that show without the files of the job."""
        from metrocli.tasks.report_uncertainty import problem, volume_problem

        if self.volume is not None or self.contributors:
            yield from volume_problem.faults(self)
        else:
            yield from problem.faults(self)


_OF_EACH = ("U", "second_order.value", "second_order.std")
_TRIALS = ("mc.mean", "mc.std", "mc.resolution")
_PLAIN = ("k", "dof", "probability", "gum_valid", "mc.trials", "mc.covered")
_DECIDED = ("T", "guard_band")
_DECIDED_PLAIN = (
    "U_over_T", "capable", "conformance", "conformance_mc", "consumer", "consumer_of_accepted", "producer",
    "wanted_risk",
)  # fmt: skip
_VOLUME = ("U_pointwise", "std_pointwise", "tolerance.T", "tolerance.acceptance", "tolerance.acceptance_2017")
_VOLUME_PLAIN = ("mc.k_trials", "tolerance.U_over_T", "tolerance.U_over_T_pointwise", "tolerance.capable")


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: of each measurand, or of the axes of a volume."""
    if settings.volume is not None:
        axes = dict.fromkeys("xyz", "mm")
        details = _below(axes, (*_OF_EACH, *_TRIALS, *_VOLUME), (*_PLAIN, *_VOLUME_PLAIN))
        return with_std(axes) | details | dict.fromkeys(("points", "contributors", "trials", "seed"), "")
    measurands = {name: measurand.value.unit for name, measurand in settings.measurands.items()}
    limits = settings.tolerance if isinstance(settings.tolerance, Mapping) else {}
    decided = {f"{name}.tolerance": unit for name, unit in measurands.items() if name in limits}
    aimed = {f"{name}.target": unit for name, unit in measurands.items() if name in settings.target}
    details = _below(measurands, (*_OF_EACH, *_TRIALS), _PLAIN) | _below(decided, _DECIDED, _DECIDED_PLAIN)
    details |= _below(aimed, ("U",), ("reached", "factor"))
    statistics = ("measurands", "quantities", "joint_factor", "trials", "seed")
    return with_std(measurands) | details | dict.fromkeys(statistics, "")


def _below(names: dict[str, str], sized: tuple[str, ...], plain: tuple[str, ...]) -> dict[str, str]:
    """Return details of estimates: those in the unit of the estimate, and plain numbers."""
    units = {f"{name}.{detail}": unit for name, unit in names.items() for detail in sized}
    return units | {f"{name}.{detail}": "" for name in names for detail in plain}
