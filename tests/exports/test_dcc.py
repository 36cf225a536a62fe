"""The Digital Calibration Certificate: its elements are those of the schema, its numbers those of the result."""

from __future__ import annotations

import json
import os
import re
import warnings
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
from metrocli.exports import dcc_elements as dsi
from metrocli.exports import export
from metrocli.record import CriterionVerdict, InputFile, Record
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table

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
    "2026-11-20T10:00:00Z", (CriterionVerdict("sigma0", "< 1.5", 1.0, "", True),), job_file="../jobs/a.yaml",
    certificate=CERTIFICATE,
)  # fmt: skip
NAMES = {"d": "https://ptb.de/dcc", "s": "https://ptb.de/si"}
CONTACT = "name eMail? phone? fax? link? location descriptionData?"
REMARK = (
    "name? description? countryCodeISO3166_1* convention? traceable? norm* reference* link* declaration? "
    "(valid|validXMLList)? date? period? respAuthority? (conformity|conformityXMLList)? data? nonSIDefinition? "
    "nonSIUnit? location?"
)
METHODS = "usedMethods? usedSoftware? measuringEquipments? influenceConditions?"
SCHEMA = {  # sequences of dcc.xsd 3.3.0 and of SI_Format.xsd 2.2.1: ? is optional, + one or more, * any number
    "digitalCalibrationCertificate": "administrativeData measurementResults comment? document? Signature*",
    "administrativeData": "dccSoftware refTypeDefinitions? coreData items calibrationLaboratory respPersons customer statements?",
    "dccSoftware": "software+", "software": "name release type? description?",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1+ mandatoryLangCodeISO639_1+ uniqueIdentifier identifications? receiptDate? beginPerformanceDate endPerformanceDate performanceLocation issueDate? reportAmendedSubstituted? previousReport?",
    "identifications": "identification+", "identification": "issuer value name?",
    "items": "name? equipmentClass* description? owner? manufacturer? identifications? item+",
    "item": "name equipmentClass* description? owner? installedSoftwares? manufacturer? model? identifications itemQuantities? subItems?",
    "manufacturer": CONTACT.replace("location", "location?"), "person": CONTACT.replace("location", "location?"),
    "contact": CONTACT, "customer": CONTACT,
    "calibrationLaboratory": "calibrationLaboratoryCode? contact cryptElectronicSeal? cryptElectronicSignature? cryptElectronicTimeStamp?",
    "location": "(city|countryCode|postCode|postOfficeBox|state|street|streetNo|further|positionCoordinates)+",
    "respPersons": "respPerson+",
    "respPerson": "person description? role? mainSigner? cryptElectronicSeal? cryptElectronicSignature? cryptElectronicTimeStamp?",
    "statements": "statement+", "statement": REMARK,
    "measurementResults": f"{METHODS} measurementMetaData? measurementResult+",
    "measuringEquipments": "name? equipmentClass* description? owner? identifications? measuringEquipment+",
    "measuringEquipment": "name equipmentClass* description? certificate? manufacturer? model? identifications? measuringEquipmentQuantities? installedSoftware?",
    "certificate": "referral referralID procedure value description? inValidityRange? traceable? linkedReport?",
    "measurementResult": f"name description? {METHODS} results measurementMetaData?",
    "usedMethods": "usedMethod+", "usedMethod": "name description? norm* reference* link* usedMethodQuantities?",
    "usedSoftware": "software+", "influenceConditions": "influenceCondition+",
    "influenceCondition": "name description? status? certificate? data",
    "results": "result+", "result": "name description? data",
    "list": f"name? description? (dateTime|dateTimeXMLList)? (list|quantity)+ {METHODS} measurementMetaData?",
    "quantity": f"name? description? (noQuantity|charsXMLList|real|realListXMLList) relativeUncertainty? {METHODS} measurementMetaData?",
    "measurementMetaData": "metaData+", "metaData": REMARK,
    **dict.fromkeys(("name", "referral"), "content+"), **dict.fromkeys(("description", "declaration", "text"), "name? content*"),
    "data": "(text|formula|byteData|xml|quantity|list)+",
    "real": "label? quantityTypeQUDT? value unit significantDigit? dateTime? measurementUncertaintyUnivariate?",
    "measurementUncertaintyUnivariate": "(standardMU|expandedMU|coverageIntervalMU)",
    "standardMU": "valueStandardMU distribution?",
    "expandedMU": "valueExpandedMU coverageFactor coverageProbability distribution?",
    "realListXMLList": "labelXMLList? quantityTypeQUDTXMLList? valueXMLList unitXMLList significantDigitXMLList? dateTimeXMLList? measurementUncertaintyUnivariateXMLList? measurementUncertaintyMultivariateXMLList?",
    "measurementUncertaintyUnivariateXMLList": "expandedMUXMLList",
    "expandedMUXMLList": "valueExpandedMUXMLList coverageFactorXMLList coverageProbabilityXMLList distributionXMLList?",
}  # fmt: skip
VALUE = "{https://ptb.de/si}value"
LINE = r"[^\s]+(\s+[^\s]+)*"
"""notEmptyStringType of the schema"""
POSITIVE = r"\+?([0-9]*\.[0-9]+|[0-9]+\.[0-9]*|[0-9]+)([eE][-+]?[0-9]+)?"
DECIMAL = rf"-?{POSITIVE}"
TEXTS = {
    "issuer": "manufacturer|calibrationLaboratory|customer|owner|other", "mainSigner": "true|false",
    "countryCode": "[A-Z]{2}", "countryCodeISO3166_1": "[A-Z]{2}", "usedLangCodeISO639_1": "[a-z]{2}",
    "mandatoryLangCodeISO639_1": "[a-z]{2}",
    "performanceLocation": "laboratory|customer|laboratoryBranch|customerBranch|other", "type": "application",
    "conformity": "pass|fail|conditionalPass|conditionalFail|noPass|noFail",
    **dict.fromkeys(
        ("value", "uniqueIdentifier", "nonSIUnit", "nonSIDefinition", "model", "calibrationLaboratoryCode", "eMail",
         "street", "postCode", "city", "norm", "referralID", "procedure"), LINE,
    ),
    "release": r"[a-zA-Z] ?([0-9]{1,3}\.){0,3}[0-9]{1,3}",  # PTB's Schematron rules
    **dict.fromkeys(("receiptDate", "beginPerformanceDate", "endPerformanceDate", "issueDate"), r"\d{4}-\d\d-\d\d"),
    **dict.fromkeys(("valueExpandedMU", "valueStandardMU"), POSITIVE),
    **dict.fromkeys(("coverageFactor", "coverageFactorXMLList"), r"\+?[1-9][0-9]*(\.[0-9]*)?"),
    **dict.fromkeys(("coverageProbability", "coverageProbabilityXMLList"), r"\+?(0(\.[0-9]*)?|1(\.0*)?)"),
    "valueXMLList": rf"{DECIMAL}( {DECIMAL})*", "valueExpandedMUXMLList": rf"{POSITIVE}( {POSITIVE})*",
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
        elif not re.fullmatch(DECIMAL if one.tag == VALUE else TEXTS.get(name, r"[\s\S]+"), one.text or ""):
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


def camera(**columns: np.ndarray) -> Result:
    return results.camera(np.zeros((4, 2)), np.zeros((4, 2)), **columns)


def extreme() -> Result:
    """Estimates of all sizes, exact ones and ones without correlation, coverage of all sizes, and decisions."""
    sizes = (1e-20, 1e-9, 1.0, 1e9, 1e20)
    estimates = [Estimate(f"v{k} {unit}", value, 0.1 * abs(value), unit) for k, value in enumerate((*sizes, -3.0, 0.0)) for unit in ("mm", "1/K", "px")]  # fmt: skip
    coverage = ((0.5, 0.38), (1.0, 0.6827), (1e5, 1 - 1e-9), (63.66, 1.0), (2.0, 1e-7), (19.99999, 0.5))
    details: dict[str, dict[str, Any]] = {
        one.name: {"U": k * one.std, "k": k, "probability": p} for one, (k, p) in zip(estimates, coverage, strict=False)
    }
    limits = {"limits": [-np.inf, 2e-20], "acceptance": [], "zone": "undecided"}
    details[estimates[0].name]["tolerance"] = limits
    details[estimates[1].name]["tolerance"] = {"T": 1.0, "acceptance": 0.5}  # of a volume: no limits
    details[estimates[1].name] |= {"gum_valid": False, "mc": {"covered": 1.0, "trials": 10000}}
    covariance = np.diag([one.std**2 for one in estimates])
    size = 10.0 ** np.arange(-20, 21, 10)
    table = Table(
        {"name": np.array([EVIL] * 5), "x": -size, "sx": 0.1 * size, "y": size, "sy": np.zeros(5)}, {"x": "mm"}
    )
    return Result(
        "fit-part", EVIL, tuple(estimates), covariance, {}, {"surfaces": table}, shown=(ShownTable("surfaces"),),
        details=details, warnings=("one", EVIL), doubts=(EVIL, "two"),
    )  # fmt: skip


ALL = {
    "net": net(), "machine": results.machine(), "camera": camera(), "budget": results.budget(), "extreme": extreme(),
}  # fmt: skip
MINIMAL: dict[str, Any] = {
    "number": "1", "laboratory": {"name": "L", "city": "B", "country": "DE"}, "customer": {"name": "C", "city": "L"},
    "item": {"name": "G", "serial": "7"}, "person": "P", "begin": "2026-11-02", "end": "2026-11-02",
    "issued": "2026-11-02", "place": "laboratory",
}  # fmt: skip


def evil(stated: Any, key: str = "") -> Any:
    """A certificate whose texts are hostile, apart from those that the job reads more strictly."""
    if isinstance(stated, dict):
        return {name: evil(one, name) for name, one in stated.items()}
    return stated if key in ("received", "begin", "end", "issued", "country", "place") else EVIL


RECORDS = {
    "full": RECORD, "minimal": replace(RECORD, certificate=MINIMAL, inputs=(), verdicts=()),
    "evil": replace(RECORD, certificate=evil(CERTIFICATE)),
}  # fmt: skip
DATA = "METROCLI_DCC_SCHEMA"
"""The variable with the folder of dcc.xsd and of the files that it imports, which are not part of the project"""


@pytest.fixture(scope="module")
def schema() -> Any:
    if DATA not in os.environ:
        pytest.skip(f"{DATA} names no folder with PTB's dcc.xsd 3.3.0 and the files that it imports")
    xmlschema = pytest.importorskip("xmlschema", reason="pip install xmlschema")
    folder = Path(os.environ[DATA]).resolve()
    others = {ET.parse(path).getroot().get("targetNamespace"): path.as_uri() for path in folder.rglob("*.xsd")}
    return xmlschema.XMLSchema(folder / "dcc.xsd", locations=others, allow="local")


@pytest.mark.parametrize("stated", RECORDS)
@pytest.mark.parametrize("kind", ALL)
def test_the_elements_are_those_of_the_schema(kind: str, stated: str) -> None:
    root = written(ALL[kind], RECORDS[stated])
    assert violations(root) == []
    assert root.get("schemaVersion") == "3.3.0" and root.tag == "{https://ptb.de/dcc}digitalCalibrationCertificate"
    assert len(root.findall(".//d:measuringEquipment", NAMES)) == (0 if stated == "minimal" else 2)


@pytest.mark.parametrize("stated", RECORDS)
@pytest.mark.parametrize("kind", ALL)
def test_the_schema_of_ptb_itself(schema: Any, kind: str, stated: str) -> None:
    found = [f"{one.path}: {one.reason}" for one in schema.iter_errors(written(ALL[kind], RECORDS[stated]))]
    assert found == []


@pytest.mark.parametrize("kind", ALL)
def test_the_transcript_sees_what_the_schema_sees(schema: Any, kind: str) -> None:
    """An element that is left out, written twice or without its text."""
    root, random = written(ALL[kind]), np.random.default_rng(1)
    seen = 0
    for k in random.permutation(len(list(root.iter())))[:60]:
        for change in ("remove", "repeat", "spoil"):
            broken = deepcopy(root)
            one = list(broken.iter())[k]
            if change == "spoil" and not len(one):
                one.text = "\n"
            elif change != "spoil" and len(one):
                one.remove(one[0]) if change == "remove" else one.append(one[0])
            if not schema.is_valid(broken):
                assert violations(broken), f"{local(one)}: {change}"
                seen += 1
    assert seen > 40


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
    # One content for each language that the certificate uses, and names as the job states them in none
    assert {part.get("lang") for part in root.iterfind(".//d:content", NAMES)} == {"en", None}
    assert all(
        len(part.findall("d:content", NAMES)) == 1
        for part in root.iter()
        if len(part) and part.tag != root.tag and part[0].tag.endswith("}content")
    )
    assert list(quantities(written(net()))).count("lowest") == 0


@pytest.mark.parametrize("stated", RECORDS)
@pytest.mark.parametrize("kind", ALL)
def test_the_schematron_rules_of_ptb_themselves(kind: str, stated: str) -> None:
    """The rules as the package has them compiled, and those of its later dcc.sch."""
    rules = pytest.importorskip(
        "dcclib.validation.schematron", reason="dcclib is not installed: pip install dcclib==0.4.0"
    )
    later = files("dcclib.validation") / "schema" / "dcc.sch"
    text = str(export("dcc", ALL[kind], RECORDS[stated])["dcc.xml"])
    for validator in (rules.SchematronValidator.for_dcc(), rules.SchematronValidator.from_file(str(later))):
        found = validator.validate_str(text)
        both = [*found.failed_assertions, *found.successful_reports]
        assert [vars(one) for one in both if one.role in ("error", "warning")] == []


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


def stating(k: float, probability: float = 0.5) -> ET.Element:
    """The quantity of a value of 1 mm with U = 0.01 mm and a k."""
    one = Estimate("a", 1.0, 0.01 / k, "mm")
    found = replace(net(), estimates=(one,), details={"a": {"U": 0.01, "k": k, "probability": probability}})
    return quantities(written(found))["a"]


def test_a_coverage_factor_below_one_is_none() -> None:
    """D-SI allows no such factor: valueStandardMU is u = U/k = 0.01 mm / 0.5."""
    one = stating(0.5)
    assert (of(one, "value"), of(one, "valueStandardMU")) == ("1.000", "0.020")
    assert one.find(".//s:expandedMU", NAMES) is None and stating(1.0).find(".//s:expandedMU", NAMES) is not None


@pytest.mark.parametrize(
    ("probability", "text"),
    [(0.95, "0.95"), (0.9545, "0.9545"), (1 - 2e-9, "0.999999998"), (1 - 4e-5, "0.99996"), (1.0, "1"), (3e-7, "0.0000003"), (0.5, "0.5")],
)  # fmt: skip
def test_a_coverage_probability_is_one_only_if_it_is(probability: float, text: str) -> None:
    assert of(stating(2.0, probability), "coverageProbability") == text


def test_a_coverage_that_monte_carlo_contradicts_is_that_of_the_trials() -> None:
    one = Estimate("a", 1.0, 0.005, "mm")
    for valid, text in ((False, "0.9880"), (True, "0.9545"), (np.nan, "0.9545")):
        stated = {"U": 0.01, "k": 2.0, "probability": 0.9545, "gum_valid": valid}
        stated |= {"mc": {"covered": 0.98799, "trials": 1_000_000}}
        found = quantities(written(replace(net(), estimates=(one,), details={"a": stated})))["a"]
        assert float(of(found, "coverageProbability")) == pytest.approx(float(text), abs=2e-5)
        said = "".join(found.itertext())
        assert ("share of 1000000 Monte Carlo trials within U" in said and "95.45 %" in said) == (valid is False)


@pytest.mark.parametrize(("k", "text"), [(12.7062, "12.71"), (63656.7, "63660"), (1.0001, "1")])
def test_a_coverage_factor_has_no_exponent(k: float, text: str) -> None:
    assert of(stating(k), "coverageFactor") == text


@pytest.mark.parametrize(
    ("zone", "value", "conformity"),
    [("conforming", 50.0, "pass"), ("non-conforming", 50.2, "fail"),
     ("undecided", 50.0009, "conditionalPass"), ("undecided", 50.0011, "conditionalFail")],
)  # fmt: skip
def test_a_decision_about_a_tolerance_is_stated_with_its_limits(zone: str, value: float, conformity: str) -> None:
    found = results.budget()
    details = {"l": {**found.details["l"], "tolerance": {**found.details["l"]["tolerance"], "zone": zone}}}
    root = written(replace(found, estimates=(replace(found.estimates[0], value=value),), details=details))
    decided = root.find(".//d:metaData[@refType='basic_conformity']", NAMES)
    assert decided is not None and decided.findtext("d:conformity", "", NAMES) == conformity
    limits = {one.get("refType", ""): float(of(one, "value")) for one in decided.iterfind("d:data/d:quantity", NAMES)}
    assert limits == {
        "basic_toleranceLimitLower": 49.999, "basic_toleranceLimitUpper": 50.001,
        "basic_acceptanceLimitLower": 49.9992, "basic_acceptanceLimitUpper": 50.0008,
    }  # fmt: skip


def test_estimates_that_correlate_have_their_coefficients() -> None:
    """-0.036 / (0.1 * 0.4) = -0.9 for cx and cy of the camera, 0.01 / (0.2 * 0.1) = 0.5 for f and cx."""
    held = quantities(written(camera()))
    assert held["estimate"].findtext("d:charsXMLList", "", NAMES) == "f cx cy"
    columns = [
        [float(one) for one in of(held[f"correlation with {name}"], "valueXMLList").split()]
        for name in ("f", "cx", "cy")
    ]
    np.testing.assert_allclose(columns, [[1, 0.5, 0], [0.5, 1, -0.9], [0, -0.9, 1]], atol=1e-9)
    found = camera()
    alone = replace(found, covariance=np.diag(np.diag(found.covariance)))
    assert "Correlation" not in "".join(written(alone).itertext())


def test_correlations_of_estimates_that_are_not_determined_are_left_out() -> None:
    found = camera()
    covariance = found.covariance.copy()
    covariance[0], covariance[:, 0] = np.nan, np.nan
    estimates = (replace(found.estimates[0], std=np.inf), *found.estimates[1:])
    held = quantities(written(replace(found, covariance=covariance, estimates=estimates)))
    assert held["estimate"].findtext("d:charsXMLList", "", NAMES) == "cx cy"
    assert of(held["correlation with cx"], "valueXMLList") == "1 -0.9"


def test_many_estimates_are_certified_without_their_correlation() -> None:
    many = tuple(Estimate(f"p{k}", 0.0, 1.0, "mm") for k in range(101))
    root = written(replace(net(), estimates=many, covariance=np.full((101, 101), 0.5) + 0.5 * np.eye(101)))
    assert "correlation of the 101 estimates" in "".join(root.itertext()) and "estimate" not in quantities(root)


def test_small_uncertainties_of_a_table_keep_their_digits() -> None:
    found = net()
    points = found.tables["points"]
    spreads = np.array([1e-20, 2e-20, 4e-19])
    columns = {**points.columns, "x": np.array([1e-18, -1e-25, 3.0]), "sx": spreads}
    one = quantities(written(replace(found, tables={"points": replace(points, columns=columns)})))["x"]
    stated = [float(part) for part in of(one, "valueExpandedMUXMLList").split()]
    np.testing.assert_allclose(stated, 2 * spreads, rtol=0.05)
    np.testing.assert_allclose(float(of(one, "valueXMLList").split()[0]), 1e-18)


def test_what_kind_a_quantity_is_can_be_read_by_programs() -> None:
    """refTypes of DKD's database, and those by which PTB's dccQuantities finds a table and its index."""
    root = written(results.machine())
    assert {one.get("refType") for one in root.iterfind(".//d:list", NAMES)} == {"basic_1IndexTable"}
    held = quantities(root)
    kinds = [held[name].get("refType") for name in ("position", "value", "C0Y")]
    assert kinds == ["basic_tableIndex0", "basic_measuredValue", "basic_measuredValue"]
    assert [one.get("refType") for one in root.iterfind(".//d:item//d:identification", NAMES)] == [
        "basic_serialNumber", "basic_identificationNumber",
    ]  # fmt: skip


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
    assert "\n".join([
        "The result rests on these references.",
        f"data/a.csv: certificate PTB-1234; SHA-256 {'ab' * 32}",
        f"data/b.csv: certificate not given; SHA-256 {'cd' * 32}",
        "gauge block: certificate NPL-5",
    ]) in lines  # fmt: skip
    stated = {
        one.findtext("d:name/d:content", "", NAMES): one.findtext("d:certificate/d:referralID", "", NAMES)
        for one in written(net()).iterfind(".//d:measuringEquipment", NAMES)
    }
    assert stated == {"data/a.csv": "PTB-1234", "gauge block": "NPL-5"}


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
    assert "data/z.csv is not an input" in text and "data/a.csv, data/b.csv" in text and "the unit bar" in text


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


def test_every_unit_is_one_of_d_si() -> None:
    """PTB's parser of units knows each name and prefix that a unit of a certificate can have."""
    parser = pytest.importorskip("dsi_unit", reason="pip install dsiUnits==3.1.3")
    whole = [f"{prefix}{unit}" for unit in dsi._UNITS for prefix in ("", *dsi._PREFIXES)] + [
        *dsi._WHOLE,
        "um/m/K",
        "px",
    ]
    for unit in whole:
        notation = str(dsi.unit_of(unit))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of a token that no unit here has
            assert parser.DsiUnit(notation).valid, notation


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
    Path("l.yaml").write_text(JOB.replace("l.h5", "results/l.h5"), encoding="utf-8")
    assert metrocli("report-uncertainty", "l.yaml").code == 0
    refused = metrocli("export", "results/l.h5", "--to", "dcc")
    assert refused.code == 3 and refused.err.count("is missing") == 12 and not Path("results/l.dcc.xml").exists()
    assert "is missing in the job l.yaml" in refused.err, "from the working folder, not from that of the result"
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
