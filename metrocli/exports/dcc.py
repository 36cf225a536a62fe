"""The Digital Calibration Certificate (DCC) of PTB, schema 3.3.0, https://ptb.de/dcc: a certificate as XML.

The elements and their order are those of dcc.xsd. The same result gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from metrocli.errors import Fault, InputError
from metrocli.exports import Exported, dsi
from metrocli.exports.dcc_elements import DCC, XSI, add, identified, named, software_of, text_of
from metrocli.record import Record
from metrocli.result import Estimate, K, Result
from metrocli.table import Table

SCHEMA = "3.3.0"
_REQUIRED = (
    "number", "laboratory.name", "laboratory.city", "laboratory.country", "customer.name", "customer.city",
    "item.name", "item.serial", "person", "begin", "end", "issued",
)  # fmt: skip
_CURVES, _POSITIONS = "tables/", ("position",)
"""The group of a machine's curves of errors, and their columns without uncertainty"""
_FILE = re.compile(r".*/.*|.*\.[A-Za-z][A-Za-z0-9]{1,4}")
_ADDRESS = {"street": "street", "post_code": "postCode", "city": "city", "country": "countryCode"}


def files(result: Result, record: Record) -> Exported:
    """Return the certificate of a result as `dcc.xml`.

    Raises InputError with all keys that `certificate:` of the job lacks, and all units that D-SI does not have.
    """
    tables = _certified(result)
    known = [one for one in result.estimates if np.isfinite([one.value, *result.expanded(one)]).all()]
    symbols = [one.unit for one in known]
    symbols += [table.units.get(name) or "1" for table in tables.values() for name in (*_pairs(table), *_places(table))]
    faults = [*_missing(record), *dsi.without_notation(symbols)]
    if not known and not tables:
        faults.append(Fault("the result has no estimate and no table with uncertainties to certify"))
    if faults:
        raise InputError(faults)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA})
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {DCC}/v{SCHEMA}/dcc.xsd")
    _administrative(add(root, "administrativeData"), result, record)
    measured = add(root, "measurementResults")
    _standards(measured, record)
    one = add(measured, "measurementResult")
    named(one, "name", result.title or result.kind)
    named(add(add(one, "usedMethods"), "usedMethod"), "name", f"metrocli {result.kind}")
    software_of(one, "usedSoftware", record)
    _conditions(one, result)
    results = add(one, "results")
    if known:
        data = _result(results, "Estimates", _left_out(result.estimates, known))
        for estimate in known:
            _estimate(data, result, estimate)
    for name, table in tables.items():
        _table(results, result, name, table)
    return {"dcc.xml": text_of(root)}


def _missing(record: Record) -> Iterator[Fault]:
    """Yield a fault for each key that the certificate needs and the job lacks, and for references that it has not."""
    stated, job = record.certificate, f"in the job {record.job_file}".strip()
    for path in _REQUIRED:
        first, _, second = path.partition(".")
        if not (stated.get(first, {}).get(second) if second else stated.get(first)):
            name = ": ".join(path.split("."))
            yield Fault(f"certificate: {name} is missing {job}", hint="add it and run the job again")
    paths = [one.path for one in record.inputs]
    for name in stated.get("references", {}):
        if name not in paths and _FILE.fullmatch(name):
            hint = f"its inputs are: {', '.join(paths)}" if paths else "it has no inputs; name the standard"
            yield Fault(f"certificate: references: {name} is no input of the result", hint=hint)


def _administrative(to: ET.Element, result: Result, record: Record) -> None:
    """Add who calibrated what for whom."""
    stated = record.certificate
    software_of(to, "dccSoftware", record)
    core = add(to, "coreData")
    add(core, "countryCodeISO3166_1", stated["laboratory"]["country"])
    add(core, "usedLangCodeISO639_1", "en")
    add(core, "mandatoryLangCodeISO639_1", "en")
    add(core, "uniqueIdentifier", stated["number"])
    identified(core, [("calibrationLaboratory", stated.get("order"), "order number")])
    if "received" in stated:
        add(core, "receiptDate", stated["received"])
    add(core, "beginPerformanceDate", stated["begin"])
    add(core, "endPerformanceDate", stated["end"])
    add(core, "performanceLocation", stated["place"])
    add(core, "issueDate", stated["issued"])
    _item(add(add(to, "items"), "item"), stated["item"])
    laboratory = add(to, "calibrationLaboratory")
    if "code" in stated["laboratory"]:
        add(laboratory, "calibrationLaboratoryCode", stated["laboratory"]["code"])
    _contact(add(laboratory, "contact"), stated["laboratory"])
    person = add(add(to, "respPersons"), "respPerson")
    named(add(person, "person"), "name", stated["person"])
    add(person, "mainSigner", "true")
    _contact(add(to, "customer"), stated["customer"])
    statements = add(to, "statements")
    for name, lines in _statements(result, record):
        statement = add(statements, "statement")
        named(statement, "name", name)
        named(statement, "declaration", *lines)


def _conditions(to: ET.Element, result: Result) -> None:
    """Add what influenced the readings, without which PTB's Schematron rules refuse a certificate."""
    held = add(to, "influenceConditions")
    temperatures = [one.numbers("temp") for one in result.tables.values() if one.units.get("temp") == "degC"]
    known = np.concatenate([*temperatures, np.zeros(0)])
    known = known[np.isfinite(known)]
    if len(known):
        data = _condition(held, "Temperature of the readings")
        for name, value in (("lowest", known.min()), ("highest", known.max())):
            quantity = add(data, "quantity")
            named(quantity, "name", name)
            dsi.real(quantity, float(value), "degC", 0.0, K, 0.0)
    text = "Influences such as temperature and air are in the job and its files, which the result records."
    named(_condition(held, "Conditions of the measurement"), "text", text)


def _condition(to: ET.Element, name: str) -> ET.Element:
    """Add a condition and return where its data go."""
    one = add(to, "influenceCondition")
    named(one, "name", name)
    return add(one, "data")


def _item(to: ET.Element, item: Mapping[str, str]) -> None:
    named(to, "name", item["name"])
    if "manufacturer" in item:
        named(add(to, "manufacturer"), "name", item["manufacturer"])
    if "model" in item:
        add(to, "model", item["model"])
    numbers = (("manufacturer", item["serial"], "serial number"), ("owner", item.get("inventory"), "inventory number"))
    identified(to, numbers)


def _contact(to: ET.Element, contact: Mapping[str, str]) -> None:
    named(to, "name", contact["name"])
    if "email" in contact:
        add(to, "eMail", contact["email"])
    location = add(to, "location")
    for key, name in _ADDRESS.items():
        if key in contact:
            add(location, name, contact[key])


def _statements(result: Result, record: Record) -> Iterator[tuple[str, list[str]]]:
    """Yield name and lines of each statement: traceability, uncertainty, what was required, and what forbids use."""
    numbers = {name: number or "not given" for name, number in record.references()}
    digests = {one.path: f"; SHA-256 {one.sha256}" for one in record.inputs}
    rests = [f"{name}: certificate {number}{digests.get(name, '')}" for name, number in numbers.items()]
    yield "Traceability", ["The result rests on these references.", *rests] if rests else ["The job states all values."]
    yield (
        "Measurement uncertainty",
        [
            "The uncertainties are expanded by the coverage factor k that is stated with each (GUM).",
            "They follow from the declared inputs and noise, not from errors that no reading checks.",
        ],
    )
    if record.verdicts:
        yield "Acceptance criteria", [str(one) for one in record.verdicts]
    if result.warnings:
        yield "Warnings", list(result.warnings)
    if result.doubts:
        yield "Not fit for use", list(result.doubts)


def _standards(to: ET.Element, record: Record) -> None:
    """Add each reference that has a certificate, with its number."""
    numbered = [(name, number) for name, number in record.references() if number]
    held = add(to, "measuringEquipments") if numbered else to
    for name, number in numbered:
        one = add(held, "measuringEquipment")
        named(one, "name", name)
        identified(one, [("other", number, "certificate number")])


def _left_out(estimates: Sequence[Estimate], known: Sequence[Estimate]) -> str:
    names = [one.name for one in estimates if one not in known]
    return f"Not determined, so not certified: {', '.join(names)}." if names else ""


def _result(to: ET.Element, name: str, remark: str) -> ET.Element:
    """Add a result and return where its data go."""
    one = add(to, "result")
    named(one, "name", name)
    if remark:
        named(one, "description", remark)
    return add(one, "data")


def _estimate(to: ET.Element, result: Result, estimate: Estimate) -> None:
    spread, k = result.expanded(estimate)
    quantity = add(to, "quantity")
    named(quantity, "name", estimate.name)
    dsi.real(quantity, estimate.value, estimate.unit, spread, k, _probability(result, k, estimate.name))
    _pixels(quantity, estimate.unit)


def _probability(result: Result, k: float, name: str = "") -> float:
    """Return the coverage probability: the stated one, else that of k for normal errors.

    Where the noise was estimated it is that of Student's distribution with the degrees of freedom (GUM G.3).
    """
    from scipy.special import ndtr, stdtr

    stated = result.details.get(name, {}).get("probability")
    if stated is not None:
        return float(stated)
    dof = result.statistics.get("dof")
    estimated = "noise_estimated" in result.statistics and isinstance(dof, int | float) and dof > 0
    return float(2 * (stdtr(dof, k) if estimated else ndtr(k)) - 1)


def _certified(result: Result) -> dict[str, Table]:
    """Return the tables to certify by name: the first shown one with standard uncertainties, and curves of errors.

    Their rows are those in which every value and its uncertainty are determined.
    """
    shown = ((one.name, result.tables[one.name]) for one in result.shown if one.name in result.tables)
    first = next(((name, table) for name, table in shown if _pairs(table)), None)
    curves = [(name, table) for name, table in result.tables.items() if name.startswith(_CURVES) and _pairs(table)]
    whole = ((name, _whole(table)) for name, table in ([first] if first else []) + curves)
    return {name: table for name, table in whole if len(table)}


def _whole(table: Table) -> Table:
    pairs = _pairs(table)
    rows = np.isfinite(table.stacked([*pairs, *pairs.values()])).all(axis=1)
    return replace(table, columns={name: column[rows] for name, column in table.columns.items()}, lines=())


def _pairs(table: Table) -> dict[str, str]:
    """Return the columns that have standard uncertainties, with the column of these: `sx` or `s_x` of `x`."""
    known = {name: ["std"] if name == "value" else [f"s_{name}", f"s{name}"] for name in table}
    return {name: std for name, stds in known.items() for std in stds if std in table}


def _places(table: Table) -> list[str]:
    """Return the columns that place a row and have no uncertainty."""
    return [name for name in _POSITIONS if name in table]


def _table(to: ET.Element, result: Result, name: str, table: Table) -> None:
    """Add a table as a list of columns."""
    lacking = len(result.tables[name]) - len(table)
    remark = f"Not determined, so not certified: {lacking} of {len(result.tables[name])} rows." if lacking else ""
    held = add(_result(to, name, remark), "list")
    for key in (one for one in table if table.columns[one].dtype.kind == "U"):
        cells = [re.sub(r"\s+", "_", cell.strip()) or "-" for cell in table.texts(key)]
        quantity = add(held, "quantity")
        named(quantity, "name", key)
        add(quantity, "charsXMLList", " ".join(cells))
    pairs, probability = _pairs(table), _probability(result, K)
    for column in (*_places(table), *pairs):
        quantity = add(held, "quantity")
        named(quantity, "name", column)
        unit, spreads = table.units.get(column) or "1", K * table.numbers(pairs[column]) if column in pairs else None
        dsi.real_list(quantity, table.numbers(column), unit, spreads, K, probability)
        _pixels(quantity, unit)


def _pixels(to: ET.Element, unit: str) -> None:
    """Add the definition of the unit of images to a quantity that has it."""
    if dsi.PIXEL in re.findall("[a-z]+", unit):
        data = add(add(to, "measurementMetaData"), "metaData")
        add(data, "nonSIDefinition", "px: the distance between neighbouring pixels of the camera")
        add(data, "nonSIUnit", unit)
