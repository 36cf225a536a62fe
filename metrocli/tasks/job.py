"""A job and the functions of its kind, with what they take and return (`Task`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from metrocli.doubt import MANY_LEFT_OUT
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.diagnosis.adjusted_job import AdjustedJob
    from metrocli.diagnosis.corrections import Mistake
    from metrocli.effects.acting import Acting
    from metrocli.effects.covariates import Covariates
    from metrocli.effects.effect import Effect
    from metrocli.effects.model import Model
    from metrocli.effects.requested import RequestedEffect
    from metrocli.plan import Plan
    from metrocli.result import Estimate, Result
    from metrocli.simulation import Simulation, SimulationOptions
    from metrocli.table import Table
    from metrocli.uncertainty.workers import Workers

    Adjustment = Callable[[], AdjustedJob]
    """Returns an adjusted job in the form that diagnosis works on"""
    Hopeless = Callable[[Callable[[], Model]], bool]
    """Whether no adjustment of a model that a function returns can fit well enough"""

S = TypeVar("S")
F = TypeVar("F")


def never(begun: Callable[[], Model]) -> bool:
    """Return that nothing is hopeless."""
    return False


@dataclass(frozen=True)
class Job(Generic[S, F]):
    """One job: its settings, the contents of its files, and the effects that extend its model."""

    settings: S
    files: F
    effects: Sequence[RequestedEffect] = ()
    workers: Workers | None = None
    """Workers that compute the chunks of a chunked kind; the threads of this process unless given"""

    def with_files(self, **contents: Any) -> Job[S, F]:
        """Return the job with other contents of some of its files, named as in `files`."""
        files: Any = self.files
        return replace(self, files=replace(files, **contents))


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
    places: tuple[Acting, ...] = ()
    """Quantities on which user-defined effects can act"""
    covariates: Covariates | None = None
    """Quantities with which the errors of its readings could vary"""
    answers: Mapping[str, Callable[[Job[S, F]], Table]] = field(default_factory=dict)
    """Function for each question of the job, by name"""
    result_answers: Mapping[str, Callable[[Result, Sequence[str]], tuple[Estimate, ...]]] = field(default_factory=dict)
    """Function for each question of a result, by name; it receives the values as typed on the command line"""

    with_adjustment: Callable[[Job[S, F]], tuple[Result, Adjustment | None]] | None = None
    """As `run`, with what gives the adjustment behind the result; for kinds with other settings"""
    begun: Callable[[Job[S, F]], Model] | None = None
    """Returns the model of a job at its starting values; for kinds with other settings"""
    other_settings: Callable[[Job[S, F], bool], Iterable[tuple[Mistake, Job[S, F]]]] | None = None
    """What may be wrong in the settings, each with the job that is right then; takes whether the readings fit"""
    cleared: Callable[[Job[S, F]], AdjustedJob] | None = None
    """As `diagnosed`, but without outliers; for kinds whose adjustment to all readings a wrong one can spoil"""
    fits_up_to: float = 2.0
    """Largest sigma0 of readings that fit: where each trial of a setting is short, the least that another can halve"""
    unplaced: tuple[str, ...] = ()
    """Inputs whose list has a frame of its own: turned as a whole, it fits the readings as before"""

    def job(self, settings: S, *contents: Any, effects: Sequence[RequestedEffect] = (), **named: Any) -> Job[S, F]:
        """Return a job from settings and the contents of its files, given in the order of `files` or by name."""
        return Job(settings, self.files(*contents, **named), effects)

    def carried_out(self, job: Job[S, F]) -> tuple[Result, Adjustment | None]:
        """Return the result of a job, and what gives the adjustment behind it; None where nothing asks for it."""
        return (self.run(job), None) if self.with_adjustment is None else self.with_adjustment(job)

    def others(
        self, job: Job[S, F], sigma0: float, left_out: int = 0, hopeless: Hopeless = never
    ) -> list[tuple[Mistake, Callable[[], AdjustedJob]]]:
        """Return what may be wrong in the settings of a job, each with what adjusts the job without it."""
        adjusted = self.diagnosed
        if adjusted is None:
            return []
        jobs = self.jobs_with_others(job, sigma0, left_out, hopeless)
        return [(mistake, partial(adjusted, other)) for mistake, other in jobs]

    def jobs_with_others(
        self, job: Job[S, F], sigma0: float, left_out: int = 0, hopeless: Hopeless = never
    ) -> Iterator[tuple[Mistake, Job[S, F]]]:
        """Yield what may be wrong in the settings of a job, each with the right job, but those that are hopeless.

        `sigma0` is that of the job, which leaves out some readings as outliers. `hopeless` takes a function that
        returns the model of a job at its start.
        """
        if self.other_settings is not None:
            fits = sigma0 <= self.fits_up_to and left_out < MANY_LEFT_OUT
            for mistake, other in self.other_settings(job, fits):
                if self.begun is None or not hopeless(partial(self.begun, other)):
                    yield mistake, other
