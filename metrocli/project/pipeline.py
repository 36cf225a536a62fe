"""A run of a project: each job that is out of date, after the jobs whose results it uses."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from metrocli.errors import InputError, MetrocliError
from metrocli.formats.aside import sweep
from metrocli.formats.seal import Label
from metrocli.project.staleness import State, refuse_lost, state_of, unfit_words
from metrocli.project.steps import Step
from metrocli.record import NOT_MET, Record

if TYPE_CHECKING:
    from metrocli.project.runner import Done, Progress


class Action(StrEnum):
    """What `run` did with a job."""

    UP_TO_DATE = "up to date"
    RAN = "ran"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Report:
    """What `run` did with a step, and why."""

    step: Step
    action: Action
    reason: str
    exit_code: int = 0
    done: Done | None = None
    error: str = ""
    label: Label | None = None
    """Of the result, if it was up to date"""

    @property
    def record(self) -> Record | None:
        """The record of the result, if there is one."""
        if self.done is not None:
            return self.done.record
        return State(self.step, "", self.label).record


def run(
    steps: Sequence[Step],
    force: bool,
    progress: Progress,
    finished: Callable[[Report], Any],
    strict: bool = False,
) -> list[Report]:
    """Bring every result up to date; call `finished` with the report of each job.

    After a failure, or a result that is not fit for use, jobs that need it do not run; all others do.
    """
    if not force:
        refuse_lost(steps)
    for folder in {step.job.output.parent for step in steps}:
        sweep(folder)
    reports: dict[str, Report] = {}
    for step in steps:
        report = _run_step(step, reports, force, progress, strict)
        reports[step.name] = report
        finished(report)
    return list(reports.values())


def _run_step(step: Step, reports: Mapping[str, Report], force: bool, progress: Progress, strict: bool) -> Report:
    broken = next((name for name in step.needs if _stops(reports[name], step)), None)
    if broken is not None:
        return Report(step, Action.NOT_RUN, _why(reports[broken]), reports[broken].exit_code)
    state = state_of(step, {}, force, strict)
    if state.waits:
        return Report(step, Action.FAILED, "", InputError.exit_code, error=state.reason)
    if not state.reason and state.label is not None:
        return Report(step, Action.UP_TO_DATE, "", state.label.exit_code, label=state.label)
    from metrocli.project.runner import carry_out

    try:
        done = carry_out(step.job, force, progress, strict=strict)
    except MetrocliError as error:
        return Report(step, Action.FAILED, state.reason, error.exit_code, error=str(error))
    except Exception:
        return Report(step, Action.FAILED, state.reason, MetrocliError.exit_code, error=_defect())
    return Report(step, Action.RAN, state.reason, done.record.exit_code, done)


def _defect() -> str:
    return f"{traceback.format_exc()}\nthis is a defect of metrocli; please report it with the lines above"


def _stops(needed: Report, step: Step) -> bool:
    """Return whether a step cannot run after what happened to a job that it needs."""
    if needed.action in (Action.FAILED, Action.NOT_RUN):
        return True
    return needed.exit_code != 0 and not step.job.accept_doubtful


def _why(needed: Report) -> str:
    status = needed.done.record.status if needed.done else needed.label.status if needed.label else ""
    if status:
        return f"{needed.step.name}: {unfit_words(status)}"
    return f"{needed.step.name} {'failed' if needed.action is Action.FAILED else 'does not run'}"


_WORST_FIRST = (1, 3, 4, 5, NOT_MET)


def worst(exit_codes: Iterable[int]) -> int:
    """Return the exit code of a project: the worst of its jobs, in the order 1, 3, 4, 5, 6; 0 if all are done."""
    found = set(exit_codes) - {0}
    return min(found, key=_WORST_FIRST.index, default=0)
