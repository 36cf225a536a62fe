"""The Digital Calibration Certificate: its elements are those of the schema, its numbers those of the result."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from plots import results

from metrocli.errors import InputError
from metrocli.exports import dsi, export
from metrocli.record import InputFile, Record, Verdict
from metrocli.result import Estimate, Result, ShownTable

EVIL = "<b attr=\"x\">&amp; ]]> 'q'\x01"
CERTIFICATE: dict[str, Any] = {
    "number": "2026-0815", "order": "A-17", "person": "A. Metrologist", "place": "customer",
    "received": "2026-11-01", "begin": "2026-11-02", "end": "2026-11-03", "issued": "2026-11-05",
    "laboratory": {"name": "Lab <A & B>", "code": "D-K-1", "city": "Brunswick", "country": "DE", "email": "a@b.de"},
    "customer": {"name": "Gears", "street": "Road 1", "post_code": "LS1", "city": "Leeds", "country": "GB"},
    "item": {"name": "Gauge", "manufacturer": "Block", "model": "M1", "serial": "4711", "inventory": "7"},
    "references": {"data/a.csv": "PTB-1234", "gauge block": "NPL-5"},
}  # fmt: skip
RECORD = Record(
    "job", (InputFile("data/a.csv", "ab" * 32, 9), InputFile("data/b.csv", "cd" * 32, 9)), "0.1.0",
    "2026-11-20T10:00:00Z", (Verdict("sigma0", "< 1.5", 1.0, "", True),), job_file="../jobs/a.yaml",
    certificate=CERTIFICATE,
)  # fmt: skip
NAMES = {"d": "https://ptb.de/dcc", "s": "https://ptb.de/si"}
CONTACT = "name eMail? phone? fax? link? location descriptionData?"
SCHEMA = {  # sequences of dcc.xsd 3.3.0, compared with its text, and of SI_Format.xsd 2: ? is optional, + is one or more
    "digitalCalibrationCertificate": "administrativeData measurementResults comment? document?",
    "administrativeData": "dccSoftware refTypeDefinitions? coreData items calibrationLaboratory respPersons customer statements?",
    "dccSoftware": "software+", "software": "name release type? description?",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1+ mandatoryLangCodeISO639_1+ uniqueIdentifier identifications? receiptDate? beginPerformanceDate endPerformanceDate performanceLocation issueDate? reportAmendedSubstituted? previousReport?",
    "identifications": "identification+", "identification": "issuer value name?",
    "items": "name? equipmentClass? description? owner? manufacturer? identifications? item+",
    "item": "name equipmentClass? description? owner? installedSoftwares? manufacturer? model? identifications itemQuantities? subItems?",
    "manufacturer": CONTACT.replace("location", "location?"), "person": CONTACT.replace("location", "location?"),
    "contact": CONTACT, "customer": CONTACT,
    "calibrationLaboratory": "calibrationLaboratoryCode? contact cryptElectronicSeal?",
    "location": "street? postCode? city? countryCode?",
    "respPersons": "respPerson+", "respPerson": "person description? role? mainSigner? cryptElectronicSeal?",
    "statements": "statement+",
    "statement": "name? description? countryCodeISO3166_1? convention? traceable? norm? reference? link? declaration? valid? date?",
    "measurementResults": "usedMethods? usedSoftware? measuringEquipments? influenceConditions? measurementMetaData? measurementResult+",
    "measuringEquipments": "name? measuringEquipment+",
    "measuringEquipment": "name equipmentClass? description? certificate? manufacturer? model? identifications?",
    "measurementResult": "name description? usedMethods? usedSoftware? measuringEquipments? influenceConditions? results measurementMetaData?",
    "usedMethods": "usedMethod+", "usedMethod": "name description? norm? reference? link?",
    "usedSoftware": "software+", "influenceConditions": "influenceCondition+",
    "influenceCondition": "name description? status? certificate? data",
    "results": "result+", "result": "name description? data", "list": "name? description? dateTime? quantity+",
    "quantity": "name? description? (charsXMLList|real|realListXMLList) relativeUncertainty? usedMethods? measurementMetaData?",
    "measurementMetaData": "metaData+", "metaData": "name? description? data? nonSIDefinition? nonSIUnit? location?",
    "name": "content+", "description": "content+", "declaration": "content+", "data": "(text|quantity|list)+", "text": "name? content*",
    "real": "label? value unit significantDigit? dateTime? measurementUncertaintyUnivariate?",
    "measurementUncertaintyUnivariate": "expandedMU",
    "expandedMU": "valueExpandedMU coverageFactor coverageProbability distribution?",
    "realListXMLList": "labelXMLList? valueXMLList unitXMLList significantDigitXMLList? dateTimeXMLList? measurementUncertaintyUnivariateXMLList?",
    "measurementUncertaintyUnivariateXMLList": "expandedMUXMLList",
    "expandedMUXMLList": "valueExpandedMUXMLList coverageFactorXMLList coverageProbabilityXMLList distributionXMLList?",
}  # fmt: skip
LINE = r"[^\s]+(\s+[^\s]+)*"
"""notEmptyStringType of the schema"""
DECIMAL = r"[-+]?[0-9]+(\.[0-9]+)?([eE][-+]?[0-9]+)?"
TEXTS = {
    "issuer": "manufacturer|calibrationLaboratory|customer|owner|other", "mainSigner": "true|false",
    "countryCode": "[A-Z]{2}", "countryCodeISO3166_1": "[A-Z]{2}", "usedLangCodeISO639_1": "[a-z]{2}",
    "performanceLocation": "laboratory|customer|laboratoryBranch|customerBranch|other", "type": "application",
    **dict.fromkeys(
        ("value", "uniqueIdentifier", "nonSIUnit", "nonSIDefinition", "model", "calibrationLaboratoryCode", "eMail",
         "street", "postCode", "city"), LINE,
    ),
    "release": r"[a-zA-Z] ?([0-9]{1,3}\.){0,3}[0-9]{1,3}",  # PTB's Schematron rules
    **dict.fromkeys(("receiptDate", "beginPerformanceDate", "endPerformanceDate", "issueDate"), r"\d{4}-\d\d-\d\d"),
    **dict.fromkeys(("valueExpandedMU", "coverageFactor", "coverageProbability"), DECIMAL),
    **dict.fromkeys(("valueXMLList", "valueExpandedMUXMLList"), rf"{DECIMAL}( {DECIMAL})*"),
    **dict.fromkeys(("unit", "unitXMLList"), r"(\\[a-z]+(\\tothe\{-?[0-9]+\})?)+"),
}  # fmt: skip


def local(element: ET.Element) -> str:
    return element.tag.partition("}")[2]


def form(sequence: str) -> str:
    """The expression for the names of elements, each followed by a blank, that a sequence allows."""
    return "".join(re.sub(r"(\w+)", r"(?:\1<blank>)", sequence).split()).replace("<blank>", " ")


def violations(root: ET.Element) -> list[str]:
    """Where a certificate departs from the sequences of the schema, or from the form of a text."""
    found = []
    for one in root.iter():
        name, below = local(one), "".join(f"{local(part)} " for part in one)
        if name in SCHEMA:
            if not re.fullmatch(form(SCHEMA[name]), below):
                found.append(f"{name}: {below}")
        elif len(one):
            found.append(f"{name} is not in the schema")
        elif not re.fullmatch(TEXTS.get(name, r"[\s\S]+"), one.text or ""):
            found.append(f"{name}: {one.text}")
    return found


def written(result: Result, record: Record = RECORD) -> ET.Element:
    text = export("dcc", result, record)["dcc.xml"]
    assert isinstance(text, str)
    return ET.fromstring(text)


def net() -> Result:
    return replace(results.network(), shown=(ShownTable("residuals"), ShownTable("points")))


def quantities(root: ET.Element) -> dict[str, ET.Element]:
    return {one.findtext("d:name/d:content", "", NAMES): one for one in root.iterfind(".//d:quantity", NAMES)}


def of(quantity: ET.Element, name: str) -> str:
    return quantity.findtext(f".//s:{name}", "", NAMES)


@pytest.mark.parametrize("result", [net(), results.machine(), results.camera(np.zeros((4, 2)), np.zeros((4, 2)))])
def test_the_elements_are_those_of_the_schema(result: Result) -> None:
    root = written(result)
    assert violations(root) == []
    assert root.get("schemaVersion") == "3.3.0" and root.tag == "{https://ptb.de/dcc}digitalCalibrationCertificate"
    plain = replace(RECORD, certificate={**CERTIFICATE, "references": {}, "order": "", "received": ""})
    assert len(written(result, plain).findall(".//d:measuringEquipment", NAMES)) == 0


def test_a_certificate_has_what_the_schematron_rules_of_ptb_want() -> None:
    """Errors of dcc.sch: a release of one letter and numbers; for each quantity a method, software, conditions."""
    table = results.camera(np.zeros((4, 2)), np.zeros((4, 2)), temp=np.array([19.5, 20.0, 21.0, 22.25]))
    table.tables["residuals"].units["temp"] = "degC"
    root = written(table)
    one = root.find(".//d:measurementResult", NAMES)
    assert one is not None
    assert [local(part) for part in one] == ["name", "usedMethods", "usedSoftware", "influenceConditions", "results"]
    conditions = {
        part.findtext("d:name/d:content", "", NAMES): part for part in one.iterfind(".//d:influenceCondition", NAMES)
    }
    assert list(conditions) == ["Temperature of the readings", "Conditions of the measurement"]
    values = [
        float(part.text or "") for part in conditions["Temperature of the readings"].iterfind(".//s:value", NAMES)
    ]
    assert values == [19.5, 22.25]
    assert {part.get("lang") for part in root.iterfind(".//d:content", NAMES)} == {"en"}
    assert list(quantities(written(net()))).count("lowest") == 0


def test_the_schematron_rules_of_ptb_themselves(tmp_path: Path) -> None:
    rules = pytest.importorskip(
        "dcclib.validation.schematron", reason="dcclib is not installed: pip install dcclib==0.4.0"
    )
    for result in (net(), results.machine(), results.camera(np.zeros((4, 2)), np.zeros((4, 2)))):
        found = rules.SchematronValidator.for_dcc().validate_str(str(export("dcc", result, RECORD)["dcc.xml"]))
        errors = [one for one in (*found.failed_assertions, *found.successful_reports) if "error" in str(vars(one))]
        assert not errors, [vars(one) for one in errors]


def test_texts_have_the_types_of_the_schema_itself() -> None:
    """PTB's converter to JSON carries the types of all elements of dcc.xsd 3.3.0, as it read them from that file."""
    package = pytest.importorskip("dccXMLJSONConv", reason="pip install dccXMLJSONConv==2.3.4")
    held = json.loads((files(package) / "data" / "schemaTypeCastCache.json").read_text(encoding="utf-8"))
    types = held['["https://ptb.de/dcc/dcc.xsd", "3.3.0"]']
    one, several = types["non_list_typecast_dict"], types["list_typecast_dict"]
    one |= {"dcc:content": "str", "dcc:usedLangCodeISO639_1": "str", "dcc:mandatoryLangCodeISO639_1": "str"}
    assert {"dcc:content", "dcc:usedLangCodeISO639_1", "dcc:mandatoryLangCodeISO639_1"} <= set(
        types["repeated_elements"]
    )
    casts = {"str": str, "float": float, "int": int, "bool": {"true": True, "false": False}.__getitem__}
    of_choices = {"dcc:issuer", "dcc:performanceLocation", "dcc:type"}
    """These have lists of allowed words, which the converter does not carry"""
    prefixes = {name: f"{prefix}:" for prefix, name in (("dcc", NAMES["d"]), ("si", NAMES["s"]))}
    for result in (net(), results.machine(), results.budget(), results.camera(np.zeros((4, 2)), np.zeros((4, 2)))):
        for element in written(result).iter():
            space, _, name = element.tag[1:].partition("}")
            name = prefixes[space] + name
            if len(element) or name in of_choices:
                continue
            text = element.text or ""
            for part in text.split() if name in several else [text]:
                kind = several.get(name) or one[name]
                if kind.startswith("datetime."):
                    date.fromisoformat(part)
                else:
                    casts[kind](part)


def test_the_check_of_the_schema_sees_what_is_wrong() -> None:
    whole = written(net())
    for parent in [one for one in whole.iter() if len(one) > 1 and local(one) in ("coreData", "item", "expandedMU")]:
        for change in (lambda one: one.remove(one[0]), lambda one: one.append(one[0])):
            broken = deepcopy(whole)
            change(next(one for one in broken.iter(parent.tag)))
            assert violations(broken), local(parent)
    broken = deepcopy(whole)
    next(broken.iter("{https://ptb.de/si}value")).text = "not determined"
    next(broken.iter("{https://ptb.de/dcc}countryCode")).text = "de"
    assert "countryCode: de" in violations(broken)


def test_estimates_have_expanded_uncertainties() -> None:
    one = quantities(written(net()))["L1.x"]
    assert (of(one, "value"), of(one, "unit"), of(one, "valueExpandedMU")) == ("-100.000", r"\milli\metre", "0.020")
    # 95.45 % of normal errors are within two standard deviations
    assert (of(one, "coverageFactor"), of(one, "coverageProbability")) == ("2", "0.9545")


def test_estimated_noise_has_the_coverage_of_student() -> None:
    found = replace(net(), statistics={"noise_estimated": True, "dof": 10})
    assert of(quantities(written(found))["L1.x"], "coverageProbability") == "0.9266"  # of tables of t, 10 degrees


def test_a_stated_coverage_factor_is_kept() -> None:
    found = replace(net(), details={"L1.x": {"U": 0.0292, "k": 2.921, "probability": 0.99}})
    one = quantities(written(found))["L1.x"]
    stated = [of(one, name) for name in ("valueExpandedMU", "coverageFactor", "coverageProbability")]
    assert stated == ["0.029", "2.921", "0.99"]


def test_the_main_table_has_a_list_for_each_column() -> None:
    found = net()
    points = found.tables["points"]
    sx = np.array([1e-3, np.inf, 2e-3])
    names = np.array(["A 1", "B", ""])
    columns = {**points.columns, "sx": sx, "point": names}
    root = written(replace(found, tables={"points": replace(points, columns=columns)}))
    held = quantities(root)
    assert held["point"].findtext("d:charsXMLList", "", NAMES).split() == ["A_1", "-"]
    assert of(held["x"], "valueXMLList") == "0.0000 0.0000" and of(held["y"], "valueXMLList") == "0.0000 200.0000"
    assert (
        of(held["x"], "valueExpandedMUXMLList") == "0.0020 0.0040" and of(held["x"], "unitXMLList") == r"\milli\metre"
    )
    assert of(held["z"], "valueExpandedMUXMLList") == "0.0060 0.0060"
    assert "1 of 3 rows" in "".join(root.itertext())


def test_curves_of_errors_have_their_positions() -> None:
    root = written(results.machine())
    held = quantities(root)
    assert of(held["position"], "valueXMLList") == "0 100" and of(held["value"], "valueXMLList") == "0.0000 0.0200"
    assert of(held["value"], "valueExpandedMUXMLList") == "0.0000 0.0020"
    assert "tables/ECX" not in [one.text for one in root.iter("{https://ptb.de/dcc}content")]  # undetermined


def test_pixels_are_explained() -> None:
    one = quantities(written(results.camera(np.zeros((4, 2)), np.zeros((4, 2)))))["f"]
    assert of(one, "unit") == r"\one" and one.findtext(".//d:nonSIUnit", "", NAMES) == "px"


def test_what_is_not_determined_is_named_and_not_certified() -> None:
    found = replace(net(), estimates=(Estimate("a", 1.0, 0.1, "mm"), Estimate("b", 1.0, np.inf, "mm")))
    root = written(found)
    assert "b" not in quantities(root) and "Not determined, so not certified: b." in "".join(root.itertext())


def test_traceability_states_every_reference() -> None:
    lines = [one.text for one in written(net()).iter("{https://ptb.de/dcc}content")]
    assert f"data/a.csv: certificate PTB-1234; SHA-256 {'ab' * 32}" in lines
    assert f"data/b.csv: certificate not given; SHA-256 {'cd' * 32}" in lines
    assert "gauge block: certificate NPL-5" in lines


def test_texts_stay_texts_and_bytes_are_the_same() -> None:
    found = replace(net(), title=EVIL, warnings=(EVIL,), estimates=(Estimate(EVIL, 1.0, 0.1, "mm"),))
    record = replace(RECORD, certificate={**CERTIFICATE, "person": EVIL, "references": {EVIL: EVIL}})
    root = written(found, record)
    safe = EVIL.replace("\x01", "\N{REPLACEMENT CHARACTER}")
    assert [one.text for one in root.iter("{https://ptb.de/dcc}content")].count(safe) >= 5
    assert export("dcc", found, record) == export("dcc", found, record) and violations(root) == []


def test_all_that_is_missing_is_listed_at_once() -> None:
    stated = {"number": "1", "item": {"name": "x"}, "references": {"data/z.csv": "1"}}
    found = replace(net(), estimates=(Estimate("p", 1.0, 0.1, "bar"),))
    with pytest.raises(InputError) as error:
        export("dcc", found, replace(RECORD, certificate=stated))
    assert len(error.value.faults) == 10 + 1 + 1
    text = str(error.value)
    assert "item: serial is missing" in text and "number is missing" not in text
    assert "data/z.csv is no input" in text and "data/a.csv, data/b.csv" in text and "the unit bar" in text


@pytest.mark.parametrize(
    ("unit", "notation"),
    [
        ("mm", r"\milli\metre"), ("m", r"\metre"), ("um", r"\micro\metre"), ("rad", r"\radian"), ("1", r"\one"),
        ("um/m", r"\micro\metre\metre\tothe{-1}"), ("1/K", r"\kelvin\tothe{-1}"), ("px", r"\one"), ("kg", r"\kilogram"),
        ("um/m/K", r"\micro\metre\metre\tothe{-1}\kelvin\tothe{-1}"), ("mm/min", r"\milli\metre\minute\tothe{-1}"),
        ("hPa", r"\hecto\pascal"), ("degC", r"\degreecelsius"), ("px/s", r"\second\tothe{-1}"), ("mm2", r"\milli\metre\tothe{2}"),
        ("kg mm-1 s-2", r"\kilogram\milli\metre\tothe{-1}\second\tothe{-2}"), ("arcsec", r"\arcsecond"), ("furlong", None),
    ],
)  # fmt: skip
def test_units_in_the_notation_of_d_si(unit: str, notation: str | None) -> None:
    assert dsi.unit_of(unit) == notation


JOB = """\
metrocli: 1
job: report-uncertainty
quantities: {a: {value: 10 mm, U: 2 um, k: 2}}
measurands: {l: {model: 2*a, unit: mm}}
output: l.h5
"""
STATED = """\
certificate:
  number: 1
  laboratory: {name: L, city: B, country: DE}
  customer: {name: C, city: Leeds}
  item: {name: Gauge, serial: "007"}
  person: P
  begin: 2026-11-02
  end: 2026-11-03
  issued: 2026-11-05
  references: {a: NPL-5}
"""


def test_from_a_job(metrocli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("l.yaml").write_text(JOB, encoding="utf-8")
    assert metrocli("report-uncertainty", "l.yaml").code == 0
    refused = metrocli("export", "l.h5", "--to", "dcc")
    assert refused.code == 3 and refused.err.count("is missing") == 12 and not Path("l.dcc.xml").exists()
    Path("l.yaml").write_text(JOB + STATED, encoding="utf-8")
    assert metrocli("report-uncertainty", "l.yaml").code == 0
    assert metrocli("export", "l.h5", "--to", "dcc").code == 0
    root = ET.fromstring(Path("l.dcc.xml").read_bytes())
    assert violations(root) == []
    assert root.findtext(".//d:items//d:value", "", NAMES) == "007"
    held = quantities(root)["l"]
    assert (of(held, "value"), of(held, "valueExpandedMU"), of(held, "unit")) == ("20.0000", "0.0039", r"\milli\metre")
    assert metrocli("report", "l.h5").code == 0
    assert "a: certificate NPL-5" in Path("l.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("end: 2026-11-03", "end: 2026-11-01", "2026-11-01 is before begin: 2026-11-02"),
        ("begin: 2026-11-02", "begin: 2026-02-30", "a date such as 2026-11-20"),
        ("country: DE", "country: Germany", "two capital letters"),
        ("person: P", "persons: P", "did you mean 'person'"),
        ("person: P", 'person: "a\\x07"', "a text of one line"),
    ],
)
def test_faults_in_a_job(metrocli: Callable[..., Any], tmp_path: Path, before: str, after: str, words: str) -> None:
    path = tmp_path / "l.yaml"
    text = JOB + STATED.replace(before, after)
    path.write_text(text, encoding="utf-8")
    found = metrocli("report-uncertainty", path)
    line = text[: text.index(after)].count("\n") + 1
    assert found.code == 3 and words in found.err and f"l.yaml:{line}:" in found.err
