"""Known causes left out of real measurements, or planted into them: how often `diagnose` names them, and what else.

Each set is diagnosed as it is with an adequate model, with an ingredient of the model left out, and with an effect
planted: with what an adjustment finds of it in the set, it is 1, 2 and 4 times the least size that the diagnosis states
for the set as it is. Adjustments with code of their own (benchmarks/real) plant the effects and judge the names: one is
false if it predicts held-out images, or parts of a drive, worse. What a set had of an effect is known roughly, so
intervals are judged by two halves of its images, each diagnosed alone: their sizes of the planted effect have to agree
within the uncertainties of both. Of a survey and of a network of images, published results are the judge. What a survey
has of an effect is what its own job finds with the effect in its model; into the network it is planted beside what is
published of it. The data are not part of the project: most stand in ../shared/data, the images of four cameras and
of an endoscope come from the package index. Sets that are absent are named and left out.

    python -m benchmarks real_causes [SET ...]    # left right ... plaza1 ... cam01 ... endoscope
    python -m benchmarks real_causes parts [SEED]    # of each board some images, drawn at random
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bars import Rate
from benchmarks.real import boards, network, ranges, survey
from benchmarks.real.boards import COLUMNS, OF_TARGET, Board, Model
from benchmarks.real.sets import BOARDS, DATA, DRIVES, FETCHED, LENS, BoardSet, PartOfBoard, ranges_job
from metrocli.diagnosis.verdict import as_data
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import JobOptions, load

TIMES = (1.0, 2.0, 4.0)
PLANTED = ("thin-prism", "axis-skew", "stretched-targets", OF_TARGET)
LEFT_OUT = {"radial-distortion": ("k1", "k2"), "decentring-distortion": ("p1", "p2")}
_REAL = 2.0
"""Standard errors from which an ingredient is in a set: then it is left out"""
_FEWEST = 5
"""Fewest images for that judgement"""

Where = Mapping[str, str]
Named = tuple[str, tuple[str, ...]]


@dataclass(frozen=True)
class Case:
    """One diagnosis, with what is known of the truth."""

    name: str
    sort: str
    data: Mapping[str, Any]
    seconds: float
    truth: Named | None = None
    size: tuple[float, ...] = ()
    """True sizes of its parameters, where they are known"""
    as_it_is: frozenset[Named] = frozenset()
    """Names that the set has without what was done to it"""
    extended: str = ""
    """Verdict on the extended job"""
    gains: Mapping[Named, tuple[float, float]] = field(default_factory=dict)
    """Gain of each name by the independent adjustment, and its standard error"""
    halves: tuple[Mapping[str, Any], ...] = ()
    """Diagnoses of two halves of the images"""

    @property
    def names(self) -> list[Named]:
        """The names in the order of the report."""
        return [_named(one) for one in self.data["effects"]]

    @property
    def found(self) -> bool:
        """Whether the truth is named, or stands among the alternatives of a name."""
        others = (_named(other) for one in self.data["effects"] for other in one["alternatives"])
        return self.truth in [*self.names, *others]

    @property
    def first(self) -> bool:
        """Whether it is the first of the names but those that the set as it is has for other causes."""
        new = [one for one in self.data["effects"] if _named(one) not in self.as_it_is - {self.truth}]
        return bool(new) and self.truth in [_named(new[0]), *map(_named, new[0]["alternatives"])]

    @property
    def false_exclusion(self) -> bool:
        """Whether a size below the true one is said to be excluded."""
        if self.truth is None or not self.size:
            return False
        true = float(np.linalg.norm(self.size))
        said = [one for one in self.data["candidates"] if _named(one) == self.truth and one["status"] == "excluded"]
        return any(one["above"]["value"] < true for one in said)

    @property
    def differences(self) -> list[float]:
        """Of each parameter of the truth, the difference between two halves in its standard uncertainty."""
        sizes = [one["parameters"] for half in self.halves for one in half["effects"] if _named(one) == self.truth]
        if len(sizes) < 2:
            return []
        pairs = [(one, sizes[1][name]) for name, one in sizes[0].items() if name in sizes[1]]
        known = [(one, other) for one, other in pairs if one["std"] and other["std"]]
        return [float((a["value"] - b["value"]) / np.hypot(a["std"], b["std"])) for a, b in known]

    @property
    def agreed(self) -> list[bool]:
        """Of each parameter of the truth, whether two halves agree within the 95 % interval of their difference."""
        return [abs(z) < 1.96 for z in self.differences]

    def __str__(self) -> str:
        word = "" if self.truth is None else f"{'named' if self.found else 'MISSED'}{', first' if self.first else ''}"
        wrong = [f"{' '.join([n, *w])} {g[0]:+.0f}" for (n, w), g in self.gains.items() if g[0] <= 0]
        listed = ", ".join(" ".join([name, *where]) for name, where in self.names)
        text = f"{self.name:44} {self.seconds:5.1f} s  {self.data['verdict']:12} {word:13} {listed[:90]}"
        text += f"  FALSE: {', '.join(wrong)}" if wrong else ""
        text += "  FALSE EXCLUSION" if self.false_exclusion else ""
        text += f"  halves differ by z = {', '.join(f'{z:.1f}' for z in self.differences)}" if self.differences else ""
        return text + (f"  then {self.extended}" if self.extended else "")


def _named(one: Mapping[str, Any]) -> Named:
    where = {key: name for key, name in one["where"].items() if key != "by"}
    return one["name"], tuple(map(str, where.values()))


def diagnosed(path: Path, extend: bool = True) -> tuple[dict[str, Any], float, str]:
    """Return the diagnosis of a job as plain data, its CPU seconds, and the verdict on the extended job."""
    job = load(path, JobOptions(accept_doubtful=True))
    start = time.process_time()
    found = carry_out(job)
    seconds, after = time.process_time() - start, ""
    extended = write_extended(job, found, force=True) if extend else None
    if extended is not None:
        after = str(carry_out(load(extended.path, JobOptions(accept_doubtful=True))).verdict)
    return as_data(found), seconds, after


def of_board(one: BoardSet, folder: Path) -> Iterator[Case]:
    """Yield the cases of a set of images."""
    board = one.read(folder)
    rng, adequate = np.random.default_rng([20261126, *one.name.encode()]), Model(LENS)
    fit = boards.fitted(board, adequate)
    data, seconds, after = diagnosed(one.job(folder / "as-is", board, LENS))
    plain = Case(
        f"{one.name}: as it is", "as it is", data, seconds, extended=after, gains=_judged(board, adequate, data)
    )
    yield plain
    kept = frozenset(plain.names)
    for name, terms in LEFT_OUT.items():
        free = tuple(term for term in LENS if term not in terms)
        real, error = boards.gain(board, Model(free), adequate)
        if real < _REAL * error or len(board.images) < _FEWEST:
            continue
        data, seconds, after = diagnosed(one.job(folder / name, board, free))
        judged = _judged(board, Model(free), data)
        sizes = tuple(fit.values.get(key, 0.0) for key in COLUMNS[name])
        yield Case(f"{one.name}: without {name}", "left out", data, seconds, (name, ()), sizes, kept, after, judged)
    for at, name in enumerate(PLANTED):
        target = board.targets[int(rng.integers(len(board.targets)))]
        where: Where = {"target": target} if name == OF_TARGET else {}
        spot = name, tuple(where.values())
        least = _least(plain.data, spot)
        if spot in kept or least is None:
            continue
        count = 3 if name == OF_TARGET else len(COLUMNS[name])
        direction = rng.normal(size=count)
        direction /= np.linalg.norm(direction)
        own = boards.fitted(board, adequate.plus(name, where), fit)
        was = own.shifts[board.targets.index(target)] if where else [own.values.get(k, 0.0) for k in COLUMNS[name]]
        for times in TIMES:
            true = tuple((times * least * direction).tolist())
            sizes = tuple(a - b for a, b in zip(true, np.asarray(was).tolist(), strict=True))
            changed = boards.planted(board, fit, name, where, sizes)
            data, seconds, _ = diagnosed(one.job(folder / f"{name}-{times:g}", changed, LENS), extend=False)
            title, halves = f"{name}-{times:g}", list[Mapping[str, Any]]()
            if times == max(TIMES) and len(board.images) >= 2 * _FEWEST:
                mixed = np.random.default_rng([20261127, at]).permutation(len(board.images))
                for part in (mixed[::2], mixed[1::2]):
                    job = one.job(folder / f"{title}-{part[0]}", changed.only(np.sort(part)), LENS)
                    halves.append(diagnosed(job, extend=False)[0])
            yield Case(
                f"{one.name}: {' '.join([name, *where.values()])} {times:g}x",
                f"planted {times:g}x",
                data,
                seconds,
                spot,
                true,
                kept,
                halves=tuple(halves),
            )
        if at == 0:
            free = tuple(term for term in LENS if term not in ("k1", "k2"))
            bare, _, _ = diagnosed(one.job(folder / "bare", board, free), extend=False)
            changed = boards.planted(board, fit, name, where, tuple((4 * least * direction).tolist()))
            data, seconds, _ = diagnosed(one.job(folder / f"{name}-beside", changed, free), extend=False)
            names = frozenset(map(_named, bare["effects"]))
            yield Case(
                f"{one.name}: {name} 4x beside radial-distortion", "beside structure", data, seconds, spot, (), names
            )


def _judged(board: Board, model: Model, data: Mapping[str, Any]) -> dict[Named, tuple[float, float]]:
    """Return the gain of each name beside all others, by held-out images."""
    effects = [one for one in data["effects"] if one["name"] in (*COLUMNS, OF_TARGET)]
    found = {}
    for one in effects:
        others = model
        for other in effects:
            others = others if other is one else _with(others, other)
        found[_named(one)] = boards.gain(board, others, _with(others, one))
    return found


def _with(model: Model, one: Mapping[str, Any]) -> Model:
    std = one["parameters"]["std"]["value"] if "std" in one["parameters"] else 0.0
    return model.plus(one["name"], one["where"], std)


def _least(data: Mapping[str, Any], spot: Named) -> float | None:
    """Return the least size of an effect that a diagnosis states."""
    found = [one for one in data["candidates"] if _named(one) == spot and one["minimal_detectable"]]
    return float(found[0]["minimal_detectable"]["value"]) if found else None


def of_drive(drive: str, folder: Path) -> Iterator[Case]:
    """Yield the cases of the ranges of a vehicle."""
    read = ranges.Ranges.read(DATA / "plaza-ranges" / drive)
    scale, rng = ("length-scale", {}), np.random.default_rng([20261126, *drive.encode()])
    adequate = "[{name: length-scale}]"
    data, seconds, after = diagnosed(ranges_job(folder / "as-is", drive, adequate))
    judged = _judged_ranges(read, [scale], data)
    plain = Case(f"{drive}: as it is", "as it is", data, seconds, extended=after, gains=judged)
    yield plain
    kept = frozenset(plain.names)
    data, seconds, after = diagnosed(ranges_job(folder / "bare", drive, "[]"))
    size = (float(ranges.fitted(read, [scale]).sizes[0]),)
    judged = _judged_ranges(read, [], data)
    yield Case(
        f"{drive}: without length-scale", "left out", data, seconds, ("length-scale", ()), size, kept, after, judged
    )
    beacon = read.beacons[int(rng.integers(len(read.beacons)))]
    for name, where in (("length-offset", {}), ("tracer-scale", {"tracer": beacon})):
        spot = name, tuple(where.values())
        least = _least(plain.data, spot)
        if spot in kept or least is None:
            continue
        was = float(ranges.fitted(read, [scale, (name, where)]).sizes[1])
        fit = ranges.fitted(read, [scale])
        for times in TIMES:
            at = ranges.replace(read, start=fit.places)
            changed = read.with_change((times * least - was) * at.column(name, where))
            data, seconds, _ = diagnosed(
                ranges_job(folder / f"{name}-{times:g}", drive, adequate, changed), extend=False
            )
            sizes = (times * least,)
            title = f"{drive}: {' '.join([name, *where.values()])} {times:g}x"
            yield Case(title, f"planted {times:g}x", data, seconds, spot, sizes, kept)


def of_survey(title: str, folder: Path) -> Iterator[Case]:
    """Yield the cases of a survey, in which the height of a mark in one levelling is known to be another."""
    spot: Named = (survey.EPOCH, ("WAW3", "later-levelling"))

    def job(name: str, change: tuple[str, Where, Sequence[float]] | None = None) -> Path:
        return survey.job(folder / name, name != spot[0], change)

    def contained(name: str, where: Where) -> Sequence[float]:
        return survey.contained(folder / f"with-{name}", name, where)

    yield from _left_out_and_planted(title, job, {spot: ()}, survey.PLANTED, contained)


def of_network(title: str, folder: Path) -> Iterator[Case]:
    """Yield the cases of a network of images, whose camera is published."""

    def job(name: str, change: tuple[str, Where, Sequence[float]] | None = None) -> Path:
        planted = None if change is None else (change[0], change[2])
        return network.job(folder / name, network.LEFT_OUT.get(name, ()), planted)

    yield from _left_out_and_planted(title, job, {(name, ()): () for name in network.LEFT_OUT}, network.PLANTED)


def _left_out_and_planted(
    title: str,
    job: Callable[..., Path],
    left_out: Mapping[Named, tuple[float, ...]],
    planted: Mapping[str, int],
    contained: Callable[[str, Where], Sequence[float]] = lambda name, where: (0.0,),
) -> Iterator[Case]:
    """Yield the cases of a set that is judged by what is published of it; `contained` is what it has of an effect."""
    data, seconds, after = diagnosed(job("as-is"))
    plain = Case(f"{title}: as it is", "as it is", data, seconds, extended=after)
    yield plain
    kept = frozenset(plain.names)
    for spot, sizes in left_out.items():
        data, seconds, after = diagnosed(job(spot[0]))
        yield Case(f"{title}: without {spot[0]}", "left out", data, seconds, spot, sizes, kept, after)
    rng = np.random.default_rng([20261127, *title.encode()])
    for name, count in planted.items():
        places = [one for one in plain.data["candidates"] if one["name"] == name and one["minimal_detectable"]]
        chosen = places[int(rng.integers(len(places)))]
        least, direction = float(chosen["minimal_detectable"]["value"]), rng.normal(size=count)
        direction /= np.linalg.norm(direction)
        was = np.array(contained(name, chosen["where"]))
        for times in TIMES:
            sizes = tuple((times * least * direction).tolist())
            changed = job(f"{name}-{times:g}", (name, chosen["where"], tuple((sizes - was).tolist())))
            data, seconds, _ = diagnosed(changed, extend=False)
            spot = _named(chosen)
            case = f"{title}: {' '.join([name, *spot[1]])} {times:g}x"
            yield Case(case, f"planted {times:g}x", data, seconds, spot, sizes, kept)


def _judged_ranges(
    read: ranges.Ranges, before: Sequence[tuple[str, Where]], data: Mapping[str, Any]
) -> dict[Named, tuple[float, float]]:
    known = {*ranges.SHARED, *ranges.OF_BEACON}
    effects = [(one["name"], one["where"]) for one in data["effects"] if one["name"] in known]
    found = {}
    for one in effects:
        others = [*before, *(other for other in effects if other is not one)]
        found[one[0], tuple(map(str, one[1].values()))] = ranges.gain(read, others, [*others, one])
    return found


OTHERS = {"antenna-tie": of_survey, "aicon-network": of_network}
"""Sets of other kinds"""


def rates(cases: Sequence[Case]) -> Iterator[Rate]:
    """Yield the rates that are promised of real measurements."""
    by_sort: dict[str, list[Case]] = {}
    for one in cases:
        by_sort.setdefault(one.sort, []).append(one)
    for sort, own in by_sort.items():
        if own[0].truth is not None:
            bar = {"left out": 0.95, "planted 2x": 0.90, "planted 4x": 0.90, "beside structure": 0.90}.get(sort, 0.0)
            yield Rate(f"{sort}: named", sum(one.found for one in own), len(own), least=bar)
            yield Rate(f"{sort}: first", sum(one.first for one in own), len(own), least=min(bar, 0.90))
    judged = [gain for one in cases for gain in one.gains.values()]
    yield Rate("false names, of those judged", sum(gain[0] <= 0 for gain in judged), len(judged), most=0.05)
    yield Rate("false exclusions", sum(one.false_exclusion for one in cases), len(cases), most=0.0)
    agreed = [hit for one in cases for hit in one.agreed]
    yield Rate("halves that agree within 95 %", sum(agreed), len(agreed), 0.92, 0.98)
    after = [one for one in cases if one.extended]
    clean = sum(one.extended in ("clean", "explained") for one in after)
    yield Rate("extended job clean or explained", clean, len(after), least=0.90)


def _sets(folder: Path, seed: int | None) -> Iterator[tuple[str, Iterator[Case]]]:
    """Yield the name and the cases of each set that is at hand; with a seed, of a part of each board."""

    def drawn(sets: Sequence[BoardSet]) -> Iterator[tuple[str, Iterator[Case]]]:
        for whole in sets:
            one = whole if seed is None else PartOfBoard.of(whole, seed)
            yield one.name, of_board(one, folder / one.name)

    if DATA.is_dir():
        yield from drawn(BOARDS)
    else:
        print(f"no measured data at {DATA}")
    if DATA.is_dir() and seed is None:
        yield from ((drive, of_drive(drive, folder / drive)) for drive in DRIVES)
        yield from ((title, cases_of(title, folder / title)) for title, cases_of in OTHERS.items())
    for images, sets in FETCHED.items():
        try:
            images.fetch()
        except OSError as error:
            print(f"the images of {images.project} cannot be fetched ({error})")
        else:
            yield from drawn(sets)


def main(arguments: list[str]) -> int:
    """Print each case and the rates; return 1 where a bar is not met."""
    cases: list[Case] = []
    parts = arguments[:1] == ["parts"]
    seed = int(arguments[1]) if parts and arguments[1:] else 1 if parts else None
    with tempfile.TemporaryDirectory() as name:
        for title, found in _sets(Path(name), seed):
            if parts or not arguments or title in arguments:
                (Path(name) / title).mkdir(parents=True, exist_ok=True)
                try:
                    for one in found:
                        print(one, flush=True)
                        cases.append(one)
                except np.linalg.LinAlgError as error:
                    print(f"{title}: the adjustment that plants the effects ends ({error})", flush=True)
    listed = [rate for rate in rates(cases) if rate.of]
    for rate in listed:
        print(rate)
    return 0 if all(rate.met for rate in listed) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
