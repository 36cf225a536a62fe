"""Measurements with an effect of no catalogue, simulated elsewhere: does a law explain it, with the right variables?

python -m benchmarks laws [NUMBER ...]. The cases are not part of the project; where ../shared/cases is absent the
benchmark reports it and ends.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.laws.definition import written
from metrocli.project.diagnosed import carry_out
from metrocli.project.job import load

CASES = Path(__file__).parents[2] / "shared" / "cases" / "laws"


KNOWN = {"direction": "straightness-reversal"}
"""Forms of the cases that the catalogue has"""


def folders() -> list[Path]:
    """Return the cases in the order of their numbers; none where they are absent."""
    return [folder for folder in sorted(CASES.glob("*")) if (folder / "truth.json").is_file()]


def faults(diagnosis: Diagnosis, truth: dict[str, Any]) -> list[str]:
    """Return in words what is wrong with a diagnosis: its verdict, its law, the variables or the place of the law."""
    law = diagnosis.law
    if not truth["effects"]:
        return [] if diagnosis.verdict is Verdict.CLEAN and law is None else [f"verdict {diagnosis.verdict}, not clean"]
    (planted,) = truth["effects"]
    if {finding.effect.alternative.effect.name for finding in diagnosis.findings} == {KNOWN.get(truth["form"])}:
        return [] if diagnosis.verdict is Verdict.EXPLAINED else [f"verdict {diagnosis.verdict}, not explained"]
    found = [] if diagnosis.verdict is Verdict.UNEXPLAINED else [f"verdict {diagnosis.verdict}, not unexplained"]
    if law is None:
        return [*found, "no law"]
    used = {name for term in law.terms for name in term.form.variables}
    if used != set(planted["variables"]):
        found.append(f"varies with {sorted(used)}, not with {planted['variables']}")
    if dict(law.terms[0].spot.where) != planted["where"]:
        found.append(f"at {law.terms[0].spot.where}, not at {planted['where']}")
    if law.part_of_structure < 0.9:
        found.append(f"explains {law.part_of_structure:.0%} of the structure")
    return found


def main(wanted: list[str]) -> int:
    """Print a line for each case and the number of right ones; return 1 if the cases are absent."""
    cases = [folder for folder in folders() if not wanted or folder.name[:3] in [one.zfill(3) for one in wanted]]
    if not cases:
        print(f"no cases at {CASES}")
        return 1
    right = 0
    for folder in cases:
        start = time.process_time()
        diagnosis = carry_out(load(folder / "job.yaml"))
        wrong = faults(diagnosis, json.loads((folder / "truth.json").read_text()))
        right += not wrong
        law = "-" if diagnosis.law is None else "; ".join(written(diagnosis.law).adds.values())
        print(
            f"{folder.name:24} {time.process_time() - start:5.1f} s  {law:60} {'; '.join(wrong) or 'right'}", flush=True
        )
    print(f"{right} of {len(cases)} right")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
