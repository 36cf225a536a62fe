"""The laws of a diagnosis as lines of its report."""

from __future__ import annotations

from collections.abc import Iterator

from metrocli import units
from metrocli.cli.columns import text_table
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.laws.definition import written
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.laws.library import Term
from metrocli.diagnosis.laws.terms import goes_round

_LISTED = 4
"""Terms that are as likely as a law, of which so many are listed"""
_HEAD = ("", "law", "acts on", "explains", "chance", "held-out error", "log score (± std)")


def law_lines(diagnosis: Diagnosis, extended: Law | None) -> Iterator[str]:
    """Yield the table of laws, the simplest first, and the sizes of the chosen one.

    `extended` is the law in the extended job.
    """
    yield from text_table(_HEAD, [_row(law) for law in diagnosis.laws])
    law = diagnosis.law
    if law is None:
        yield "No law predicts held-out readings better than none."
        return
    texts = written(law)
    sizes = [f"{name} = {units.with_std(value, std)} {unit}" for name, (value, std, unit) in texts.parameters.items()]
    sizes += [f"{name} = {value:.4g} {unit}" for name, (value, unit) in texts.scan.items()]
    yield f"  sizes {units.SPREAD}: {', '.join(sizes)}".replace(" 1,", ",").removesuffix(" 1")
    angles = sorted({name for term in law.terms for name in term.form.powers_of() if goes_round(name)})
    if angles:
        yield f"It jumps where the {' or the '.join(angles)} begins again after a full turn."
    near = [f"{candidate} (correlation {cosine:.2f})" for candidate, cosine in law.near]
    if near:
        yield f"It is nearly {' or '.join(near)}: perhaps that cause with another variable or at another place."
    if law.as_likely:
        others = [f"{term.form.text} ({_place(term)} {term.spot.component}".rstrip() + ")" for term in law.as_likely]
        more = f" or {len(others) - _LISTED} others" if len(others) > _LISTED else ""
        yield f"These readings hardly distinguish it from {'; '.join(others[:_LISTED])}{more}."
    yield f"A law is not a cause: find what acts like this at this place.{_where(law, extended)}"


def _where(law: Law, extended: Law | None) -> str:
    """Return whether the extended job contains the chosen law, in words."""
    if extended is law:
        return " The extended job contains it."
    if extended is None:
        return " No extended job contains it."
    number = len(extended.terms)
    simpler = f"law of {number} term{'s' if number > 1 else ''}"
    return f" The job cannot be adjusted with it: the extended job contains the {simpler}."


def _row(law: Law) -> tuple[str, ...]:
    texts, place = written(law), _place(law.terms[0])
    adds = "; ".join(f"{name}: {text}" if name else text for name, text in texts.adds.items())
    score = f"{law.gain.log_score:+.1f} ± {law.gain.log_score_std:.1f}"
    share, held_out = f"{100 * law.part_of_structure:.0f} %", f"{-100 * law.gain.reduction:+.0f} %"
    return "*" if law.chosen else "", adds, place, share, units.chance(law.p_value), held_out, score


def _place(term: Term) -> str:
    return " ".join([term.spot.acting.name, *(name for _, name in term.spot.where)])
