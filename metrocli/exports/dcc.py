"""The Digital Calibration Certificate (DCC) of PTB, schema 3.3.0, https://ptb.de/dcc: a certificate as XML.

The elements and their order are those of dcc.xsd. The same result gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from xml.etree import ElementTree as ET

import numpy as np

from metrocli.errors import Fault, InputError
from metrocli.exports import Exported
from metrocli.exports import dcc_elements as dsi
from metrocli.exports.dcc_elements import DCC, XSI, add, called, identified, named, software_of, text_of
from metrocli.exports.dcc_quantities import add_estimates, add_table, certified, symbols_of
from metrocli.record import Record
from metrocli.result import Result

SCHEMA = "3.3.0"
_REQUIRED = (
    "number", "laboratory.name", "laboratory.city", "laboratory.country", "customer.name", "customer.city",
    "item.name", "item.serial", "person", "begin", "end", "issued",
)  # fmt: skip
_FILE = re.compile(r".*/.*|.*\.[A-Za-z][A-Za-z0-9]{1,4}")
_ADDRESS = {"street": "street", "post_code": "postCode", "city": "city", "country": "countryCode"}


def files(result: Result, record: Record) -> Exported:
    """Return the certificate of a result as `dcc.xml`.

    Raises InputError with all keys that `certificate:` of the job lacks, and all units that D-SI does not have.
    """
    known, tables = certified(result)
    faults = [*_missing(record), *dsi.without_notation(symbols_of(known, tables))]
    if not known and not tables:
        faults.append(Fault("the result has no estimate and no table with uncertainties to certify"))
    if faults:
        raise InputError(faults)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA})
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {DCC}/v{SCHEMA}/dcc.xsd")
    _administrative(add(root, "administrativeData"), result, record)
    measured = add(root, "measurementResults")
    _standards(measured, record)
    element = add(measured, "measurementResult")
    named(element, "name", result.title or result.kind)
    _methods(add(element, "usedMethods"), result)
    software_of(element, "usedSoftware", record)
    _conditions(element, result)
    results = add(element, "results")
    if known:
        add_estimates(results, result, known)
    for name, table in tables.items():
        add_table(results, result, name, table)
    return {"dcc.xml": text_of(root)}


def _missing(record: Record) -> Iterator[Fault]:
    """Yield a fault for each key that the certificate needs and the job lacks, and for references that it has not."""
    stated, job = record.certificate, f"in the job {record.job_file}".strip()
    for path in _REQUIRED:
        first, _, second = path.partition(".")
        if not (stated.get(first, {}).get(second) if second else stated.get(first)):
            name = ": ".join(path.split("."))
            yield Fault(f"certificate: {name} is missing {job}", hint="add it and run the job again")
    paths = [file.path for file in record.inputs]
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
    called(add(person, "person"), stated["person"])
    add(person, "mainSigner", "true")
    _contact(add(to, "customer"), stated["customer"])
    statements = add(to, "statements")
    for name, lines in _statements(result, record):
        statement = add(statements, "statement")
        named(statement, "name", name)
        named(statement, "declaration", "\n".join(lines))


def _methods(to: ET.Element, result: Result) -> None:
    """Add how the results and their uncertainties were found."""
    named(add(to, "usedMethod", refType="basic_calibrationMethod"), "name", f"metrocli {result.kind}")
    uncertainty = add(to, "usedMethod", refType="basic_methodMeasurementUncertainty")
    named(uncertainty, "name", "Measurement uncertainty")
    text = (
        "The uncertainties are expanded by the coverage factor k that is stated with each. D-SI has no k below 1: the "
        "standard uncertainty is stated there. They follow from the declared inputs and noise, not from errors that no "
        "reading checks."
    )
    named(uncertainty, "description", text)
    add(uncertainty, "norm", "JCGM 100:2008")


def _conditions(to: ET.Element, result: Result) -> None:
    """Add what influenced the readings, without which PTB's Schematron rules refuse a certificate."""
    held = add(to, "influenceConditions")
    temperatures = [table.numbers("temp") for table in result.tables.values() if table.units.get("temp") == "degC"]
    known = np.concatenate([*temperatures, np.zeros(0)])
    known = known[np.isfinite(known)]
    if len(known):
        data = _condition(held, "Temperature of the readings", refType="basic_temperature")
        for kind, name, value in (("minimum", "lowest", known.min()), ("maximum", "highest", known.max())):
            quantity = add(data, "quantity", refType=f"math_{kind}")
            named(quantity, "name", name)
            dsi.real(quantity, float(value), "degC")
    text = "Influences such as temperature and air are in the job and its files, which the result records."
    named(_condition(held, "Conditions of the measurement"), "text", text)


def _condition(to: ET.Element, name: str, **attributes: str) -> ET.Element:
    """Add a condition and return where its data go."""
    element = add(to, "influenceCondition", **attributes)
    named(element, "name", name)
    return add(element, "data")


def _item(to: ET.Element, item: Mapping[str, str]) -> None:
    called(to, item["name"])
    if "manufacturer" in item:
        called(add(to, "manufacturer"), item["manufacturer"])
    if "model" in item:
        add(to, "model", item["model"])
    serial = ("manufacturer", item["serial"], "serial number")
    identified(to, [serial, ("owner", item.get("inventory"), "identification number")])


def _contact(to: ET.Element, contact: Mapping[str, str]) -> None:
    called(to, contact["name"])
    if "email" in contact:
        add(to, "eMail", contact["email"])
    location = add(to, "location")
    for key, name in _ADDRESS.items():
        if key in contact:
            add(location, name, contact[key])


def _statements(result: Result, record: Record) -> Iterator[tuple[str, list[str]]]:
    """Yield name and lines of each statement: scope, traceability, what was required, and what forbids use."""
    yield "Scope", ["The results relate only to the item calibrated, as it was at the time of the measurement."]
    numbers = {name: number or "not given" for name, number in record.references()}
    digests = {file.path: f"; SHA-256 {file.sha256}" for file in record.inputs}
    rests = [f"{name}: certificate {number}{digests.get(name, '')}" for name, number in numbers.items()]
    yield "Traceability", ["The result rests on these references.", *rests] if rests else ["The job states all values."]
    if record.verdicts:
        yield "Acceptance criteria", [str(verdict) for verdict in record.verdicts]
    if result.warnings:
        yield "Warnings", list(result.warnings)
    if result.doubts:
        yield "Not fit for use", list(result.doubts)


def _standards(to: ET.Element, record: Record) -> None:
    """Add each reference that has a certificate, with its number; a certificate on paper has no digest."""
    numbered = [(name, number) for name, number in record.references() if number]
    held = add(to, "measuringEquipments") if numbered else to
    for name, number in numbered:
        element = add(held, "measuringEquipment", refType="basic_measurementStandard")
        called(element, name)
        certificate = add(element, "certificate")
        named(certificate, "referral", "Calibration certificate")
        for key, text in (("referralID", number), ("procedure", "analogue"), ("value", "noValue")):
            add(certificate, key, text)
