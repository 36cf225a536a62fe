"""What adjusts a job for its diagnosis: with all readings, without outliers, or with other settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from metrocli import tasks
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.job_entries import REMOVE, declared_noise, key_of_model, model_of
from metrocli.diagnosis.trials import Others
from metrocli.effects.acting import Variable
from metrocli.effects.own import columns
from metrocli.errors import UsageError
from metrocli.project.job import JobFile

Adjuster = Callable[..., AdjustedJob]


def adjuster(job: JobFile, more: Sequence[Variable] = (), adjusted: Adjuster | None = None) -> Adjuster:
    """Return what adjusts a job, by default with all readings; raise UsageError if its kind has no diagnosis.

    `more` are variables of laws beside those that its kind has everywhere.
    """
    task = tasks.KINDS[job.kind].task()
    adjusts = adjusted or task.diagnosed
    if adjusts is None:
        raise UsageError(f"{job.kind} jobs cannot be diagnosed")
    noise = job.root.get("noise")
    declared, model, key = declared_noise(noise), model_of(noise), key_of_model(noise)
    places = columns.with_variables(task.places, more)

    def adjust(inputs: Mapping[str, object], settings: object = job.settings) -> AdjustedJob:
        other = adjusts(task.job(settings, effects=job.effects, **inputs))
        every = (*other.effects, *job.own.effects)
        stated = task.covariates is not None
        other = replace(other, declared=declared, noise_model=model, model_key=key, states_correlated=stated)
        return replace(other, effects=every, places=places, outliers=_outliers(job))

    return adjust


def cleared(job: JobFile, more: Sequence[Variable] = ()) -> Adjuster | None:
    """Return what adjusts a job without its outliers, if it removes them and its kind can do so for a diagnosis."""
    clears = tasks.KINDS[job.kind].task().cleared
    return adjuster(job, more, clears) if _outliers(job) == REMOVE and clears is not None else None


def _outliers(job: JobFile) -> str:
    """Return whether a job reports or removes outliers; "" where it cannot leave any out."""
    settings: Any = job.settings
    if not hasattr(settings, "outliers"):
        return ""
    faults = getattr(replace(settings, outliers=REMOVE), "faults", tuple)
    return "" if any(key == "outliers" for key, _ in faults()) else str(settings.outliers)


def others_of(job: JobFile, inputs: Mapping[str, object], adjust: Adjuster) -> Others:
    """Return the other settings of a job, each with what adjusts it."""
    task = tasks.KINDS[job.kind].task()
    trials = partial(task.jobs_with_others, task.job(job.settings, effects=job.effects, **inputs))
    return lambda *how: [(wrong, partial(adjust, vars(trial.files), trial.settings)) for wrong, trial in trials(*how)]
