"""The page of one result: first what decides, then the figures, then where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from metrocli.report.findings import diagnosed, next_step, row_of, verdict, worst
from metrocli.report.html import EMPTY, Content, Html, joined, listed, marked, stated, table, tag
from metrocli.report.pdf import page
from metrocli.report.pictures import shown
from metrocli.result import Estimate, Result
from metrocli.words import listed as listed_words

_FIRST = 12
"""Rows of a table that are seen at once; all others follow when they are asked for"""
_STATISTICS = ("observations", "unknowns", "dof", "sigma0", "chi2", "p_value", "rms", "noise", "rejected")


def result_page(content: Content) -> str:
    """Return the page of a result as HTML."""
    result = content.result
    title = result.title or result.kind
    figures, turns = shown(result, content.path, content.context)
    parts = [
        tag("p", f"metrocli {result.kind}", class_="muted"),
        tag("h1", title),
        tag("p", " · ".join(_measured(content)), class_="muted"),
        _verdict(content),
        tag("div", tag("section", _estimates(content)), tag("section", _facts(content)), class_="first"),
        _warnings(content),
        tag("h2", "Figures", id="figures") if figures else EMPTY,
        figures,
        _details(content),
        _provenance(content),
    ]
    return page(f"{title} ({content.record.status})", *parts, turns=turns)


def _measured(content: Content) -> Iterator[str]:
    """Yield what was measured, by how many readings, the file of the result and its day."""
    item = (content.record.certificate or {}).get("item", {})
    yield from (str(item[key]) for key in ("name", "serial") if item.get(key))
    statistics = content.result.statistics
    if "observations" in statistics and "unknowns" in statistics:
        yield f"{statistics['observations']} observations, {statistics['unknowns']} unknowns"
    yield content.path
    yield content.record.created.partition("T")[0]


def _verdict(content: Content) -> Html:
    level, words = verdict(content)
    lines = [tag("p", tag("strong", words)), *(tag("p", marked(doubt)) for doubt in content.record.doubts)]
    lines.append(tag("p", tag("b", "Next: "), marked(next_step(content))))
    return tag("div", *lines, class_=f"verdict {level}")


def _estimates(content: Content) -> Html:
    result = content.stated or content.result
    if not result.estimates:
        return EMPTY
    estimates = sorted(result.estimates, key=lambda estimate: not _of_effect(result, estimate))
    factors = [f"{result.expanded(estimate)[1]:.3g}" for estimate in estimates]
    text = stated(result, content.record)
    head: tuple[str, ...] = ("estimate", "value", f"U (k = {factors[0]})", "unit")
    rows: list[tuple[str, ...]] = [row_of(result, estimate, text) for estimate in estimates]
    if len(set(factors)) > 1:
        head = ("estimate", "value", "U", "unit", "k")
        rows = [(*row, k) for row, k in zip(rows, factors, strict=True)]
    return joined([tag("h2", "Estimates"), _first_rows(head, rows, "Estimates with expanded uncertainty", (1, 2))])


def _first_rows(head: Sequence[str], rows: Sequence[Sequence[str]], caption: str, numbers: Sequence[int]) -> Html:
    """Return a table of which the first rows are seen, and the others when they are asked for."""
    first = table(head, rows[:_FIRST], caption, numbers)
    if len(rows) <= _FIRST:
        return first
    more = f"{len(rows) - _FIRST} more"
    return joined([first, tag("details", tag("summary", more), table(head, rows[_FIRST:], "", numbers))])


def _of_effect(result: Result, estimate: Estimate) -> bool:
    """Return whether an estimate is the size of an effect in the model: a reader looks for these first."""
    return f"effects/{estimate.name.rpartition('.')[0]}/parameters" in result.tables


def _facts(content: Content) -> Html:
    bad = list(worst(content.result)) or ["This result has no readings or places to compare."]
    required = [str(decision) for decision in content.record.verdicts] or ["No acceptance criterion in the job."]
    columns = (("Worst", bad), ("Diagnosis", list(diagnosed(content))), ("Acceptance", required))
    return joined(part for name, lines in columns for part in (tag("h2", name), listed(lines)))


def _warnings(content: Content) -> Html:
    warnings = content.result.warnings
    return joined([tag("h2", "Warnings"), listed(warnings)]) if warnings else EMPTY


def _details(content: Content) -> Html:
    parts = [tag("h2", "Details"), _statistics(content.result.statistics)]
    notes = "\n".join(content.result.notes).strip("\n")
    parts += [tag("div", *_notes(notes.split("\n")), class_="notes")] if notes else []
    for name, text in content.tables.items():
        parts.append(tag("details", tag("summary", f"Table {name}"), tag("pre", text, tabindex="0")))
    return joined(parts)


def _notes(lines: list[str]) -> Iterator[Html]:
    """Yield notes for reading at any width: sentences are broken into lines, tables scroll on their own."""
    for is_table, block in groupby(lines, lambda line: "  " in line.strip()):
        if is_table:
            yield tag("pre", "\n".join(block), tabindex="0")
        else:
            yield from (tag("p", line) for line in block)


def _statistics(statistics: Mapping[str, Any]) -> Html:
    rows = []
    for name in _STATISTICS:
        value = statistics.get(name)
        if isinstance(value, Mapping):
            rows += [(f"{name} ({unit})", _number(entry)) for unit, entry in value.items()]
        elif value is not None:
            rows.append((name, _number(value)))
    return table(("figure", "value"), rows, "", (1,)) if rows else EMPTY


def _number(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _provenance(content: Content) -> Html:
    record = content.record
    files = [(file.path, f"{file.bytes}", file.sha256) for file in record.inputs]
    made = f"{content.path}, made {record.created} by metrocli {record.metrocli_version}."
    return joined(
        [
            tag("h2", "Traceability"),
            listed(_traceability(content)),
            tag("h2", "Provenance"),
            tag("p", made),
            _first_rows(("input", "bytes", "SHA-256"), files, "Inputs, relative to the job file", (1,))
            if files
            else EMPTY,
            tag("details", tag("summary", "Job as used"), tag("pre", record.job_text, tabindex="0")),
        ]
    )


def _traceability(content: Content) -> Iterator[str]:
    """Yield what the result rests on, what the measurement does not control, and what its uncertainties are of."""
    files = [file.path for file in content.record.inputs]
    if files:
        digests = "digest is" if len(files) == 1 else "digests are"
        yield f"The result rests on {listed_words(files)}, whose {digests} below."
    numbers = [f"{name}: certificate {number}" for name, number in content.record.references() if number]
    yield from numbers
    if not numbers:
        yield "Certificate numbers of references are not recorded: state them in certificate: references: of the job."
    table_of = content.result.tables.get("not_controlled")
    if table_of is not None and len(table_of):
        names = ", ".join(table_of.texts("effect"))
        yield f"This measurement does not control: {names}. What controls them has to be traceable on its own."
    yield "The uncertainties follow from the declared inputs and noise (GUM), not from errors that no reading checks."
