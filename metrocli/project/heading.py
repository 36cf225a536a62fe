"""The keys that every kind of job has."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrocli import tasks
from metrocli.effects.covariates import StatedCorrelation
from metrocli.effects.own.definition import Definition
from metrocli.effects.variance_groups import StatedVariance
from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.project.campaign import ForEach
from metrocli.project.ranges import Ranges
from metrocli.project.requirements import Requirement, Requirements
from metrocli.settings import BAD, Choice, ListOf, Schema, Section, Text, path_beside, setting
from metrocli.settings.certificate import Certificate
from metrocli.settings.values import OfText
from metrocli.words import suggestion

FORMAT_VERSION = "1"


class _Version:
    """The value of `metrocli:`, the version of the format of job files."""

    expects = FORMAT_VERSION

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node) and node.text == FORMAT_VERSION:
            return int(node.text)
        faults.append(
            node.fault(
                f"metrocli: this program reads job files of version {FORMAT_VERSION} only",
                f"write metrocli: {FORMAT_VERSION}",
            )
        )
        return BAD

    def schema(self) -> Schema:
        return {"const": int(FORMAT_VERSION)}


class _KindOfJob:
    """The value of `job:`, one of the kinds in the table `tasks.KINDS`."""

    @property
    def expects(self) -> str:
        return f"one of: {', '.join(tasks.KINDS)}"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node) and node.text in tasks.KINDS:
            return node.text
        faults.append(node.fault(f"unknown kind of job '{node.text}'", suggestion(node.text, tasks.KINDS)))
        return BAD

    def schema(self) -> Schema:
        return {"enum": list(tasks.KINDS)}


class _Effects:
    """The value of `effects:`, a list of mappings whose keys depend on the kind of job."""

    expects = "a list such as [{name: target-eccentricity}]"

    def fits(self, node: Node) -> bool:
        return node.kind == "list"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node):
            return node.items
        faults.append(node.fault("effects: this is not a list", f"expected {self.expects}"))
        return BAD

    def schema(self) -> Schema:
        return {"type": "array"}


class _Definitions:
    """The value of `define:`, a list of user-defined effects (`metrocli.effects.own`)."""

    expects = "a list such as [{name: range-zero, acts_on: length, adds: r0, parameters: {...}}]"

    def fits(self, node: Node) -> bool:
        return node.kind == "list"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node):
            return node.items
        faults.append(node.fault("define: this is not a list", f"expected {self.expects}"))
        return BAD

    def schema(self) -> Schema:
        return {"type": "array", "items": Section(Definition).schema()}


class FileBeside(OfText):
    """The path of a file, relative to the file that names it; read as its node, which has both."""

    expects = "the path of a file"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node) and "\0" not in node.text:
            return node
        faults.append(node.fault(f"{node.path}: this is not the path of a file", f"expected {self.expects}"))
        return BAD

    def schema(self) -> Schema:
        return {"type": "string"}


class _Output(OfText):
    """The value of `output:`, the path of the result file."""

    expects = "the path of a file that ends in .h5"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node) and node.text.endswith(".h5") and "\0" not in node.text:
            return path_beside(node)
        faults.append(node.fault(f"output: '{node.text}' is not the name of a result file", f"expected {self.expects}"))
        return BAD

    def schema(self) -> Schema:
        return {"type": "string", "pattern": "\\.h5$"}


@dataclass(frozen=True)
class Heading:
    """The keys that every kind of job has."""

    metrocli: int = setting(_Version(), "version of the format of job files")
    job: str = setting(_KindOfJob(), "kind of job")
    title: str = setting(Text(), "title of the result", default="")
    effects: tuple[Node, ...] = setting(_Effects(), "extensions of the model, by name", default=())
    correlated: tuple[StatedCorrelation, ...] = setting(
        ListOf(Section(StatedCorrelation)), "errors of the readings that vary smoothly with a covariate", default=()
    )
    variance_groups: tuple[StatedVariance, ...] = setting(
        ListOf(Section(StatedVariance)), "places whose readings are noisier, or less noisy, than declared", default=()
    )
    define: tuple[Node, ...] = setting(_Definitions(), "user-defined effects", default=())
    effects_from: Node | None = setting(FileBeside(), "file with user-defined effects under `define:`", default=None)
    ranges: Mapping[str, Node] = setting(Ranges(), "largest values of columns in CSV files, by name", default={})
    require: tuple[Requirement, ...] = setting(Requirements(), "acceptance criteria", default=())
    conformity: str = setting(
        Choice("decide", "report"),
        "whether a tolerance that is not met ends the job with exit code 6, or is only reported",
        default="decide",
    )
    parts: Node | None = setting(ForEach(), "one result for each part of a list", default=None, key="for")
    certificate: Certificate | None = setting(
        Section(Certificate), "laboratory, customer, item: what a certificate states", default=None
    )
    output: Path | None = setting(_Output(), "result file, relative to the job file", default=None)
