"""Measurements with a hidden effect that were simulated elsewhere: verdict, names, wrong readings and noise.

python -m benchmarks cases [KIND] [NUMBER ...]. The cases are not part of the project; where ../shared/cases is absent
the benchmark reports it and ends.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.errors import UndeterminedError
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

CASES = Path(__file__).parents[2] / "shared" / "cases"
KEYS = {
    "multilaterate": ("point", "tracer"),
    "calibrate-machine": ("point",),
    "selfcal-grid": ("view", "i", "j", "k", "component"),
}
"""Keys that name a wrong reading, where all of them must be found; among few poses the campaign alone judges"""
KINDS = (
    "multilaterate", "locate-launch-unit", "align-part", "calibrate-camera", "calibrate-machine", "selfcal-grid",
    "rotary",
)  # fmt: skip


def folders(kind: str) -> list[Path]:
    """Return the cases of a kind in the order of their numbers; none where they are absent."""
    return [folder for folder in sorted((CASES / kind).glob("*")) if (folder / "truth.json").is_file()]


def diagnosed(folder: Path) -> tuple[Diagnosis, dict[str, Any]]:
    """Return the diagnosis of a case and its truth."""
    return diagnose(adjusted_job_of(load(folder / "job.yaml"))), json.loads((folder / "truth.json").read_text())


def judged(folder: Path, truth: dict[str, Any]) -> tuple[str, list[str]]:
    """Return the verdict on a case, and what is wrong with it.

    Where readings leave combinations open that move the tool, the right answer is a refusal.
    """
    harmful = truth.get("undetermined", {}).get("harmful", 0)
    try:
        diagnosis = diagnosed(folder)[0]
    except UndeterminedError as error:
        return "refused", [] if harmful else [f"refused: {str(error).splitlines()[0]}"]
    return diagnosis.verdict, [f"{harmful} open directions are not refused"] if harmful else faults(diagnosis, truth)


def faults(diagnosis: Diagnosis, truth: dict[str, Any]) -> list[str]:
    """Return what the diagnosis has wrong; an empty list where it is right."""
    planted = [effect for effect in truth["effects"] if _can_be_seen(effect, truth)]
    known = [effect for effect in planted if not effect["name"].startswith("_")]
    names = {_spot(finding.effect.alternative) for finding in diagnosis.findings}
    sets = names | {_spot(rival.alternative) for finding in diagnosis.findings for rival in finding.effect.rivals}
    found = [f"{effect['name']} is not named" for effect in known if not _named(effect, names, sets)]
    if len(planted) > len(known) and diagnosis.verdict != "unexplained":
        found.append(f"an effect outside the catalogue is {diagnosis.verdict}")
    if not planted and diagnosis.verdict != "clean":
        found.append(f"nothing is hidden, and the verdict is {diagnosis.verdict}")
    if truth["kind"] == "selfcal-grid" and truth["expected_verdict"] != diagnosis.verdict:
        found.append(f"verdict {diagnosis.verdict}")
    if len(diagnosis.findings) > len(planted):
        found.append(f"more names than effects: {sorted(name for name, _ in names)}")
    keys = KEYS.get(truth["kind"])
    if keys and {tuple(one.keys.get(key, "") for key in keys) for one in diagnosis.outliers} != _wrong(truth):
        found.append(f"wrong readings: {[str(one) for one in diagnosis.outliers]}")
    of_few = truth["kind"] in ("align-part", "calibrate-camera")
    outside = truth["kind"] == "calibrate-machine" and diagnosis.verdict == "unexplained"
    low, high = diagnosis.noise.low * 0.97, diagnosis.noise.high * 1.03
    if not (of_few or outside or low <= truth["noise_ratio"] <= high):
        found.append(f"noise {truth['noise_ratio']:.3g} is not in {low:.3g} ... {high:.3g}")
    return found


def _can_be_seen(effect: dict[str, Any], truth: dict[str, Any]) -> bool:
    """With exact tool vectors tracker-scale is seen, though the truth of the cases has it as not identifiable."""
    return bool(effect.get("identifiable", True) or (truth.get("strength") or 0) > 3)


def _named(effect: dict[str, Any], names: set[Any], sets: set[Any]) -> bool:
    spots = {(one["name"], _place(one["name"], one.get("where", {}))) for one in _as_good(effect)}
    return (effect["name"], _place(effect["name"], effect.get("where", {}))) in sets or bool(spots & names)


def _as_good(effect: dict[str, Any]) -> list[dict[str, Any]]:
    return [effect, *effect.get("alternatives", []), *effect.get("rivals", [])]


def _place(name: str, where: dict[str, Any]) -> frozenset[tuple[str, str]]:
    """The place as the contract has it: a beam's offset cannot be separated into launch unit and receiver."""
    if name == "beam-offset":
        return frozenset()
    named = {key: " ".join(map(str, one)) if isinstance(one, list) else str(one) for key, one in where.items()}
    return frozenset((key, one) for key, one in named.items() if key != "by")


def _spot(alternative: Candidate) -> tuple[str, frozenset[tuple[str, str]]]:
    """Cause and place, with the view from which a ball moved; time or temperature is not a place."""
    where = (
        alternative.where | dict(alternative.named) if alternative.effect.name == "moved-ball" else alternative.where
    )
    return alternative.effect.name, _place(alternative.effect.name, where)


def _wrong(truth: dict[str, Any]) -> set[tuple[str, ...]]:
    if truth["kind"] == "selfcal-grid":
        return {(one["view"], *map(str, one["ball"]), one["axis"]) for one in truth["outliers"]}
    return {tuple(str(one[key]) for key in KEYS[truth["kind"]]) for one in truth["outliers"]}


def main(arguments: list[str]) -> int:
    """Print each case with its CPU time and what is wrong; the exit code is 0 whatever they are."""
    if not CASES.is_dir():
        print(f"no cases at {CASES}")
        return 0
    kinds = [word for word in arguments if word in KINDS] or list(KINDS)
    numbers = {word for word in arguments if word not in KINDS}
    for kind in kinds:
        right, tried = 0, [folder for folder in folders(kind) if not numbers or folder.name in numbers]
        for folder in tried:
            start = time.process_time()
            truth = json.loads((folder / "truth.json").read_text())
            verdict, wrong = judged(folder, truth)
            right += not wrong
            hidden = " + ".join(effect["name"] for effect in truth["effects"]) or "nothing"
            took = f"{time.process_time() - start:6.1f} s"
            print(f"{kind}/{folder.name} {took} {hidden}: {'; '.join(wrong) or verdict}", flush=True)
        print(f"{kind}: {right} of {len(tried)} right")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
