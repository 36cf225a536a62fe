"""From the definition of a user-defined effect to an entry of the table, with all faults at their places."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from metrocli import units
from metrocli.adjust.model.blocks import Space
from metrocli.adjust.model.chain import Link
from metrocli.effects.acting import Acting, Variable
from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.links.own import OwnTerms
from metrocli.effects.own.definition import (
    Definition,
    Given,
    Scan,
    absurdity,
    components,
    constants_of_data,
    lacking,
    not_free,
    of_unit,
    shape,
    text_of,
    values_tried,
)
from metrocli.effects.own.trials import Trial, is_wave, without_value
from metrocli.errors import Fault
from metrocli.expressions.derivatives import NoValueError
from metrocli.expressions.dimensions import Compound, base_unit, compound, described, unit_of
from metrocli.expressions.expression import NAME, ExpressionError
from metrocli.nodes import Node
from metrocli.settings import BAD, Section
from metrocli.words import did_you_mean, suggestion

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_SAMPLE = {"axis": "x", "pair": "xy"}


def read(
    nodes: Iterable[Node],
    places: Sequence[Acting],
    taken: Iterable[str],
    faults: list[Fault],
    required: Callable[[str], bool] = lambda name: True,
) -> list[Effect]:
    """Return the effects that the nodes define for a kind of job with these places to act.

    `taken` are the names of its other effects. Appends a fault for each mistake. An unknown variable is a mistake in an
    effect that is `required`, by its name; any other effect with one `lacks` a column of the data.
    """
    names, effects = set(taken), list[Effect]()
    for node in nodes:
        given = Section(Definition).read(node, faults)
        if given is BAD:
            continue
        reader = _Reader(given, node, tuple(places), names, required(given.name.value))
        effect = reader.effect()
        faults.extend(reader.faults)
        names.add(given.name.value)
        if effect is not None:
            effects.append(effect)
    return effects


@dataclass
class _Reader:
    """One definition as it is read; `faults` collects its mistakes."""

    given: Definition
    node: Node
    places: tuple[Acting, ...]
    taken: set[str]
    required: bool
    faults: list[Fault] = field(default_factory=list)
    unknown: dict[str, str] = field(default_factory=dict)
    """Variables that no column explains, each with what may be meant or an empty text"""
    unclear: list[ExpressionError] = field(default_factory=list)

    def effect(self) -> Effect | None:
        """Return the entry of the table, or None if the definition has a fault."""
        self._name()
        acting = self._acting()
        if acting is None:
            return None
        where = self._where(acting)
        parameters = [self._parameter(name, given) for name, given in self.given.parameters.items()]
        scanned = [self._scanned(name, scan) for name, scan in self.given.scan.items()]
        if not parameters:
            self._fault(
                "parameters", "an effect needs a parameter", "write parameters: {a: {unit: um, plausible: 10 um}}"
            )
        if self.faults:
            return None
        sample = {key: _SAMPLE.get(key) or next(iter(acting.split.get(key, {"": None}))) for key in where}
        own = {*self.given.parameters, *self.given.scan}
        every = acting.variables_at(sample)
        known = {name: variable for name, variable in every.items() if not (variable.of_data and name in own)}
        for fault in not_free((self.given.parameters, self.given.scan), known, where):
            self._fault(*fault)
        used = self._used(known, acting.refused)
        if self.faults:
            return None
        plain = Effect(
            self.given.name.value,
            self.given.cause,
            tuple(parameters),
            where=where,
            reveal=self.given.reveal,
            source=self.given.source,
            definition=text_of(self.node),
        )
        if self.unknown or self.unclear:
            return replace(plain, lacks=lacking(self.unknown, self.unclear))
        self._units(acting, used)
        wave = None if self.faults else self._tried(used)
        if self.faults:
            return None
        first = wave or ()  # amplitude and phase of a wave come first
        ordered = sorted(parameters, key=lambda p: first.index(p.name) if p.name in first else len(first))
        template = acting.variables_at(sample | ({"axis": "{axis}"} if "axis" in where else {}))
        return replace(
            plain,
            parameters=tuple(ordered),
            link=self._link(acting, list(used), ordered, scanned, wave),
            scanned=tuple(scanned),
            space=Space.WAVE if wave else Space.FLAT,
            needs=tuple(dict.fromkeys(need for name in used for need in template[name].needs)),
        )

    def _fault(self, key: str, message: str, hint: str | None = None) -> None:
        node = self.node.at(key)
        self.faults.append(node.fault(f"{node.path}: {message}", hint))

    def _name(self) -> None:
        name = self.given.name.value
        if not _NAME.fullmatch(name):
            self._fault("name", f"'{name}' is not the name of an effect", "write lower case and hyphens: range-zero")
        elif name in self.taken:
            self._fault("name", f"an effect '{name}' exists already", "choose another name")

    def _acting(self) -> Acting | None:
        wanted = self.given.acts_on.value
        acting = next((place for place in self.places if place.name == wanted), None)
        if acting is None:
            known = [place.name for place in self.places]
            hint = suggestion(wanted, known) if known else "this kind of job has no effects"
            self._fault("acts_on", f"there is no quantity '{wanted}'", hint)
            return None
        for name in self.given.adds:
            allowed = components(acting, [place.value for place in self.given.where])
            if name not in allowed:
                what = f"there is no component '{name}'" if name else f"{wanted} is a vector"
                self._fault(f"adds.{name}" if name else "adds", what, f"write {shape(allowed)}")
        return acting

    def _where(self, acting: Acting) -> tuple[str, ...]:
        for number, place in enumerate(self.given.where):
            if place.value in [before.value for before in self.given.where[:number]]:
                twice = f"{place.node.path}: '{place.value}' is there twice"
                self.faults.append(place.node.fault(twice, "leave it out"))
            elif place.value not in acting.where:
                hint = suggestion(place.value, acting.where) if acting.where else "leave it out"
                absent = f"{place.node.path}: no effect on {acting.name} has a '{place.value}'"
                self.faults.append(place.node.fault(absent, hint))
        return tuple(place.value for place in self.given.where)

    def _parameter(self, name: str, given: Given) -> Parameter:
        unit = self._unit(f"parameters.{name}.unit", given.unit.value)
        size = given.plausible
        parameter = of_unit(name, given.unit.value, unit, size.value)
        if unit is not None and size.unit.powers != unit.powers:
            self.faults.append(size.fault(f"{size.unit.text} is {described(size.unit)}", f"expected {described(unit)}"))
        elif unit is not None and (absurd := absurdity(parameter, size, unit)):
            self.faults.append(size.fault(absurd, "write the largest size that can be believed"))
        return parameter

    def _scanned(self, name: str, scan: Scan) -> Parameter:
        low, high = scan.low, scan.high
        if low.unit.powers != high.unit.powers:
            self.faults.append(
                high.fault(f"{high.unit.text} is {described(high.unit)}", f"expected {described(low.unit)}")
            )
        elif not low.value < high.value:
            self.faults.append(high.fault("`to` is not above `from`", "write from: 2 mm, to: 100 mm"))
        values = values_tried(name, scan, self.given.adds.values())
        return of_unit(name, low.unit.text, low.unit, abs(high.value), lambda conditions: values, scan.steps)

    def _unit(self, key: str, text: str) -> Compound | None:
        try:
            unit = compound(text)
        except units.QuantityError as error:
            self._fault(key, error.message, error.hint)
            return None
        if unit.point:
            self._fault(key, "a parameter is a difference of temperatures", "write K")
            return None
        return unit

    def _used(self, known: Mapping[str, Variable], refused: Mapping[str, str]) -> dict[str, Variable]:
        """Return the variables in the expressions; add a fault for each unknown name, and each parameter not used.

        `refused` are names of columns that no expression can use, each with what to write.
        """
        own = {**self.given.parameters, **self.given.scan}
        used: dict[str, Variable] = {}
        named: set[str] = set()
        for model in self.given.adds.values():
            self.unclear += (unclear := [*constants_of_data(model.node.text, refused)])
            self.faults += [model.fault(error) for error in unclear if self.required]
            for part in model.expression.parts:
                if part.operation != NAME:
                    continue
                named.add(part.name)
                if part.name in known:
                    used[part.name] = known[part.name]
                elif part.name not in own and not self.required:
                    self.unknown[part.name] = refused.get(part.name) or did_you_mean(part.name, known)
                elif part.name not in own:
                    hint = refused.get(part.name) or suggestion(part.name, [*own, *known])
                    self.faults.append(
                        model.fault(ExpressionError(f"unknown variable '{part.name}'", part.start, hint))
                    )
        self._idle(name for name in own if name not in named)
        return used

    def _idle(self, names: Iterable[str]) -> None:
        for name in names:
            key = "parameters" if name in self.given.parameters else "scan"
            self._fault(f"{key}.{name}", f"the parameter '{name}' changes nothing", "use it in `adds`, or leave it out")

    def _units(self, acting: Acting, used: Mapping[str, Variable]) -> None:
        named = {name: compound(variable.unit) for name, variable in used.items()}
        named |= {name: compound(given.unit.value) for name, given in self.given.parameters.items()}
        named |= {name: scan.low.unit for name, scan in self.given.scan.items()}
        for name, model in self.given.adds.items():
            wanted = compound(acting.unit_of(name))
            try:
                unit = unit_of(model.expression, named)
            except ExpressionError as error:
                self.faults.append(model.fault(error))
                continue
            if unit.powers != wanted.powers:
                message = f"this is {described(unit)}, but {acting.name} is {described(wanted)}"
                self.faults.append(model.fault(ExpressionError(message, 0, f"expected {base_unit(wanted.powers)}")))

    def _tried(self, used: Mapping[str, Variable]) -> tuple[str, str] | None:
        """Add the faults that trial values show; return amplitude and phase if the effect is a wave."""
        plausible = {name: given.plausible.value for name, given in self.given.parameters.items()}
        ranges = {name: (scan.low.value, scan.high.value) for name, scan in self.given.scan.items()}
        expressions = [model.expression for model in self.given.adds.values()]
        model = next(iter(self.given.adds.values()))
        try:
            trial = Trial.of(expressions, used, plausible, ranges)
        except NoValueError as error:
            self.faults.append(model.fault(without_value(error)))
            return None
        for name, end in ((name, end) for name, scan in self.given.scan.items() for end in (scan.low, scan.high)):
            if not trial.has_value_at(name, end.value):
                self.faults.append(end.fault("`adds` has no value there", "a period or time constant is above 0"))
        if not trial.vanishes:
            hint = "where all its parameters are 0 an effect adds 0"
            self.faults.append(model.fault(ExpressionError("this is not 0 where all parameters are 0", 0, hint)))
            return None
        idle = [name for name in (*plausible, *ranges) if name not in trial.moving]
        self._idle(idle)
        still = [name for name in plausible if name not in trial.moving_at_zero and name not in idle]
        wave = is_wave(trial, list(plausible), still)
        for name in still if wave is None else ():
            hint = f"try it at several values instead: scan: {{{name}: {{from: ..., to: ..., steps: 60}}}}"
            self._fault(f"parameters.{name}", f"'{name}' changes nothing where all parameters are 0", hint)
        return wave

    def _link(
        self,
        acting: Acting,
        used: Sequence[str],
        parameters: Sequence[Parameter],
        scanned: Sequence[Parameter],
        wave: tuple[str, str] | None,
    ) -> Callable[[str, Mapping[str, str]], Link]:
        name, adds = self.given.name.value, {key: model.expression for key, model in self.given.adds.items()}

        def link(block: str, where: Mapping[str, str]) -> Link:
            known = acting.variables_at(where)
            return OwnTerms(
                block,
                acting.at(where)[0],
                name,
                tuple((acting.numbers(key, where), expression) for key, expression in adds.items()),
                tuple(parameter.name for parameter in parameters),
                tuple(parameter.name for parameter in scanned),
                tuple(known[name] for name in used),
                wave is not None,
            )

        return link
