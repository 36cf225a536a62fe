"""The contract of a kind of job: its description, which loads fast (`Kind`), and its functions (`Task`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from metrocli.diagnosis.adjusted_job import AdjustedJob
    from metrocli.effects.effect import Effect
    from metrocli.effects.wanted import Wanted
    from metrocli.plan import Plan
    from metrocli.result import Estimate, Result
    from metrocli.simulation import Simulation, SimulationOptions
    from metrocli.table import Table
    from metrocli.uncertainty.workers import Workers

S = TypeVar("S")
F = TypeVar("F")


@dataclass(frozen=True)
class Question:
    """An option that prints an answer instead of the usual summary: `--compare`, `--distance A B`."""

    name: str
    help: str
    arguments: tuple[str, ...] = ()
    """Names of its values, as the help shows them; empty for a flag"""


@dataclass(frozen=True)
class Kind:
    """Description of a kind of job, available without loading its mathematics."""

    name: str
    """Its name in job files and on the command line, such as `align-part`"""
    summary: str
    """One phrase for the help"""
    measured: tuple[str, ...] = ()
    """Inputs that the measurement produces; `simulate` writes them, so they need not exist before"""
    planned: tuple[str, ...] = ()
    """Inputs that `plan` does not need"""
    questions: tuple[Question, ...] = ()
    """Options of the kind's own command; `Task.answers` holds their functions"""
    result_questions: tuple[Question, ...] = ()
    """Options of `metrocli show`; `Task.result_answers` holds their functions"""
    chunked: bool = False
    """Whether it computes in independent chunks; its command then has the options --workers and --scheduler"""
    package: str = ""
    """Package of its modules; if empty, the package of its name in `metrocli.tasks`"""

    def settings(self) -> type:
        """Import and return the dataclass of the settings in a job file."""
        found: type = self._module("settings").Settings
        return found

    def task(self) -> Task[Any, Any]:
        """Import and return its functions."""
        found: Task[Any, Any] = self._module("task").TASK
        return found

    def _module(self, name: str) -> Any:
        package = self.package or f"metrocli.tasks.{self.name.replace('-', '_')}"
        return import_module(f"{package}.{name}")


@dataclass(frozen=True)
class Job(Generic[S, F]):
    """One job: its settings, the contents of its files, and the effects that extend its model."""

    settings: S
    files: F
    effects: Sequence[Wanted] = ()
    workers: Workers | None = None
    """Workers that compute the chunks of a chunked kind; the threads of this process unless given"""


@dataclass(frozen=True)
class Task(Generic[S, F]):
    """The functions of a kind of job; those that the kind lacks are None.

    The functions are pure: values in, values out. They raise InputError, UndeterminedError or NotConvergedError.
    """

    files: type[F]
    """Dataclass of the contents of the inputs; its fields are named as the keys under `inputs:`"""
    run: Callable[[Job[S, F]], Result]
    check: Callable[[Job[S, F]], None] | None = None
    """Raises InputError that lists every fault in the combination of settings and files, without computing"""
    plan: Callable[[Job[S, F]], Plan] | None = None
    simulate: Callable[[Job[S, F], SimulationOptions], Simulation] | None = None
    diagnosed: Callable[[Job[S, F]], AdjustedJob] | None = None
    """Adjusts the job and returns it in the form that diagnosis needs"""
    effects: tuple[Effect, ...] = ()
    """Effects that its model can leave out, and that a job can add"""
    answers: Mapping[str, Callable[[Job[S, F]], Table]] = field(default_factory=dict)
    """Function for each question of the job, by name"""
    result_answers: Mapping[str, Callable[[Result, Sequence[str]], tuple[Estimate, ...]]] = field(default_factory=dict)
    """Function for each question of a result, by name; it receives the values as typed on the command line"""

    def job(self, settings: S, *contents: Any, effects: Sequence[Wanted] = (), **named: Any) -> Job[S, F]:
        """Return a job from settings and the contents of its files, given in the order of `files` or by name."""
        return Job(settings, self.files(*contents, **named), effects)
