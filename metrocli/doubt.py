"""Whether a result may be used: the one place that decides it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from metrocli import units
from metrocli.record import CriterionVerdict
from metrocli.result import Result, Scalar
from metrocli.table import Table

MOST = 2.0
"""Largest sigma0 of a result that may be used, where the job requires no other"""
_LEVEL = 0.999
_CORNER = 0.05
"""Largest standard uncertainty of a projection into a corner, as a share of the longer side of the image"""
MOST_REJECTED = 1 / 3
"""Largest share of outliers: more of them have one cause"""
_FEWEST_REJECTED = 5
"""Fewest readings of one source that are left out for one cause: fewer may each be wrong by themselves"""
MANY_LEFT_OUT = 3
"""Fewest readings left out as outliers that may have one cause in the settings: others are tried"""
_SETTINGS, _PICTURE = "units, names and settings", "blur, motion, another lens or focus, and the names of targets"
_SOURCES = {
    "station": _SETTINGS, "tracer": _SETTINGS, "image": _PICTURE, "view": "the placing and the names of balls",
    "leg": _SETTINGS, "line": _SETTINGS,
}  # fmt: skip
"""Columns that name what many readings have in common, and where the cause of many outliers may be"""


def doubts_of(result: Result, verdicts: Sequence[CriterionVerdict], strict: bool = False) -> tuple[str, ...]:
    """Return why a result must not be used, one sentence for each reason.

    The reasons are those of the kind's own checks (`Result.doubts`), and residuals that contradict the declared noise:
    sigma0 above 2, or above what the job requires, and above the 99.9 % bound `sqrt(chi2(0.999; dof) / dof)`. So is a
    measurement of which more than a third was left out as outliers, or all that others controlled. A third of one
    station, tracer, image, view or line, in all or of one quantity, is enough. A camera is doubtful whose projection
    into a corner of the image is uncertain by more than 5 % of its longer side (`corner_std`), where the job requires
    no other. With `strict` every warning is a reason too.
    """
    figures = result.statistics
    thinned = _thinned(figures)
    own = (
        *result.doubts,
        *_misfit(figures, verdicts),
        *thinned,
        *_depleted(result.tables, bool(thinned)),
        *_uncovered(figures, verdicts),
    )
    return (*own, *result.warnings) if strict else own


def _misfit(
    statistics: Mapping[str, Scalar | Mapping[str, float]], verdicts: Sequence[CriterionVerdict]
) -> tuple[str, ...]:
    sigma0, dof = _number(statistics.get("sigma0")), _number(statistics.get("dof"))
    # estimated noise makes sigma0 fit by construction: then only the checks of the kind can doubt
    if not (sigma0 > 0 and dof > 0) or statistics.get("noise_estimated"):
        return ()
    limits = [
        verdict
        for verdict in verdicts
        if verdict.name.removeprefix("statistics.") == "sigma0" and verdict.condition.lstrip().startswith("<")
    ]
    beyond = any(not limit.met for limit in limits) if limits else sigma0 > MOST
    # with few degrees of freedom chance alone exceeds 2, so the 99.9 % bound has to be passed, too
    if not beyond or sigma0 <= (bound := chi_bound(dof, _LEVEL)):
        return ()
    allowed = " and ".join(limit.condition.strip() for limit in limits) or f"<= {MOST:g}"
    other = "" if limits else '; `require: {sigma0: "< 5"}` sets another limit'
    return (
        f"sigma0 = {sigma0:.3g} where {allowed} is allowed, and chance exceeds {bound:.3g} in 0.1 % of cases only: "
        "model and declared noise do not fit the readings, do not use this result; `metrocli diagnose` looks for "
        f"the cause{other}",
    )


def _thinned(statistics: Mapping[str, Scalar | Mapping[str, float]]) -> tuple[str, ...]:
    rejected = _number(statistics.get("rejected"))
    whole = rejected + _number(statistics.get("readings", statistics.get("observations")))
    if rejected > 0 and statistics.get("dof") == 0:
        return (
            f"{rejected:.0f} of {whole:.0f} readings are left out as outliers, and no others control the rest: "
            "whether these are the wrong ones is not known, do not use this result",
        )
    if not rejected > MOST_REJECTED * whole:
        return ()
    return (
        f"{rejected:.0f} of {whole:.0f} readings are left out as outliers, more than a third: "
        "the model does not describe this measurement, do not use this result",
    )


def _depleted(tables: Mapping[str, Table], thinned: bool) -> Iterator[str]:
    """Yield a sentence for each station, or other source of readings, that lost many; `thinned` if one is for all."""
    out, used = tables.get("rejected"), tables.get("residuals")
    if out is None or used is None or not len(out):
        return
    for source in (source for source in _SOURCES if source in out and source in used):
        lost = _by_quantity(out, source)
        whole = lost + _by_quantity(used, source)
        many = {
            name for (name, what), n in lost.items() if n >= _FEWEST_REJECTED and n > MOST_REJECTED * whole[name, what]
        }
        names = list(dict.fromkeys(name for name, _ in whole))
        for name in () if thinned and len(many) == len(names) else names:
            if name in many:
                each = [f"{n} of {whole[name, what]} {what}" for (of, what), n in lost.items() if of == name and what]
                yield (
                    f"{lost[name, '']} of {whole[name, '']} readings of {source} {name} are left out as outliers"
                    f"{' (' * bool(each)}{', '.join(each)}{')' * bool(each)}: so many have one cause. "
                    f"Look at {_SOURCES[source]} of this {source} (`metrocli diagnose` tries others); do not use "
                    "this result"
                )


def _by_quantity(table: Table, source: str) -> Counter[tuple[str, str]]:
    """Return how many readings a table has by source and quantity, and of all quantities by source and ""."""
    names, parts = table.texts(source), table.texts("component", "")
    # a reading of several components has a row for each
    counts = Counter((name, "") for name, part in zip(names, parts, strict=True) if part == parts[0])
    if "quantity" in table:
        counts.update((name, what) for name, what in zip(names, table.texts("quantity"), strict=True) if what)
    # bars and levelled heights, beside the readings of stations, are of no station
    return Counter({key: count for key, count in counts.items() if key[0]})


def _uncovered(
    statistics: Mapping[str, Scalar | Mapping[str, float]], verdicts: Sequence[CriterionVerdict]
) -> tuple[str, ...]:
    corner = _number(statistics.get("corner_std"))
    most = _CORNER * max(_number(statistics.get("image_width")), _number(statistics.get("image_height")))
    if not corner > most or any(verdict.name.removeprefix("statistics.") == "corner_std" for verdict in verdicts):
        return ()
    hull, radius = (100 * _number(statistics.get(f"coverage_{name}")) for name in ("hull", "radius"))
    name = f"{statistics['worst_camera']}: " if "worst_camera" in statistics else ""
    size, allowed = units.two_digits(corner), units.two_digits(most)
    return (
        f"{name}readings span {hull:.0f} % of the image, up to {radius:.0f} % of its radius. In a corner the lens is "
        f"uncertain by {size} px (standard uncertainty), where {allowed} px (5 % of the image) are allowed. Show the "
        "target near the corners, estimate fewer lens parameters, or set another limit: "
        f'`require: {{corner_std: "< {float(f"{2 * corner:.1g}"):g}"}}`',
    )


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def chi_bound(dof: float, probability: float) -> float:
    """Return the bound that sigma0 stays below with a probability if model and noise are right."""
    from scipy.special import chdtri

    return float((chdtri(dof, 1 - probability) / dof) ** 0.5)
