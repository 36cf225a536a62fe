"""The contract of a kind of job: what is known of it at once (`Kind`), and what it can do (`Task`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from metrocli.table import Table

if TYPE_CHECKING:
    from metrocli.diagnosis.adjusted_job import AdjustedJob
    from metrocli.effects.effect import Effect
    from metrocli.effects.wanted import Wanted
    from metrocli.plan import Plan
    from metrocli.result import Estimate, Result
    from metrocli.simulation import Simulation, SimulationOptions
    from metrocli.uncertainty.workers import Workers

S = TypeVar("S")
F = TypeVar("F")
ABSENT = Table({})
"""A table that is not there yet: readings of a measurement that is planned or simulated"""


@dataclass(frozen=True)
class Question:
    """An option that prints an answer instead of the usual summary: `--compare`, `--distance A B`."""

    name: str
    help: str
    arguments: tuple[str, ...] = ()
    """Names of its values, as the help shows them; none for a flag"""


@dataclass(frozen=True)
class Kind:
    """What is known of a kind of job without loading its mathematics."""

    name: str
    """As job files and the command line have it: `align-part`"""
    summary: str
    measured: tuple[str, ...] = ()
    """Inputs that the measurement makes: `simulate` writes them, and they need not exist before"""
    planned: tuple[str, ...] = ()
    """Inputs that `plan` does without"""
    questions: tuple[Question, ...] = ()
    """Options of the kind's own command; the task's `answers` have the functions"""
    result_questions: tuple[Question, ...] = ()
    """Options of `metrocli show`; the task's `result_answers` have the functions"""
    chunked: bool = False
    """A long computation in independent chunks: the command has --workers and --scheduler"""
    package: str = ""
    """Where its modules are, unless that is the package of its name in `metrocli.tasks`"""

    def settings(self) -> type:
        """Import and return the dataclass of what a job file may say."""
        found: type = self._module("settings").Settings
        return found

    def task(self) -> Task[Any, Any]:
        """Import and return what the kind can do."""
        found: Task[Any, Any] = self._module("task").TASK
        return found

    def _module(self, name: str) -> Any:
        package = self.package or f"metrocli.tasks.{self.name.replace('-', '_')}"
        return import_module(f"{package}.{name}")


@dataclass(frozen=True)
class Job(Generic[S, F]):
    """One job: settings, the content of its files, and the effects that extend its model."""

    settings: S
    files: F
    effects: Sequence[Wanted] = ()
    workers: Workers | None = None
    """Who carries out the chunks, for a kind that has them; the threads of this process unless given"""


@dataclass(frozen=True)
class Task(Generic[S, F]):
    """What a kind can do with a job; what it cannot do is None.

    The functions are pure: values in, values out. They raise InputError, UndeterminedError or NotConvergedError.
    """

    files: type[F]
    """The dataclass of what the inputs hold; its fields have the names of the keys under `inputs:`"""
    run: Callable[[Job[S, F]], Result]
    check: Callable[[Job[S, F]], None] | None = None
    """Raises InputError with all that is wrong with settings and files together, without computing"""
    plan: Callable[[Job[S, F]], Plan] | None = None
    simulate: Callable[[Job[S, F], SimulationOptions], Simulation] | None = None
    diagnosed: Callable[[Job[S, F]], AdjustedJob] | None = None
    """Adjusts the job and returns it as diagnosis sees it"""
    effects: tuple[Effect, ...] = ()
    """What its model can leave out"""
    answers: Mapping[str, Callable[[Job[S, F]], Table]] = field(default_factory=dict)
    """By the name of a question of the job"""
    result_answers: Mapping[str, Callable[[Result, Sequence[str]], tuple[Estimate, ...]]] = field(default_factory=dict)
    """By the name of a question of a result, which is given its values as they were typed"""

    def job(self, settings: S, *contents: Any, effects: Sequence[Wanted] = (), **named: Any) -> Job[S, F]:
        """Return a job; the contents of its files in the order of `files`, or by their names."""
        return Job(settings, self.files(*contents, **named), effects)
