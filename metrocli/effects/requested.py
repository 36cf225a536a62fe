"""Effects as a job or the command line names them: `{name: dead-path-drift, tracer: LT2, rate: 0.5 um/min}`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from metrocli.effects.covariates import Covariates, StatedCorrelation
from metrocli.effects.effect import Effect
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import BAD, Choice, Schema, Text
from metrocli.words import in_a_row, suggestion


@dataclass(frozen=True)
class PlaceName:
    """Setting that names a place; a list, such as the indices of a ball [1, 0, -2], is read as the name '1 0 -2'."""

    expects = "the name of a place"

    def fits(self, node: Node) -> bool:
        return Text().fits(node) or (bool(node.items) and all(Text().fits(item) for item in node.items))

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return (
            " ".join(item.text for item in node.items) if node.items and self.fits(node) else Text().read(node, faults)
        )

    def schema(self) -> Schema:
        return {"anyOf": [Text().schema(), {"type": "array", "items": Text().schema(), "minItems": 1}]}


@dataclass(frozen=True)
class RequestedEffect:
    """An effect to add to a model: parameters with a value are applied, the others are estimated."""

    forms: tuple[Effect, ...]
    """Entries of the table that agree with the keys given; the first one that the data allow is used"""
    where: Mapping[str, str]
    values: Mapping[str, float | str]
    """Given parameters, by name: numbers in internal units, or names of places"""
    node: Node
    """Its position in the job file or command line, for messages"""
    std: float = 0.0
    """Standard deviation of the parameters at all places of its kind; 0 if it acts at one place"""
    correlation: tuple[StatedCorrelation, Covariates] | None = None
    """For a correlated error, which is not an entry of the table: what the job states, and the covariates"""
    variance_ratio: float = 0.0
    """For a variance group, which is not in the table either: ratio of its standard deviations to the declared"""

    @property
    def name(self) -> str:
        """The name of the effect."""
        return self.forms[0].name

    @property
    def key(self) -> str:
        """The key of the job under which it stands."""
        return "variance_groups" if self.variance_ratio else "effects" if self.correlation is None else "correlated"

    @property
    def is_in_table(self) -> bool:
        """Whether it is an effect: a correlated error and a variance group change the noise alone."""
        return self.correlation is None and not self.variance_ratio

    def same_as(self, other: RequestedEffect) -> bool:
        """Whether another one is a duplicate: same name, place, forms and values.

        An effect with a given value and one that is estimated in addition to it are not duplicates.
        """
        alike = [form.by for form in self.forms] == [form.by for form in other.forms]
        return alike and (self.name, self.where, self.values, self.std) == (
            other.name,
            other.where,
            other.values,
            other.std,
        )


def keys_of(requests: Iterable[RequestedEffect]) -> str:
    """Return the keys of the job under which some effects stand, in words: `effects` and `variance_groups`."""
    return in_a_row(list(dict.fromkeys(f"`{request.key}`" for request in requests)))


def read(table: Sequence[Effect], nodes: Sequence[Node], faults: list[Fault]) -> tuple[RequestedEffect, ...]:
    """Return the effects that the nodes name; append to `faults` each wrong name, key or value."""
    entries = (_read(table, node, faults) for node in nodes)
    requests = tuple(request for request in entries if request is not None)
    for number, request in enumerate(requests):
        if any(request.same_as(other) for other in requests[:number]):
            faults.append(request.node.fault(f"{request.name} is listed twice", "leave one of them out"))
    return requests


def names_of(nodes: Iterable[Node]) -> frozenset[str]:
    """Return the names of the effects that the nodes name, known or not."""
    return frozenset(name.text for node in nodes if (name := node.get("name")) is not None)


def _read(table: Sequence[Effect], node: Node, faults: list[Fault]) -> RequestedEffect | None:
    name = node.get("name")
    if name is None or name.kind != "scalar":
        faults.append(node.fault(f"{node.path}: an effect needs a name", "write {name: ..., ...}"))
        return None
    known = [effect for effect in table if effect.name == name.text]
    if not known:
        names = dict.fromkeys(effect.name for effect in table)
        hint = suggestion(name.text, names) if names else "no effects are known for this kind of job"
        faults.append(name.fault(f"unknown effect '{name.text}'", hint))
        return None
    if node.get("std") is not None and any(effect.common for effect in known):
        return _at_all_places([effect for effect in known if effect.common], node, faults)
    attempts = [(effect, _as(effect, node)) for effect in known]
    fitting = [(effect, values) for effect, (values, wrong) in attempts if not wrong]
    if not fitting:
        fewest: list[Fault] = min((wrong for _, (_, wrong) in attempts), key=len)
        faults.extend(fewest)
        return None
    where = {key: fitting[0][1].pop(key) for key in fitting[0][0].where if key != "by"}
    return RequestedEffect(tuple(effect for effect, _ in fitting), where, fitting[0][1], node)


def _at_all_places(forms: Sequence[Effect], node: Node, faults: list[Fault]) -> RequestedEffect | None:
    """Return an effect with sizes of its own at every place: {name, std}."""
    spec = forms[0].common
    for written, _ in node.entries:
        if written.text not in ("name", "std"):
            hint = (
                f"with `std` the effect acts {forms[0].everywhere}, with sizes of its own: leave '{written.text}' out"
            )
            faults.append(written.fault(f"{forms[0].name}: '{written.text}' beside 'std'", hint))
            return None
    below = node.get("std")
    std: Any = BAD if spec is None or below is None else spec.spec.read(below, faults)
    if std is BAD:
        return None
    if not std > 0:
        faults.append(node.fault(f"{forms[0].name}: std is not above zero", "write std: a standard deviation"))
        return None
    return RequestedEffect(tuple(forms), {}, {}, node, float(std))


def _as(effect: Effect, node: Node) -> tuple[dict[str, Any], list[Fault]]:
    """Return the values of a node read as one form of an effect, and the faults found."""
    faults: list[Fault] = []
    specs: dict[str, Any] = {"name": Text()}
    specs |= {key: PlaceName() for key in effect.where if key != "by"}
    specs |= {parameter.name: parameter.spec for parameter in effect.all_parameters}
    if effect.by:
        specs["by"] = Choice(effect.by)
    for written, _ in node.entries:
        if written.text not in specs:
            message = f"unknown key '{written.text}' of {effect.name}"
            faults.append(written.fault(message, suggestion(written.text, specs)))
    required = [*(key for key in effect.where if key != "by"), *(parameter.name for parameter in effect.scanned)]
    for key in required:
        if node.get(key) is None:
            hint = f"write {key}: {specs[key].expects}" + ("; metrocli diagnose finds it" if effect.scanned else "")
            faults.append(node.fault(f"{effect.name}: the key '{key}' is missing", hint))
    below = {key: node.get(key) for key in specs if key not in ("name", "by")}
    values = {key: specs[key].read(value, faults) for key, value in below.items() if value is not None}
    by = node.get("by")
    if by is not None and effect.by:
        specs["by"].read(by, faults)
    return {key: value for key, value in values.items() if value is not BAD}, faults


def planted(requests: Iterable[RequestedEffect]) -> tuple[RequestedEffect, ...]:
    """Return the effects that a simulation contains: those whose parameters all have a value.

    Effects that the job only estimates, correlated errors and variance groups are left out. Raises InputError if an
    effect on the command line lacks a value.
    """
    missing = [
        (request, [p.name for p in request.forms[0].parameters if p.name not in request.values])
        for request in requests
        if request.is_in_table
    ]
    faults = [
        request.node.fault(f"{request.name}: {', '.join(names)} missing", _to_plant(request))
        for request, names in missing
        if names and request.node.line is None
    ]
    if faults:
        raise InputError(faults)
    return tuple(request for request, names in missing if not names)


def _to_plant(request: RequestedEffect) -> str:
    """Return what to write so that a simulation contains an effect."""
    effect = request.forms[0]
    if not request.std:
        return "a simulation needs a value for every parameter"
    drawn = f"; a scatter {effect.everywhere} is `--set noise.{effect.noise}=...`" if effect.noise else ""
    named = "".join(f": name one {key}, and a value for every parameter" for key in effect.keys)
    return f"a simulation draws no sizes from `std`{named}{drawn}"


def schema(table: Sequence[Effect]) -> Schema:
    """Return the JSON schema of `effects:` for a kind of job with this table."""
    if not table:
        return {"type": "array", "maxItems": 0}
    shapes = [_schema(effect) for effect in table] + [_common_schema(effect) for effect in table if effect.common]
    return {"type": "array", "items": {"anyOf": shapes}}


def _common_schema(effect: Effect) -> Schema:
    name = {"const": effect.name, "description": f"{effect.everywhere}: {effect.cause}"}
    std = effect.common.spec.schema() if effect.common else {}
    return {
        "type": "object",
        "properties": {"name": name, "std": std},
        "required": ["name", "std"],
        "additionalProperties": False,
    }


def _schema(effect: Effect) -> Schema:
    properties: Schema = {"name": {"const": effect.name, "description": effect.cause}}
    properties |= {key: PlaceName().schema() for key in effect.where}
    properties |= {parameter.name: parameter.spec.schema() for parameter in effect.all_parameters}
    if effect.by:
        properties["by"] = {"enum": [effect.by]}
    required = [
        "name",
        *(key for key in effect.where if key != "by"),
        *(parameter.name for parameter in effect.scanned),
    ]
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}
