"""Quantities of a Digital Calibration Certificate: estimates, their correlation and conformity, and tables."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from metrocli.arrays import Mask
from metrocli.exports import dcc_elements as dsi
from metrocli.exports.dcc_elements import DCC, add, add_text
from metrocli.result import Estimate, K, Result
from metrocli.table import Table

_MEASURED, _INDEX = "basic_measuredValue", "basic_tableIndex0"
"""What kind a quantity is, in the words of DKD's database of refTypes and of PTB's reader of tables"""
_CURVES, _POSITIONS = "tables/", ("position",)
"""The group of a machine's curves of errors, and their columns without uncertainty"""
_LIMITS = {"limits": "tolerance", "acceptance": "acceptance"}
"""Limits of a decision, by their names in DKD's database"""
_CORRELATION = (
    "Correlation coefficients of the estimates: u(a, b) is r(a, b) times the standard uncertainties of a and b."
)
_MOST_CORRELATED, _UNCORRELATED = 100, 5e-7
"""Estimates of which a certificate states the correlation, 10,000 numbers at most, and coefficients that are zero"""


def certified(result: Result) -> tuple[list[Estimate], dict[str, Table]]:
    """Return the estimates that are determined, and by name the tables to certify.

    These are the first shown one with standard uncertainties, and curves of errors. Their rows are those in which every
    value and its uncertainty are determined.
    """
    known = [
        estimate for estimate in result.estimates if np.isfinite([estimate.value, *result.expanded(estimate)]).all()
    ]
    shown = ((table.name, result.tables[table.name]) for table in result.shown if table.name in result.tables)
    first = next(((name, table) for name, table in shown if _pairs(table)), None)
    curves = [(name, table) for name, table in result.tables.items() if name.startswith(_CURVES) and _pairs(table)]
    whole = ((name, _whole(table)) for name, table in ([first] if first else []) + curves)
    return known, {name: table for name, table in whole if len(table)}


def symbols_of(known: Sequence[Estimate], tables: Mapping[str, Table]) -> list[str]:
    """Return the symbols of the units in which estimates and tables are stated."""
    of_tables = (table.units.get(name) for table in tables.values() for name in (*_pairs(table), *_places(table)))
    return [estimate.unit for estimate in known] + [unit or "1" for unit in of_tables]


def _whole(table: Table) -> Table:
    pairs = _pairs(table)
    finite: Mask = np.asarray(np.isfinite(table.stacked([*pairs, *pairs.values()])).all(axis=1))
    return table.selected(finite)


def _pairs(table: Table) -> dict[str, str]:
    """Return the columns that have standard uncertainties, with the column of these: `sx` or `s_x` of `x`."""
    known = {name: ["std"] if name == "value" else [f"s_{name}", f"s{name}"] for name in table}
    return {name: std for name, stds in known.items() for std in stds if std in table}


def _places(table: Table) -> list[str]:
    """Return the columns that place a row and have no uncertainty."""
    return [name for name in _POSITIONS if name in table]


def _result(to: ET.Element, name: str, *remarks: str) -> ET.Element:
    """Add a result and return where its data go."""
    element = add(to, "result")
    add_text(element, "name", name)
    if remarks:
        add_text(element, "description", "\n".join(remarks))
    return add(element, "data")


def _quantity(to: ET.Element, name: str, kind: str = "") -> ET.Element:
    """Add a quantity without its value, of a kind such as `basic_measuredValue`."""
    quantity = add(to, "quantity", **({"refType": kind} if kind else {}))
    add_text(quantity, "name", name)
    return quantity


def add_estimates(to: ET.Element, result: Result, known: Sequence[Estimate]) -> None:
    """Add the estimates that are determined, with a remark that names the others, and how they correlate."""
    lacking = [other.name for other in result.estimates if other not in known]
    remarks = [f"Not determined, so not certified: {', '.join(lacking)}."] if lacking else []
    if len(known) > _MOST_CORRELATED:
        remarks.append(
            f"The result file has the correlation of the {len(known)} estimates, which are too many for it here."
        )
    data = _result(to, "Estimates", *remarks)
    for estimate in known:
        spread, k = result.expanded(estimate)
        quantity = _quantity(data, estimate.name, _MEASURED)
        dsi.add_real(quantity, estimate.value, estimate.unit, spread, k, _probability(result, k, estimate.name))
        _conformity(quantity, estimate, result.details.get(estimate.name, {}).get("tolerance", {}))
        _pixels(quantity, estimate.unit)
        _against_trials(quantity, result, estimate.name)
    if len(known) <= _MOST_CORRELATED:
        _correlation(to, result, known)


def _correlation(to: ET.Element, result: Result, known: Sequence[Estimate]) -> None:
    """Add the correlation matrix of estimates as a table of (n, n) coefficients (GUM 7.2.5); none if none correlate."""
    rows = [result.estimates.index(estimate) for estimate in known]
    covariance = result.covariance[np.ix_(rows, rows)]
    spreads = np.sqrt(np.diag(covariance))
    matrix = covariance / np.outer(spreads, spreads).clip(np.finfo(float).tiny)
    np.fill_diagonal(matrix, 1.0)
    if not np.isfinite(matrix).all() or np.abs(matrix - np.eye(len(known))).max(initial=0.0) < _UNCORRELATED:
        return
    names = [estimate.name for estimate in known]
    held = _list(_result(to, "Correlation", _CORRELATION), "estimate")
    _texts(held, "estimate", names, _INDEX)
    for name, column in zip(names, matrix.T, strict=True):
        dsi.add_real_list(_quantity(held, f"correlation with {name}"), column, "1")


def _probability(result: Result, k: float, name: str = "") -> float:
    """Return the coverage probability: the stated one, else that of k for normal errors.

    Where Monte Carlo contradicts it, it is the share of the trials within U. Where the noise was estimated it is that
    of Student's distribution with the degrees of freedom (GUM G.3).
    """
    from scipy.special import ndtr, stdtr

    trials, stated = _contradicting(result, name), result.details.get(name, {}).get("probability")
    if trials is not None:
        return min(float(trials["covered"]), 1 - 1 / float(trials["trials"]))
    if stated is not None:
        return float(stated)
    dof = result.statistics.get("dof")
    estimated = "noise_estimated" in result.statistics and isinstance(dof, int | float) and dof > 0
    return float(2 * (stdtr(dof, k) if estimated else ndtr(k)) - 1)


def add_table(to: ET.Element, result: Result, name: str, table: Table) -> None:
    """Add a table as a list of columns; the first one that places or names its rows is the index."""
    lacking = len(result.tables[name]) - len(table)
    remarks = [f"Not determined, so not certified: {lacking} of {len(result.tables[name])} rows."] if lacking else []
    texts = [column for column in table if table.columns[column].dtype.kind == "U"]
    index = next(iter([*_places(table), *texts]), None)
    held = _list(_result(to, name, *remarks), index)
    for key in texts:
        _texts(held, key, table.texts(key), _INDEX if key == index else "")
    pairs, probability = _pairs(table), _probability(result, K)
    for column in (*_places(table), *pairs):
        quantity = _quantity(held, column, _INDEX if column == index else _MEASURED)
        unit, spreads = table.units.get(column) or "1", K * table.numbers(pairs[column]) if column in pairs else None
        dsi.add_real_list(quantity, table.numbers(column), unit, spreads, K, probability)
        _pixels(quantity, unit)


def _contradicting(result: Result, name: str) -> Mapping[str, Any] | None:
    """Return the Monte Carlo result of an estimate where it contradicts the GUM (JCGM 101, 8), None elsewhere."""
    details = result.details.get(name, {})
    trials = details.get("mc")
    contradicts = trials is not None and details.get("gum_valid") == 0 and np.isfinite(trials["covered"])
    return trials if contradicts else None


def _against_trials(quantity: ET.Element, result: Result, name: str) -> None:
    """Add where the coverage probability of an estimate is that of Monte Carlo, and which one the GUM gives."""
    trials = _contradicting(result, name)
    if trials is not None:
        remark, by_gum = _remark(quantity), 100 * float(result.details[name]["probability"])
        text = f"The coverage probability is the share of {trials['trials']:.0f} Monte Carlo trials within U, which"
        add_text(remark, "name", "Coverage by Monte Carlo")
        add_text(remark, "description", f"{text} contradict the {by_gum:.4g} % of the law of propagation.")
        add(remark, "norm", "JCGM 101:2008")


def _list(to: ET.Element, index: str | None) -> ET.Element:
    """Add a list of columns; one with an index is a table to the readers of PTB."""
    return add(to, "list") if index is None else add(to, "list", refType="basic_1IndexTable")


def _texts(to: ET.Element, name: str, texts: Sequence[str], kind: str) -> None:
    """Add a column of texts; XML lists are separated by blanks, so a text has none."""
    cells = [re.sub(r"\s+", "_", text.strip()) or "-" for text in texts]
    add(_quantity(to, name, kind), "charsXMLList", " ".join(cells))


def _remark(to: ET.Element, **attributes: str) -> ET.Element:
    """Return a new remark about a quantity, beside the others that it has."""
    held = to.find(f"{{{DCC}}}measurementMetaData")
    return add(add(to, "measurementMetaData") if held is None else held, "metaData", **attributes)


def _pixels(to: ET.Element, unit: str) -> None:
    """Add the definition of the unit of images to a quantity that has it."""
    if dsi.PIXEL in re.findall("[a-z]+", unit):
        remark = _remark(to)
        add(remark, "nonSIDefinition", "px: the distance between neighbouring pixels of the camera")
        add(remark, "nonSIUnit", unit)


def _conformity(to: ET.Element, estimate: Estimate, decision: Mapping[str, Any]) -> None:
    """Add whether an estimate conforms to its tolerance, with the limits and those of acceptance, if it has one.

    A value in the guard band passes or fails on condition (ILAC-G8:09/2019, 4.2.3).
    """
    if "zone" not in decision:
        return
    remark, (low, high) = _remark(to, refType="basic_conformity"), decision["limits"]
    add_text(remark, "name", "Conformity")
    add(remark, "norm", "ISO 14253-1")
    add_text(remark, "declaration", "Decision rule: the guard band at each limit of the tolerance is U.")
    undecided = "conditionalPass" if low <= estimate.value <= high else "conditionalFail"
    add(remark, "conformity", {"conforming": "pass", "non-conforming": "fail"}.get(decision["zone"], undecided))
    data = add(remark, "data")
    for key, limit in _LIMITS.items():
        for end, value in zip(("Lower", "Upper"), decision.get(key, ()), strict=False):
            if np.isfinite(value):
                quantity = _quantity(data, f"{end.lower()} {limit} limit", f"basic_{limit}Limit{end}")
                dsi.add_real(quantity, value, estimate.unit)
