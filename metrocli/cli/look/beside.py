"""What stands beside a result file, for its figures and its page."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrocli.errors import Fault, InputError
from metrocli.project import DIAGNOSIS
from metrocli.record import DONE

if TYPE_CHECKING:
    from metrocli.plots.beside import Beside, LineageFile
    from metrocli.project.provenance.lineage import Origin
    from metrocli.record import Record
    from metrocli.report.html import PrintedDiagnosis
    from metrocli.result import Result

_DIAGNOSE = "write it by: metrocli diagnose JOB.yaml --json > FILE.json"
_STEP = re.compile(r"(.*)\.step([0-9]+)")


def diagnosis_of(result: Path, given: Path | None, record: Record) -> PrintedDiagnosis | None:
    """Return the diagnosis that is given, else the one beside the result; raise InputError if it cannot be read."""
    path = given or result.with_suffix(DIAGNOSIS)
    if given is None and not path.is_file():
        return None
    # not before: this loads the search for effects
    from metrocli.project.fingerprint import of_diagnosed
    from metrocli.report.html import PrintedDiagnosis

    try:
        data: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError([Fault(f"cannot be read: {error.strerror}", str(path), hint=_DIAGNOSE)]) from error
    except ValueError:
        data = None
    if not isinstance(data, dict) or "verdict" not in data:
        raise InputError([Fault("this is not the output of metrocli diagnose --json", str(path), hint=_DIAGNOSE)])
    return PrintedDiagnosis(data, str(path), data.get("of") == of_diagnosed(record.job_text, record.inputs))


def beside_of(result: Path, diagnosis: PrintedDiagnosis | None, before: Path | None = None) -> Beside:
    """Return what figures show beside a result: the diagnosis if it is of this job, the earlier result, the lineage.

    Without `before` the earlier result is NAME.h5 beside NAME.extended.h5, if it can be read.
    """
    from metrocli.plots.beside import Beside
    from metrocli.project.provenance.lineage import shortened, trace

    data = diagnosis.data if diagnosis is not None and diagnosis.is_current else None
    return Beside(data, _before(result, before), tuple(_nodes(shortened(trace(result)))))


def _before(result: Path, given: Path | None) -> Result | None:
    from metrocli.formats import hdf5

    path = given or _earlier(result)
    if path is None or (given is None and not path.is_file()):
        return None
    try:
        return hdf5.read(path)[0]
    except InputError:
        if given is not None:
            raise
        return None


def _earlier(result: Path) -> Path | None:
    """Return the result that diagnose extended, by the names that it gives."""
    if result.stem.endswith(".extended"):
        return result.with_name(f"{result.stem.removesuffix('.extended')}.h5")
    step = _STEP.fullmatch(result.stem)
    if step is None:
        return None
    number = int(step[2]) - 1
    return result.with_name(f"{step[1]}.step{number}.h5" if number else f"{step[1]}.h5")


def _nodes(origin: Origin) -> list[LineageFile]:
    """Return the files of a lineage, each once, by their paths from the folder above that of the result."""
    from metrocli.plots.beside import LineageFile
    from metrocli.project.provenance.lineage import AS_READ, files_of, name_from

    home = origin.path.parent.parent
    return [
        LineageFile(
            name_from(home, file),
            file.label.kind if file.label else "",
            file.state == AS_READ and (file.label is None or file.label.status == DONE),
            tuple(dict.fromkeys(name_from(home, below) for below in file.origins)),
        )
        for file in files_of(origin)
    ]
