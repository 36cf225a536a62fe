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
from metrocli.exports.dcc_elements import DCC, XSI, add, add_identifications, add_name, add_software, add_text, text_of
from metrocli.exports.dcc_quantities import add_estimates, add_table, certified, symbols_of
from metrocli.record import Record
from metrocli.result import Result

SCHEMA = "3.3.0"
_REQUIRED = (
    "number", "laboratory.name", "laboratory.city", "laboratory.country", "customer.name", "customer.city",
    "item.name", "item.serial", "person", "begin", "end", "issued",
)  # fmt: skip
_FILE = re.compile(r".*/.*|.*\.[A-Za-z][A-Za-z0-9]{1,4}")
"""A reference that is meant as a file: with a folder or an ending; others name a standard"""
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
    _add_administrative_data(add(root, "administrativeData"), result, record)
    measured = add(root, "measurementResults")
    _add_standards(measured, record)
    element = add(measured, "measurementResult")
    add_text(element, "name", result.title or result.kind)
    _add_methods(add(element, "usedMethods"), result)
    add_software(element, "usedSoftware", record)
    _add_conditions(element, result)
    results = add(element, "results")
    if known:
        add_estimates(results, result, known)
    for name, table in tables.items():
        add_table(results, result, name, table)
    return {"dcc.xml": text_of(root)}


def _missing(record: Record) -> Iterator[Fault]:
    """Yield a fault for each key that a certificate needs and the job lacks, and for each foreign reference."""
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
            yield Fault(f"certificate: references: {name} is not an input of the result", hint=hint)


def _add_administrative_data(to: ET.Element, result: Result, record: Record) -> None:
    """Add who calibrated what for whom."""
    stated = record.certificate
    add_software(to, "dccSoftware", record)
    core = add(to, "coreData")
    add(core, "countryCodeISO3166_1", stated["laboratory"]["country"])
    add(core, "usedLangCodeISO639_1", "en")
    add(core, "mandatoryLangCodeISO639_1", "en")
    add(core, "uniqueIdentifier", stated["number"])
    add_identifications(core, [("calibrationLaboratory", stated.get("order"), "order number")])
    if "received" in stated:
        add(core, "receiptDate", stated["received"])
    add(core, "beginPerformanceDate", stated["begin"])
    add(core, "endPerformanceDate", stated["end"])
    add(core, "performanceLocation", stated["place"])
    add(core, "issueDate", stated["issued"])
    _add_item(add(add(to, "items"), "item"), stated["item"])
    laboratory = add(to, "calibrationLaboratory")
    if "code" in stated["laboratory"]:
        add(laboratory, "calibrationLaboratoryCode", stated["laboratory"]["code"])
    _add_contact(add(laboratory, "contact"), stated["laboratory"])
    person = add(add(to, "respPersons"), "respPerson")
    add_name(add(person, "person"), stated["person"])
    add(person, "mainSigner", "true")
    _add_contact(add(to, "customer"), stated["customer"])
    statements = add(to, "statements")
    for name, lines in _statements(result, record):
        statement = add(statements, "statement")
        add_text(statement, "name", name)
        add_text(statement, "declaration", "\n".join(lines))


def _add_methods(to: ET.Element, result: Result) -> None:
    """Add how the results and their uncertainties were determined."""
    add_text(add(to, "usedMethod", refType="basic_calibrationMethod"), "name", f"metrocli {result.kind}")
    uncertainty = add(to, "usedMethod", refType="basic_methodMeasurementUncertainty")
    add_text(uncertainty, "name", "Measurement uncertainty")
    text = (
        "The uncertainties are expanded by the coverage factor k that is stated with each. D-SI has no k below 1: the "
        "standard uncertainty is stated there. They follow from the declared inputs and noise, not from errors that no "
        "reading checks."
    )
    add_text(uncertainty, "description", text)
    add(uncertainty, "norm", "JCGM 100:2008")


def _add_conditions(to: ET.Element, result: Result) -> None:
    """Add what influenced the readings, without which PTB's Schematron rules refuse a certificate."""
    conditions = add(to, "influenceConditions")
    temperatures = [table.numbers("temp") for table in result.tables.values() if table.units.get("temp") == "degC"]
    known = np.concatenate([*temperatures, np.zeros(0)])
    known = known[np.isfinite(known)]
    if len(known):
        data = _add_condition(conditions, "Temperature of the readings", refType="basic_temperature")
        for kind, name, value in (("minimum", "lowest", known.min()), ("maximum", "highest", known.max())):
            quantity = add(data, "quantity", refType=f"math_{kind}")
            add_text(quantity, "name", name)
            dsi.add_real(quantity, float(value), "degC")
    text = "Influences such as temperature and air are in the job and its files, which the result records."
    add_text(_add_condition(conditions, "Conditions of the measurement"), "text", text)


def _add_condition(to: ET.Element, name: str, **attributes: str) -> ET.Element:
    """Add a condition and return where its data go."""
    element = add(to, "influenceCondition", **attributes)
    add_text(element, "name", name)
    return add(element, "data")


def _add_item(to: ET.Element, item: Mapping[str, str]) -> None:
    add_name(to, item["name"])
    if "manufacturer" in item:
        add_name(add(to, "manufacturer"), item["manufacturer"])
    if "model" in item:
        add(to, "model", item["model"])
    serial = ("manufacturer", item["serial"], "serial number")
    add_identifications(to, [serial, ("owner", item.get("inventory"), "identification number")])


def _add_contact(to: ET.Element, contact: Mapping[str, str]) -> None:
    add_name(to, contact["name"])
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
    stated = [f"{name}: certificate {number}{digests.get(name, '')}" for name, number in numbers.items()]
    text = ["The result rests on these references.", *stated] if stated else ["The job states all values."]
    yield "Traceability", text
    if record.verdicts:
        yield "Acceptance criteria", [str(verdict) for verdict in record.verdicts]
    if result.warnings:
        yield "Warnings", list(result.warnings)
    if result.doubts:
        yield "Not fit for use", list(result.doubts)


def _add_standards(to: ET.Element, record: Record) -> None:
    """Add each reference that has a certificate, with its number; a certificate on paper has no digest."""
    numbered = [(name, number) for name, number in record.references() if number]
    # the schema allows no empty list
    equipments = add(to, "measuringEquipments") if numbered else to
    for name, number in numbered:
        element = add(equipments, "measuringEquipment", refType="basic_measurementStandard")
        add_name(element, name)
        certificate = add(element, "certificate")
        add_text(certificate, "referral", "Calibration certificate")
        for key, text in (("referralID", number), ("procedure", "analogue"), ("value", "noValue")):
            add(certificate, key, text)
