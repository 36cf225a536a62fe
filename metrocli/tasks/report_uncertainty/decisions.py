"""Tolerances and targets of measurands: checks of what is given, and the decision from value and uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from metrocli import units
from metrocli.errors import Fault
from metrocli.expressions.dimensions import Compound, compound, described
from metrocli.expressions.written import Measure
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import LocatedValue
from metrocli.tasks.report_uncertainty.entries import Tolerance
from metrocli.uncertainty.decision import (
    FACTOR_2017,
    Interval,
    Items,
    capable,
    conformance,
    global_risk,
    guard_for_global,
    guard_for_specific,
    zone,
)
from metrocli.uncertainty.samples import MeasurandSample
from metrocli.words import suggestion

PLAIN = (
    "U_over_T", "conformance", "conformance_mc", "consumer", "consumer_of_accepted", "producer", "wanted_risk",
)  # fmt: skip
"""Keys of a decision whose values have no unit"""


def limits_of(placed: LocatedValue) -> Tolerance:
    """Return the limits of a tolerance, which is written as a pair or as a section."""
    return placed.value if isinstance(placed.value, Tolerance) else Tolerance(placed.value)


def faults(tolerance: Any, wanted: Mapping[str, LocatedValue]) -> Iterable[Fault | tuple[str, ...]]:
    """Yield the faults of the tolerances of measurands."""
    if tolerance is None:
        return
    if isinstance(tolerance, LocatedValue):
        yield "tolerance", "one width is the tolerance of a volume", "write {NAME: [lower, upper]} for a measurand"
        return
    for name, placed in tolerance.items():
        if name not in wanted:
            yield _of_none("tolerance", name, placed.node, wanted)
        elif (unit := _unit_of(wanted[name])) is not None:
            yield from _of_one(placed, unit)


def target_faults(targets: Mapping[str, Measure], wanted: Mapping[str, LocatedValue]) -> Iterable[Fault]:
    """Yield the faults of the wanted expanded uncertainties of measurands."""
    for name, measure in targets.items():
        if name not in wanted:
            yield _of_none("target", name, measure.node, wanted)
        elif (unit := _unit_of(wanted[name])) is None:
            continue
        elif measure.unit.powers != unit.powers:
            message = f"the target is {described(measure.unit)}, the measurand is {described(unit)}"
            yield measure.fault(message, f"write it in {unit.text}")
        elif measure.number <= 0:
            yield measure.fault("the target is not above zero", "write the U that is wanted")


def _of_none(what: str, name: str, node: Node, wanted: Mapping[str, LocatedValue]) -> Fault:
    return node.fault(f"{what} of '{name}', which is not a measurand", suggestion(name, wanted))


def _unit_of(measurand: LocatedValue) -> Compound | None:
    """Return the unit of a measurand; None for one that is not a unit, which is a fault of its own."""
    try:
        return compound("" if measurand.value.unit == "1" else measurand.value.unit)
    except units.QuantityError:
        return None


def _of_one(placed: LocatedValue, unit: Compound) -> Iterable[Fault]:
    limits = limits_of(placed)
    low, high = limits.between
    process = limits.process
    for measure in (low, high, *((process.mean, process.std) if process else ())):
        if measure is not None and measure.unit.powers != unit.powers:
            yield measure.fault(
                f"the value is {described(measure.unit)}, the measurand is {described(unit)}",
                f"write it in {unit.text}",
            )
    if low is None and high is None:
        yield placed.node.fault(
            f"{placed.node.path}: both limits are missing", "write [lower, upper]; one of them may be none"
        )
    elif low is not None and high is not None and low.value >= high.value:
        yield high.fault("the upper limit is not above the lower one", "write [lower, upper]")
    if process is not None and process.std.number <= 0:
        yield process.std.fault("the standard deviation of the items is not above zero")


@dataclass(frozen=True)
class DecidedMeasurand:
    """A measurand as the decision needs it, in base units."""

    value: float
    std: float
    U: float
    dof: float
    sample: MeasurandSample | None
    centre: float


def decide(limits: Tolerance, measured: DecidedMeasurand, factor: float) -> dict[str, Any]:
    """Return the decision in the unit of the measurand; `factor` is the size of this unit in base units.

    Acceptance zones with U and with 1.65 u (ISO 14253-1), U/T, and the probability of conformity (JCGM 106).
    """
    ends = Interval(_end(limits.between[0], -math.inf), _end(limits.between[1], math.inf))
    narrow = FACTOR_2017 * measured.std
    decision: dict[str, Any] = {
        "limits": _shown(ends, factor),
        "zone": zone(measured.value, ends, measured.U),
        "acceptance": _shown(ends.inside(measured.U), factor),
        "zone_2017": zone(measured.value, ends, narrow),
        "acceptance_2017": _shown(ends.inside(narrow), factor),
        "conformance": conformance(measured.value, measured.std, ends, measured.dof),
    }
    if math.isfinite(ends.width):
        decision |= {"T": ends.width / factor, "U_over_T": measured.U / ends.width}
        decision["capable"] = capable(measured.U, ends.width)
    if measured.sample is not None:
        above = measured.sample.below(ends.high - measured.centre) if math.isfinite(ends.high) else 1.0
        under = measured.sample.below(ends.low - measured.centre) if math.isfinite(ends.low) else 0.0
        decision["conformance_mc"] = above - under
    return decision | _risks(limits, measured, ends, factor)


def _risks(limits: Tolerance, measured: DecidedMeasurand, ends: Interval, factor: float) -> dict[str, Any]:
    """Return the global risks of simple acceptance if the items are known, and the guard band if a risk is wanted."""
    if measured.std == 0:
        return {}
    printed: dict[str, Any] = {}
    items = Items(limits.process.mean.value, limits.process.std.value) if limits.process else None
    if items is not None:
        risks = global_risk(items, measured.std, ends, ends)
        printed |= {
            "consumer": risks.consumer,
            "consumer_of_accepted": risks.consumer_of_accepted,
            "producer": risks.producer,
        }
    if limits.risk is not None:
        specific = guard_for_specific(measured.std, limits.risk, ends, measured.dof)
        guard = specific if items is None else guard_for_global(items, measured.std, ends, limits.risk)
        printed |= {
            "wanted_risk": limits.risk,
            "guard_band": guard / factor,
            "acceptance_guarded": _shown(ends.inside(guard), factor),
        }
        if items is not None and math.isfinite(guard):
            guarded = global_risk(items, measured.std, ends, ends.inside(guard))
            printed |= {"guarded": {"consumer": guarded.consumer, "producer": guarded.producer}}
    return printed


def _end(limit: Measure | None, otherwise: float) -> float:
    return otherwise if limit is None else limit.value


def _shown(interval: Interval, factor: float) -> list[float]:
    """Return an interval in the unit of the measurand, or an empty list if its ends cross."""
    return [interval.low / factor, interval.high / factor] if interval.low <= interval.high else []


def lines(decision: Mapping[str, Any], unit: str) -> list[str]:
    """Return a decision as lines of text."""
    low, high = decision["limits"]
    zones = f"{decision['zone']} with U (ISO 14253-1), {decision['zone_2017']} with 1.65 u"
    printed = [f"tolerance {low:.10g} to {high:.10g} {unit}: {zones}"]
    if not decision["acceptance"]:
        printed.append("U is larger than half of the tolerance: the acceptance zone of ISO 14253-1 is empty")
    if "T" in decision:
        words = "capable" if decision["capable"] else "not capable"
        printed.append(f"U/T = {100 * decision['U_over_T']:.1f} %: {words} by the 20 % rule of Berndt")
    mc = f", by Monte Carlo {decision['conformance_mc']:.6g}" if "conformance_mc" in decision else ""
    printed.append(f"probability of conformity {decision['conformance']:.6g} (JCGM 106){mc}")
    if "consumer" in decision:
        of_accepted = f"{decision['consumer_of_accepted']:.4g} of those accepted"
        risks = f"consumer {decision['consumer']:.4g} ({of_accepted}), producer {decision['producer']:.4g}"
        printed.append(f"global risks: {risks}")
    if "guard_band" in decision:
        ends = decision["acceptance_guarded"]
        accept = (
            f"{decision['guard_band']:.4g} {unit}: accept {ends[0]:.10g} to {ends[1]:.10g}"
            if ends
            else "no value can be accepted"
        )
        printed.append(f"guard band for a risk of {decision['wanted_risk']:g}: {accept}")
    return printed
