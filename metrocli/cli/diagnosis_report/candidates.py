"""The table of candidates: what each could hide, and from which size it would have been found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from metrocli import units
from metrocli.cli.columns import text_table
from metrocli.diagnosis import status
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import Detectability, WrongReading
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.hidden_change import UndetectedBias
from metrocli.diagnosis.power.average_power import DetectableCandidate, ScatterCandidate
from metrocli.diagnosis.status import Conclusions
from metrocli.effects.effect import Parameter
from metrocli.words import counted, listed

_SHOWN = 5
_NOT_TESTED = status.Status.NOT_TESTED
_HEAD = ("candidate", "where", "status", "usual sizes", "result off by up to", "remark")
_SEEN = {True: "seen", "part": "seen in part", False: "not seen", None: ""}


def candidate_lines(adjusted: AdjustedJob, design: Detectability, found: Conclusions | None) -> list[str]:
    """Return the table of candidates, with one line for all places of a cause of the same status and usual sizes.

    Where a cause is not tested, these have the same reason, too. With None nothing was looked for yet: what residuals
    would exclude is `detectable`.
    """
    unsearched = found is None
    found = found or status.NOTHING
    rows: dict[tuple[str, str, str, str], list[DetectableCandidate]] = {}
    for candidate in design.candidates:
        word = str(status.status(candidate, found))
        word = "detectable" if unsearched and word == status.Status.EXCLUDED else word
        why = status.reason(candidate, word) if word == status.Status.NOT_DECIDED else ""
        effect = candidate.alternative.effect
        rows.setdefault((effect.form, effect.usual, word, why), []).append(candidate)
    lines = [_line(adjusted, design, name, word, candidates) for (name, _, word, _), candidates in rows.items()]
    for scatter in design.scatters:
        lines.append(_of_scatter(adjusted, scatter, status.status(scatter, found), unsearched))
    lines += [_of_readings(adjusted, reading, unsearched, found.decided) for reading in design.readings]
    alike: dict[tuple[str, str], list[str]] = {}
    for untested in design.not_tested:
        alike.setdefault((untested.effect.form, untested.reason), []).append("/".join(untested.where.values()))
    for (name, reason), places in alike.items():
        lines.append((name, listed([place for place in places if place], _SHOWN), str(_NOT_TESTED), "", "", reason))
    return text_table(_HEAD, lines)


def count_of_candidates(diagnosis: Diagnosis) -> str:
    """Return how many candidates have each status, which the full report lists."""
    design, found = diagnosis.design, diagnosis.conclusions
    words = [status.status(candidate, found) for candidate in design.candidates]
    words += [status.status(scatter, found) for scatter in design.scatters]
    words += [_NOT_TESTED for _ in design.not_tested]
    counts = ", ".join(f"{count} {word}" for word, count in Counter(words).items())
    return f"candidates: {counts}; `--full` lists them with what each could hide" if counts else "no candidates"


def _line(
    adjusted: AdjustedJob, design: Detectability, name: str, word: str, candidates: Sequence[DetectableCandidate]
) -> tuple[str, ...]:
    places = ["/".join(candidate.alternative.instance) for candidate in candidates if candidate.alternative.instance]
    where = listed(places, _SHOWN)
    effect = candidates[0].alternative.effect
    if word == status.Status.NAMED:
        return name, where, word, "", "", ""
    excluded = word == status.Status.EXCLUDED
    sizes = [
        status.excluded_above(candidate) if excluded else candidate.detectable
        for candidate in candidates
        if candidate.testable
    ]
    why = ""
    if word == status.Status.NOT_TESTABLE:
        why = f"absorbed by {candidates[0].absorbers}; {_off(candidates)}"
    elif word == status.Status.CANNOT_SEE and any(candidate.missed for candidate in candidates):
        sizes, why = [], status.reason(next(candidate for candidate in candidates if candidate.missed), word)
    elif word == status.Status.CANNOT_SEE and any(map(status.is_swallowed, candidates)):
        sizes, why = [], status.reason(next(filter(status.is_swallowed, candidates)), word, design.structure)
    elif word == status.Status.CANNOT_SEE:
        why = _off(candidates)
    elif word == status.Status.NOT_DECIDED:
        sizes, why = [], status.reason(candidates[0], word)
    seen = {status.usual_seen(candidate) for candidate in candidates}
    beside = status.usual_beside(effect, min(sizes, default=candidates[0].plausible))
    usual = f"{beside}: {_SEEN[seen.pop() if len(seen) == 1 else 'part']}" if beside else ""
    most = max((candidate.undetected for candidate in candidates), key=lambda hidden: hidden.size)
    return name, where, _status(word, sizes, effect.parameters[0]), usual, _hidden(adjusted, most), why


def _off(candidates: Sequence[DetectableCandidate]) -> str:
    """Return the size of the effect for which its largest change of the result holds."""
    most = max(candidates, key=lambda candidate: candidate.undetected.size)
    return f"off by this if its size is {most.alternative.effect.parameters[0].sized(most.assumed)}"


def _status(word: str, sizes: Sequence[float], parameter: Parameter) -> str:
    """Return the status with the sizes from which effects are detected."""
    if not sizes:
        return word
    between = {str(status.Status.EXCLUDED): "above", str(status.Status.CANNOT_SEE): "below", "detectable": "from"}
    return f"{word} {between[word]} {_span(min(sizes), max(sizes), parameter)}" if word in between else word


def _of_scatter(adjusted: AdjustedJob, scatter: ScatterCandidate, word: str, unsearched: bool) -> tuple[str, ...]:
    if not scatter.testable:
        return scatter.effect.name, "everywhere", str(word), "", "", scatter.reason
    if word == status.Status.NAMED:
        return scatter.effect.name, "everywhere", word, "", "", ""
    message = "detectable" if unsearched and word == status.Status.EXCLUDED else str(word)
    size = scatter.detectable if message == "detectable" else status.excluded_above(scatter)
    message = _status(message, [size], scatter.effect.parameters[0])
    usual, hides = status.usual_beside(scatter.effect, scatter.detectable), _hidden(adjusted, scatter.undetected)
    why = status.reason_of_scatter(scatter, word) if word == status.Status.NOT_DECIDED else ""
    return scatter.effect.name, "everywhere", message, usual, hides, why or "sizes are standard deviations"


def _of_readings(adjusted: AdjustedJob, wrong: WrongReading, unsearched: bool, decided: bool) -> tuple[str, ...]:
    name = wrong.effect.name
    if not wrong.testable:
        return name, "one reading", str(status.Status.NOT_TESTABLE), "", "", status.UNCHECKED
    word = "detectable" if unsearched else str(status.Status.EXCLUDED if decided else status.Status.NOT_DECIDED)
    word = _status(word, wrong.between if decided else (), wrong.effect.parameters[0])
    why = "larger ones are listed as wrong readings" if decided else status.ENDED
    why += f"; {counted(wrong.unchecked, 'reading', 'are')} checked by no other" if wrong.unchecked else ""
    return name, "one reading", word, "", _hidden(adjusted, wrong.undetected), why


def _hidden(adjusted: AdjustedJob, hidden: UndetectedBias) -> str:
    place = f" at {hidden.member}" if hidden.member else ""
    return f"{units.sized(hidden.size, adjusted.delivered.dimension)}{place}"


def _span(least: float, most: float, parameter: Parameter) -> str:
    low, unit = parameter.readable(least)
    both = dict.fromkeys(units.two_digits(size) for size in (low, low * most / least))
    return f"{' to '.join(both)} {unit}".strip()
