"""The report of the loop `diagnose --until-clean`: a table of its steps, and why it ended."""

from __future__ import annotations

from typing import Any

from metrocli import units
from metrocli.cli.columns import text_table
from metrocli.cli.diagnosis_report.headline import headline
from metrocli.diagnosis import verdict
from metrocli.diagnosis.findings import Diagnosis
from metrocli.project.until_clean import Extension, Loop

_HEAD = ("step", "added", "chance", "chi2", "dof", "held-out error", "changes result by")


def loop_text(loop: Loop) -> str:
    """Return the last verdict, the table of steps, and the end of the loop in a sentence."""
    rows = [_row(number, extension, loop.first) for number, extension in enumerate(loop.extensions, 1)]
    table = "\n".join(text_table(_HEAD, rows)) if rows else ""
    jobs = "\n".join(f"  {extension.job} -> {extension.done.path}" for extension in loop.extensions)
    pending = f"; found so far, and not added: {', '.join(loop.pending)}" if loop.pending else ""
    return "\n\n".join(filter(None, (f"verdict: {headline(loop.last)}", table, jobs, f"ended: {loop.end}{pending}")))


def _row(number: int, extension: Extension, first: Diagnosis) -> tuple[str, ...]:
    """Return the cells of a step, in the order of `_HEAD`; sizes in the units of the first diagnosis."""
    job, statistics = first.job, extension.done.result.statistics
    held_out = " to ".join(units.sized(size, job.reading[1]) for size in (extension.before, extension.after))
    shift = "" if extension.shift is None else units.changed_by(extension.shift, job.delivered.dimension)
    chi2, dof = (f"{statistics[name]:.4g}" if name in statistics else "" for name in ("chi2", "dof"))
    if statistics.get("noise_estimated") and "noise_factor" not in statistics:
        # with unit weights chi2 is a sum of squares in the unit of the readings: no test compares it
        chi2 = "noise found"
    return str(number), ", ".join(extension.added), units.chance(extension.p_value), chi2, dof, held_out, shift


def loop_data(loop: Loop) -> dict[str, Any]:
    """Return the loop as plain data: verdict, noise and wrong readings at its end, and its steps."""
    unit, job = units.find_unit(*loop.first.job.reading), loop.first.job
    shown = units.find_unit(job.delivered.unit, job.delivered.dimension)
    last = verdict.as_data(loop.last)
    return {
        **{key: last[key] for key in ("verdict", "noise", "outliers")},
        "end": loop.end,
        "steps": [
            {
                "job": str(extension.job),
                "result": str(extension.done.path),
                "added": list(extension.added),
                "p_value": extension.p_value,
                "chi2": extension.done.result.statistics.get("chi2"),
                "dof": extension.done.result.statistics.get("dof"),
                "holdout_before": unit.outside(extension.before),
                "holdout_after": unit.outside(extension.after),
                "unit": unit.symbol,
                "result_shift": None
                if extension.shift is None
                else {"what": job.delivered.what, "value": shown.outside(extension.shift), "unit": shown.symbol},
            }
            for extension in loop.extensions
        ],
    }
