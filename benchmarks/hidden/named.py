"""Whether a diagnosis names what is hidden, with its place, and the rates over many cases."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping

from benchmarks.bars import Rate
from metrocli.diagnosis.findings import Diagnosis

READING = "reading"
"""The outcome that only readings of the place are called wrong"""


def words(found: Diagnosis, hidden: str, where: Mapping[str, str]) -> tuple[str, str]:
    """Return what was hidden, or "nothing", and whether it is named, an alternative or missed, with the false names.

    `reading`: no effect is named, and every reading that is called wrong is one of the place where it is hidden.
    """
    identified = [one.effect for one in found.findings]
    named = {(one.alternative.effect.name, tuple(one.alternative.where.values())) for one in identified}
    rivals = {
        (r.alternative.effect.name, tuple(r.alternative.where.values())) for one in identified for r in one.rivals
    }
    if not hidden:
        return "nothing", f"false: {sorted(named)}" if named or found.left is not None else "clean"
    right = (hidden, tuple(where.values()))
    false = named - {right}
    outcome = "named" if right in named else "alternative" if right in rivals else "missed"
    if outcome == "missed" and where and found.outliers and not false:
        here = all(where.items() <= dict(outlier.keys).items() for outlier in found.outliers)
        outcome = READING if here else outcome
    if not false:
        return hidden, outcome
    return hidden, f"{outcome} and {sorted(false)}" if right in named else f"{outcome}: {sorted(named)}"


def print_rates(cases: Iterable[tuple[str, tuple[str, str]]], readings: bool = False) -> int:
    """Print the cases that are not plainly right, as they come with their titles, then the rates; 1 for a missed bar.

    Bars: false names at most 5 %; named with its place 95 %, or among the alternatives 98 %. `readings`: wrong readings
    of the place count for both, beside the share without them: the cause is an error of one reading there.
    """
    found: Counter[tuple[bool, str]] = Counter()
    begin = time.process_time()
    for title, (hidden, outcome) in cases:
        if outcome not in ("clean", "named"):
            print(f"case {title}: {hidden}: {outcome}", flush=True)
        found[hidden != "nothing", outcome.split(":")[0].split(" and")[0]] += 1
    nothing = sum(n for (effect, _), n in found.items() if not effect)
    effects = sum(n for (effect, _), n in found.items() if effect)
    false, named, other = found[False, "false"], found[True, "named"], found[True, "alternative"]
    rates = [Rate("nothing hidden: a false name or structure", false, nothing, most=0.05)]
    more = ""
    if readings:
        rates.append(Rate("one effect: named with its place", named, effects))
        named, more = named + found[True, READING], ", or as wrong readings there"
    rates += [
        Rate(f"one effect: named with its place{more}", named, effects, least=0.95),
        Rate("one effect: named, or an alternative", named + other, effects, least=0.98),
    ]
    print("\n".join(str(rate) for rate in rates if rate.of))
    print(f"{(time.process_time() - begin) / max(nothing + effects, 1):.1f} s of CPU a case")
    return int(not all(rate.met for rate in rates if rate.of))
