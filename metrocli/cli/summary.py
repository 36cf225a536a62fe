"""The summary of a result or plan as JSON, the same for every command with --json."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from metrocli.plan import Plan
from metrocli.project.planned import SUMMARY, files_of
from metrocli.record import Record
from metrocli.result import Estimate, Result
from metrocli.table import Table


def summary(result: Result, record: Record, path: Path) -> dict[str, Any]:
    """Return the summary of a result under the keys that --json promises."""
    return {
        "kind": result.kind,
        "title": result.title,
        "status": record.status,
        **({"conformity": record.conformity} if record.conformity else {}),
        "result": str(path),
        "estimates": {e.name: of_estimate(e) | dict(result.details.get(e.name, {})) for e in result.estimates},
        "statistics": dict(result.statistics),
        "warnings": list(result.warnings),
        "doubts": list(record.doubts),
        "notes": list(result.notes),
        "requirements": [asdict(verdict) for verdict in record.verdicts],
    }


def of_estimate(estimate: Estimate) -> dict[str, Any]:
    """Return value, standard uncertainty and unit of an estimate, in its internal unit."""
    return {"value": estimate.value, "std": estimate.std, "unit": estimate.unit}


def json_of(result: Result, record: Record, path: Path) -> str:
    """Return the summary as JSON text."""
    return as_json(summary(result, record, path))


def json_of_plan(plan: Plan, folder: Path, more: Mapping[str, Any]) -> str:
    """Return the summary of a plan as JSON text, with the paths of its files, and more keys."""
    return as_json(
        {
            "kind": plan.kind,
            "status": "planned",
            "figures": {e.name: of_estimate(e) for e in plan.figures},
            "notes": list(plan.notes),
            "tables": {name: _listed(table) for name, table in plan.tables.items()},
            "warnings": list(plan.warnings),
            "files": [str(folder / name) for name in (*files_of(plan), SUMMARY)],
            **more,
        }
    )


def json_of_table(table: Table) -> str:
    """Return a table as JSON text: `units` by column, and `rows` with one object for each row."""
    return as_json(_listed(table))


def _listed(table: Table) -> dict[str, Any]:
    columns = [values.tolist() for values in table.columns.values()]
    rows = [dict(zip(table, row, strict=True)) for row in zip(*columns, strict=True)]
    return {"units": dict(table.units), "rows": rows}


def as_json(value: Any) -> str:
    """Return JSON text; NaN and infinities are null."""
    return json.dumps(_finite(value), indent=2, ensure_ascii=False)


def _finite(value: Any) -> Any:
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value
