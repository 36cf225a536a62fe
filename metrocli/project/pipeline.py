"""A run of a project: each job that is out of date, after the jobs whose results it uses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Any

from metrocli.errors import InputError
from metrocli.formats.file_bytes import refuse_unwritable, sweep
from metrocli.formats.hdf5 import label_of
from metrocli.formats.seal import Label
from metrocli.frozen import dataclass
from metrocli.project.staleness import Staleness, refuse_lost, state_of, unfit_words
from metrocli.project.steps import ProjectStep
from metrocli.record import NOT_MET, USABLE, Record

if TYPE_CHECKING:
    from metrocli.project.runner import Done
    from metrocli.project.running.executor import Executor, JobOutcome


class Action(StrEnum):
    """What `run` did with a job."""

    UP_TO_DATE = "up to date"
    RAN = "ran"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Report:
    """What `run` did with a step, and why."""

    step: ProjectStep
    action: Action
    reason: str
    exit_code: int = 0
    done: Done | None = None
    error: str = ""
    label: Label | None = None
    """Of the result, if it was up to date"""

    @property
    def sealed(self) -> Label | None:
        """The label of the result, if the job was up to date or has run."""
        return self.label if self.done is None else label_of(self.done.result, self.done.record)

    @property
    def record(self) -> Record | None:
        """The record of the result, if there is one."""
        if self.done is not None:
            return self.done.record
        return Staleness(self.step, "", self.label).record


@dataclass(frozen=True)
class Order:
    """How a project is run."""

    force: bool = False
    strict: bool = False


def run(
    steps: Sequence[ProjectStep],
    order: Order,
    executor: Executor,
    finished: Callable[[Report], Any],
    begun: Callable[[ProjectStep], Any] = lambda step: None,
) -> list[Report]:
    """Bring every result up to date; call `finished` with the report of each job as soon as it is known.

    `begun` is called with each job that is computed, before it is.

    After a failure, or a result that is not fit for use, jobs that need it do not run; all others do.
    """
    if not order.force:
        refuse_lost(steps)
    for folder in {step.job.output.parent for step in steps}:
        sweep(folder)
    return _Run(steps, order, executor, (begun, finished)).reports_in_order()


class _Run:
    """One run: jobs wait for those that they need, are judged, and computed where they are out of date."""

    def __init__(
        self,
        steps: Sequence[ProjectStep],
        order: Order,
        executor: Executor,
        heard: tuple[Callable[[ProjectStep], Any], Callable[[Report], Any]],
    ) -> None:
        self.order, self.executor = order, executor
        self.begun, self.finished = heard
        self.steps = {step.name: step for step in steps}
        self.reports: dict[str, Report] = {}
        self.working: dict[str, Staleness] = {}
        self.unmet = {step.name: {name for name in step.needs if name in self.steps} for step in steps}
        self.places = {name: number for number, name in enumerate(self.steps)}
        self.ready = [(self.places[name], name) for name, needs in self.unmet.items() if not needs]
        """Jobs that need nothing more, as a heap: the first of the project comes first"""
        self.users: dict[str, list[str]] = {}
        for name, needs in self.unmet.items():
            for need in needs:
                self.users.setdefault(need, []).append(name)

    def reports_in_order(self) -> list[Report]:
        while self.ready or self.working:
            while self.ready and len(self.working) < self.executor.places:
                self.judge(self.steps[heappop(self.ready)[1]])
            if self.working:
                for name, outcome in self.executor.finished():
                    self.report(_written(self.working.pop(name), outcome))
        return [self.reports[name] for name in self.steps]

    def judge(self, step: ProjectStep) -> None:
        """Report a job that does not run, and begin any other."""
        needed = [self.reports[name] for name in step.needs if name in self.reports]
        broken = next((report for report in needed if _stops(report, step)), None)
        if broken is not None:
            return self.report(Report(step, Action.NOT_RUN, _why(broken), broken.exit_code))
        state = state_of(step, {}, self.order.force, self.order.strict)
        if state.waits:
            return self.report(Report(step, Action.FAILED, "", InputError.exit_code, error=state.reason))
        if not state.reason and state.label is not None:
            return self.report(Report(step, Action.UP_TO_DATE, "", state.label.exit_code, label=state.label))
        try:
            refuse_unwritable(step.job.output)
        except InputError as error:
            return self.report(Report(step, Action.FAILED, state.reason, error.exit_code, error=str(error)))
        self.working[step.name] = state
        self.begun(step)
        self.executor.begin(step.name, step.job, self.order.strict)

    def report(self, report: Report) -> None:
        name = report.step.name
        self.reports[name] = report
        self.finished(report)
        for user in self.users.get(name, ()):
            self.unmet[user].discard(name)
            if not self.unmet[user]:
                heappush(self.ready, (self.places[user], user))


def _written(state: Staleness, outcome: JobOutcome) -> Report:
    """Write the result of a job that was computed, and return the report."""
    from metrocli.project.runner import write

    step = state.step
    if outcome.result is None or outcome.record is None:
        return Report(step, Action.FAILED, state.reason, outcome.exit_code, error=outcome.error)
    try:
        done = write(step.job, outcome.result, outcome.record)
    except InputError as error:
        return Report(step, Action.FAILED, state.reason, error.exit_code, error=str(error))
    return Report(step, Action.RAN, state.reason, done.record.exit_code, done)


def _stops(needed: Report, step: ProjectStep) -> bool:
    """Return whether a step cannot run after what happened to a job that it needs."""
    if needed.action in (Action.FAILED, Action.NOT_RUN):
        return True
    return needed.exit_code != 0 and _status(needed) not in USABLE and not step.job.accept_doubtful


def _status(needed: Report) -> str:
    return needed.done.record.status if needed.done else needed.label.status if needed.label else ""


def _why(needed: Report) -> str:
    if status := _status(needed):
        return f"{needed.step.name}: {unfit_words(status)}"
    return f"{needed.step.name} {'failed' if needed.action is Action.FAILED else 'does not run'}"


_WORST_FIRST = (1, 3, 4, 5, NOT_MET)


def worst(exit_codes: Iterable[int]) -> int:
    """Return the exit code of a project: the worst of its jobs, in the order 1, 3, 4, 5, 6; 0 if all are done."""
    codes = set(exit_codes) - {0}
    return min(codes, key=_WORST_FIRST.index, default=0)
