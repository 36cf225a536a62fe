"""The JSON schema that editors use says the same as the loader."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from metrocli.errors import InputError
from metrocli.nodes import Node
from metrocli.project import job as jobs
from metrocli.project import yaml_text

HEAD = "metrocli: 1\njob: straight-line\n"
GOOD = HEAD + "inputs: {readings: readings.csv}\nnoise: 0.1 mm\n"
ACCEPTED = [
    GOOD,
    GOOD.replace("0.1 mm", "estimated"),
    GOOD.replace("0.1 mm", "0.1 µm"),
    GOOD + "title: 12\n",
    GOOD + "title: true\n",
    GOOD + "alpha: 11.5e-6 1/K\n",
    GOOD + "weight: 1e-3\niterations: 50\n",
    GOOD + "estimate: [offset]\n",
    GOOD + "limits: {range: [1 mm, 0.2 m], robust: true}\n",
    GOOD + "labels: {a: first, b: 012}\n",
    GOOD + "require: {sigma0: '< 1.5', offset.std: ['> 1 um', '< 3 um']}\noutput: a/b.h5\neffects: []\n",
]
REFUSED = [
    GOOD.replace("metrocli: 1", "metrocli: 2"),
    GOOD.replace("job: straight-line", "job: curved-line"),
    GOOD.replace("0.1 mm", "0.1"),
    GOOD.replace("0.1 mm", "0,1 mm"),
    GOOD.replace("0.1 mm", "5 Mm"),
    GOOD.replace("0.1 mm", "estimate"),
    HEAD + "noise: 0.1 mm\n",
    HEAD + "inputs: {readings: readings.csv, reading: x}\nnoise: 0.1 mm\n",
    GOOD + "tolerance: 1 mm\n",
    GOOD + "alpha: 1e-6\n",
    GOOD + "weight: 0\n",
    GOOD + "weight: heavy\n",
    GOOD + "iterations: 51\n",
    GOOD + "iterations: 2.5\n",
    GOOD + "estimate: slope\n",
    GOOD + "estimate: [slop]\n",
    GOOD + "estimate: [slope, slope]\n",
    GOOD + "limits: {range: [1 mm]}\n",
    GOOD + "limits: {range: [1 mm, 2 mm], robust: maybe}\n",
    GOOD + "labels: [a]\n",
    GOOD + "title: {a: b}\n",
    GOOD + "require: {sigma0: 1.5}\n",
    GOOD + "output: x.csv\n",
    GOOD + "effects: [{name: bend}]\n",
    GOOD + "effects: [bend]\n",
]


def as_editors_see(node: Node) -> Any:
    """Return a node as YAML 1.2 types it, which is what an editor checks."""
    if node.kind == "mapping":
        return {key.text: as_editors_see(value) for key, value in node.entries}
    if node.kind == "list":
        return [as_editors_see(item) for item in node.items]
    if node.quoted:
        return node.text
    if node.text in ("true", "false", "null", ""):
        return {"true": True, "false": False}.get(node.text)
    if re.fullmatch(r"[-+]?[0-9]+", node.text):
        return int(node.text)
    number = re.fullmatch(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", node.text)
    return float(node.text) if number else node.text


def accepted_by_schema(text: str) -> bool:
    document = as_editors_see(yaml_text.parse(text, "job.yaml", Path()))
    return jsonschema.Draft202012Validator(jobs.schema("straight-line")).is_valid(document)


def accepted_by_loader(text: str, path: Path) -> bool:
    path.write_text(text)
    try:
        return jobs.load(path).kind == "straight-line"
    except InputError:
        return False


def test_the_schema_is_one(straight_line: str, metrocli: Callable[..., Any]) -> None:
    ran = metrocli("schema", straight_line)
    jsonschema.Draft202012Validator.check_schema(json.loads(ran.out))


@pytest.mark.parametrize("text", ACCEPTED)
def test_both_accept(text: str, job: Path) -> None:
    assert accepted_by_loader(text, job)
    assert accepted_by_schema(text)


@pytest.mark.parametrize("text", REFUSED)
def test_both_refuse(text: str, job: Path) -> None:
    assert not accepted_by_schema(text)
    assert not accepted_by_loader(text, job)


def test_every_key_is_described(straight_line: str) -> None:
    schema = jobs.schema("straight-line")
    assert all(value["description"] for value in schema["properties"].values())
