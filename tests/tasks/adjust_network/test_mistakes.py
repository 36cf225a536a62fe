"""Mistakes in the files of a network: names and signs exchanged, angles of another sort."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import NOISE, Network, network, polar

from metrocli.diagnosis.adjusted_job import AdjustedJob, Misfit
from metrocli.diagnosis.corrections import Mistake
from metrocli.diagnosis.trials import Trial, adjusted_trials
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.adjust_network.other_settings import other_settings

Metrocli = Callable[..., Any]


def proposed(net: Network, folder: Path) -> list[str]:
    return [mistake.words for mistake, _ in other_settings(content(load(net.write(folder))), False)]


def test_exchanged_points_are_proposed_at_their_station(tmp_path: Path) -> None:
    net = network(np.random.default_rng(51), 4, 15)
    point = net.point.copy()
    here = net.station == 2
    point[here & (net.point == 3)], point[here & (net.point == 9)] = 9, 3
    found = proposed(replace(net, point=point), tmp_path)
    assert [one for one in found if "exchanged" in one] == ["P004 and P010 are exchanged at station S3"]
    assert not [one for one in proposed(net, tmp_path) if "exchanged" in one]


@pytest.mark.parametrize(("listed", "faces", "station"), [(True, 1, "S2"), (True, 2, "S2"), (False, 1, "S1 or S2")])
def test_points_exchanged_at_one_of_two_stations_are_proposed(
    listed: bool, faces: int, station: str, tmp_path: Path
) -> None:
    """With their own sightings, points of two stations stand half the way; a list decides which one is right."""
    net = network(np.random.default_rng(58), 2, 12, faces=faces, listed=listed)
    point, here = net.point.copy(), net.station == 1
    point[here & (net.point == 3)], point[here & (net.point == 9)] = 9, 3
    found = proposed(replace(net, point=point), tmp_path)
    assert [one for one in found if "exchanged" in one] == [f"P004 and P010 are exchanged at station {station}"]


def test_one_row_with_another_name_is_not_called_exchanged(tmp_path: Path) -> None:
    net = network(np.random.default_rng(59), 3, 12)
    kept = ~((net.station == 2) & (net.point == 9))
    point = np.where((net.station == 2) & (net.point == 3), 9, net.point)[kept]
    net = replace(net, station=net.station[kept], point=point, face=net.face[kept], seen=net.seen[kept])
    found = proposed(net, tmp_path)
    assert not [one for one in found if "exchanged" in one]
    assert [one for one in found if "P010" in one] == ["P010 at station S3 is P004, line 29"]


def test_a_height_of_the_wrong_sign_is_proposed_with_its_line(tmp_path: Path) -> None:
    net = network(np.random.default_rng(52), 3, 12, mixed=True)
    first, *rest = net.heights
    found = proposed(replace(net, heights=((*first[:2], -first[2]), *rest)), tmp_path)
    assert [one for one in found if "sign" in one] == [
        "the height difference from P001 to P005 has the wrong sign, line 2"
    ]
    assert not [one for one in proposed(net, tmp_path) if "sign" in one]


def test_raw_azimuths_of_face_2_are_proposed_with_their_number(tmp_path: Path) -> None:
    net = network(np.random.default_rng(55), 3, 12, faces=2)
    seen = net.seen.copy()
    seen[net.face == 2, 0] += np.pi
    found = proposed(replace(net, seen=seen, times=True, face=np.ones_like(net.face)), tmp_path)
    assert found[0] == "az of face 2 is raw, and face 2 is not marked, in 36 rows"
    assert not [one for one in proposed(net, tmp_path) if "face" in one]


def test_stations_that_stand_over_the_mark_of_the_other_are_proposed(tmp_path: Path) -> None:
    net = network(np.random.default_rng(56), 3, 12, levelled=True)
    (station, seen), below = np.nonzero(~np.eye(3, dtype=bool)), net.places - [0.0, 0.0, 900.0]
    away = np.einsum("nab,na->nb", net.rotations[station], below[seen] - net.places[station])
    net = replace(
        net,
        points=np.concatenate([net.points, below]),
        near=np.concatenate([net.near, below]),
        station=np.concatenate([net.station, station]),
        point=np.concatenate([net.point, 12 + seen]),
        face=np.ones(len(net.face) + 6, dtype=int),
        seen=np.concatenate([net.seen, polar(away)]),
    )
    job = net.write(tmp_path)
    for marks, words in (((13, 14, 15), []), ((13, 15, 14), ["S2 and S3 are exchanged"])):
        rows = [f"S{i + 1},A,P{mark:03d},900" for i, mark in enumerate(marks)]
        (tmp_path / "stations.csv").write_text("\n".join(["station,instrument,over,height_mm", *rows]))
        found = [mistake.words for mistake, _ in other_settings(content(load(job)), False)]
        assert [one for one in found if "exchanged" in one] == words


def test_nothing_is_proposed_for_readings_that_fit(tmp_path: Path) -> None:
    job = content(load(network(np.random.default_rng(53)).write(tmp_path)))
    assert list(other_settings(job, True)) == []


@pytest.mark.parametrize(
    ("header", "words"),
    [("az_rad,zd_rad,d_mm", "zd is an elevation"), ("az_rad,el_rad,d_m", "d_m is in mm")],
)
def test_a_mistake_is_found_and_its_correction_fits(
    header: str, words: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    job = network(np.random.default_rng(54), 3, 12).write(tmp_path, header=header)
    ran = metrocli("diagnose", job, "--json")
    found = json.loads(ran.out)
    assert (found["verdict"], found["mistake"]["what"]) == ("mistaken", words)


@pytest.mark.slow
def test_exchanged_points_are_found_beside_one_that_moved(tmp_path: Path, metrocli: Metrocli) -> None:
    """A point that moved calls for a robust start: the steps of a try last for it and for the adjustment."""
    net = network(np.random.default_rng(57), 4, 20, faces=2)
    point, moved = net.point.copy(), (net.station > 1) & (net.point == 16)
    here = net.station == 2
    point[here & (net.point == 3)], point[here & (net.point == 9)] = 9, 3
    change = np.where(moved[:, None], [5e-5, 0.0, 0.15], 0.0)
    ran = metrocli("adjust-network", replace(net, point=point).with_effect(change).write(tmp_path))
    assert ran.code == 3 and "P004 and P010 are exchanged at station S3" in ran.err, ran.err


def test_no_other_reading_of_the_files_is_tried_for_motions_that_the_job_leaves_open(
    tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tried(*_: object) -> None:
        raise AssertionError("a correction is tried")

    monkeypatch.setattr("metrocli.diagnosis.mistakes.adjusted_trials", tried)
    job = network(np.random.default_rng(60), 4, 15).write(tmp_path, more="datum_points: [P001, P002]\n")
    ran = metrocli("adjust-network", job)
    assert ran.code == 4 and "`datum_points` leave open" in ran.err, ran.err


def flipped(net: Network, stations: list[int], column: int) -> Network:
    seen = net.seen.copy()
    seen[np.isin(net.station, stations), column] *= -1
    return replace(net, seen=seen)


@pytest.mark.parametrize("column", [0, 1])
@pytest.mark.parametrize(
    ("count", "stations", "named"),
    [(4, [2], ["S3"]), (5, [1, 4], ["S2 and S5"]), (2, [1], ["S1", "S2"]), (3, [0, 1, 2], [])],
)
def test_stations_that_see_the_points_mirrored_are_proposed(
    count: int, stations: list[int], named: list[str], column: int, tmp_path: Path
) -> None:
    """Azimuths of the other sense and elevations of the other sign make the same mirror image."""
    net = network(np.random.default_rng(61), count, 14)
    # a gross error, which does not hide it
    seen = net.seen.copy()
    seen[5, 2] += 40.0
    found = proposed(flipped(replace(net, seen=seen), stations, column), tmp_path)
    expected = {
        words for of in named for words in (f"az of {of} counts the other way", f"el of {of} has the wrong sign")
    }
    assert {words for words in found if " of S" in words} == expected


ONE_SORT = {
    "az is in gon": ("az_deg,el_rad,d_mm", 0, lambda v: v / 0.9, "az of S3 is in gon"),
    "el is in gon": ("az_rad,el_deg,d_mm", 1, lambda v: v / 0.9, "el of S3 is in gon"),
    "zenith distances": ("az_rad,el_rad,d_mm", 1, lambda v: np.pi / 2 - v, "el of S3 is a zenith distance"),
    "elevations": ("az_rad,zd_rad,d_mm", 1, lambda v: np.pi / 2 - v, "zd of S3 is an elevation"),
    "zd is in gon": ("az_rad,zd_deg,d_mm", 1, lambda v: v / 0.9, "zd of S3 is in gon"),
    "metres": ("az_rad,el_rad,d_mm", 2, lambda v: v / 1000, "d of S3 is in m"),
    "inches": ("az_rad,el_rad,d_mm", 2, lambda v: v / 25.4, "d of S3 is in inches"),
    "feet": ("az_rad,el_rad,d_mm", 2, lambda v: v / 304.8, "d of S3 is in ft"),
    "millimetres": ("az_rad,el_rad,d_m", 2, lambda v: v * 1000, "d of S3 is in mm"),
    "radians": ("az_deg,el_rad,d_mm", 0, np.radians, "az of S3 is in rad"),
}
IN_HEADING = {"deg": np.degrees, "m": lambda v: v / 1000}


@pytest.mark.parametrize("sort", ONE_SORT)
def test_a_station_with_readings_of_another_sort_is_proposed(sort: str, tmp_path: Path) -> None:
    header, column, other, words = ONE_SORT[sort]
    net = network(np.random.default_rng(65), 4, 14)
    right = net.seen.copy()
    for at, name in enumerate(header.split(",")):
        right[:, at] = np.pi / 2 - right[:, at] if name.startswith("zd") else right[:, at]
        right[:, at] = IN_HEADING.get(name.partition("_")[2], np.asarray)(right[:, at])
    seen, here = right.copy(), net.station == 2
    seen[here, column] = other(seen[here, column])
    found = [
        (mistake.words, job.files.sightings)
        for mistake, job in other_settings(content(load(replace(net, seen=seen).write(tmp_path, header=header))), False)
        if " of S" in mistake.words
    ]
    assert [one for one, _ in found] == [words]
    name, _, unit = header.split(",")[column].partition("_")
    assert IN_HEADING.get(unit, np.asarray)(found[0][1].numbers(name)) == pytest.approx(right[:, column], rel=1e-9)


@pytest.mark.parametrize(("stations", "words"), [([1], "d of S2 is in m: "), ([1, 2], "d of S2 and S3 is in m: ")])
def test_the_stations_with_distances_in_metres_are_named(
    stations: list[int], words: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    """Without a list of points those in mm fit as well in um: they had been named."""
    net = network(np.random.default_rng(61), 3 if stations[1:] else 2, 12, listed=False)
    seen = net.seen.copy()
    seen[np.isin(net.station, stations), 2] /= 1000
    ran = metrocli("adjust-network", replace(net, seen=seen).write(tmp_path))
    assert ran.code == 3 and words in ran.err and "um" not in ran.err, ran.err


def test_a_station_that_is_left_out_as_wrong_has_one_cause(tmp_path: Path, metrocli: Metrocli) -> None:
    """A quarter of all readings, but all of a station: 72 names had stood there, and no cause."""
    rng = np.random.default_rng(61)
    net = network(rng, 4, 12, faces=2)
    seen, here = net.seen.copy(), net.station == 2
    seen[here] = [1.0, 0.5, 2000.0] * rng.uniform(0.2, 1.0, (int(here.sum()), 3))
    ran = metrocli("adjust-network", replace(net, seen=seen).write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 4 and "So many have one cause: `metrocli diagnose` tries other units" in ran.err, ran.err


def other(net: Network, station: int, columns: list[int], factor: float) -> Network:
    seen, here = net.seen.copy(), net.station == station
    seen[np.ix_(here, columns)] *= factor
    return replace(net, seen=seen)


def of_stations(net: Network, folder: Path, header: str = "az_rad,el_rad,d_mm") -> list[str]:
    job = content(load(net.write(folder, header=header)))
    return [mistake.words for mistake, _ in other_settings(job, False) if " of S" in mistake.words]


def test_a_station_of_which_all_distances_are_left_out_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    """It was "the data cannot determine the unknowns", with the distances that were left out."""
    metrocli("init", tmp_path / "p", "--sample", "hall-trackers")
    file, job = tmp_path / "p" / "data" / "readings.csv", tmp_path / "p" / "jobs" / "hall.yaml"
    head, *lines = file.read_text().splitlines()
    at = head.split(",").index("d_mm")
    cells = [line.split(",") for line in lines]
    wrong = [[*c[:at], f"{float(c[at]) / 1000:.9f}", *c[at + 1 :]] if c[0] == "S4" else c for c in cells]
    file.write_text("\n".join([head, *map(",".join, wrong)]) + "\n")
    job.write_text(f"{job.read_text()}outliers: remove\n")
    ran = metrocli("adjust-network", job)
    assert ran.code == 3 and "write d of S4 times 1000" in ran.err, ran.err


def test_both_angles_of_a_station_in_gon_are_one_mistake(tmp_path: Path) -> None:
    net = network(np.random.default_rng(66), 4, 14)
    in_degrees = replace(net, seen=np.column_stack([np.degrees(net.seen[:, :2]), net.seen[:, 2]]))
    found = of_stations(other(in_degrees, 2, [0, 1], 1 / 0.9), tmp_path, "az_deg,el_deg,d_mm")
    assert found == ["az and el of S3 are in gon"]


def test_a_station_in_mm_under_a_heading_in_m_is_in_mm(tmp_path: Path) -> None:
    """It was in um."""
    net = network(np.random.default_rng(67), 4, 14)
    in_metres = replace(net, seen=net.seen / [1, 1, 1000])
    assert of_stations(other(in_metres, 1, [2], 1000.0), tmp_path, "az_rad,el_rad,d_m") == ["d of S2 is in mm"]


def test_stations_in_a_row_that_share_points_with_their_neighbours_alone(tmp_path: Path) -> None:
    """Nothing was named: no station shares points with all others."""
    net = network(np.random.default_rng(68), 6, 36)
    near = (net.point // 6 >= net.station - 1) & (net.point // 6 <= net.station)
    row = replace(net, station=net.station[near], point=net.point[near], face=net.face[near], seen=net.seen[near])
    assert of_stations(other(row, 2, [2], 1e-3), tmp_path) == ["d of S3 is in m"]
    assert not of_stations(row, tmp_path)


def test_distances_to_points_in_a_plane_have_a_unit_too(tmp_path: Path) -> None:
    net = network(np.random.default_rng(63), 3, 14)
    flat = net.points * [1.0, 1.0, 0.0] + [0.0, 0.0, 1200.0]
    away = np.einsum("nab,na->nb", net.rotations[net.station], flat[net.point] - net.places[net.station])
    assert of_stations(other(replace(net, points=flat, seen=polar(away)), 1, [2], 1e-3), tmp_path) == [
        "d of S2 is in m"
    ]


def test_a_station_that_moved_is_of_no_other_sort(tmp_path: Path) -> None:
    net = network(np.random.default_rng(69), 4, 14)
    seen, late = net.seen.copy(), np.flatnonzero(net.station == 1)[7:]
    seen[late] += [0.05, 0.0, 30.0]
    assert not of_stations(replace(net, seen=seen), tmp_path)


def test_a_levelled_station_has_no_elevations_of_the_wrong_sign(tmp_path: Path) -> None:
    net = network(np.random.default_rng(62), 3, 14, levelled=True)
    found = proposed(flipped(net, [1], 0), tmp_path)
    assert [words for words in found if " of S" in words] == ["az of S2 counts the other way"]


def test_points_in_a_plane_show_no_mirror_image(tmp_path: Path) -> None:
    net = network(np.random.default_rng(63), 3, 14)
    flat = net.points * [1.0, 1.0, 0.0] + [0.0, 0.0, 1200.0]
    away = np.einsum("nab,na->nb", net.rotations[net.station], flat[net.point] - net.places[net.station])
    found = proposed(flipped(replace(net, points=flat, seen=polar(away)), [1], 0), tmp_path)
    assert not [words for words in found if " of S" in words]


def test_a_mirrored_station_is_refused_with_what_to_write(tmp_path: Path, metrocli: Metrocli) -> None:
    """It was doubtful after 12 s: "no other unit or axis mends it"."""
    net = flipped(network(np.random.default_rng(64), 3, 12), [1], 0)
    ran = metrocli("adjust-network", net.write(tmp_path))
    assert ran.code == 3 and "az of S2 counts the other way" in ran.err, ran.err
    assert "write az of S2 with the other sign; as good: " in ran.err and "el of S2 has the wrong sign" in ran.err


def test_where_set_ups_differ_in_shape_only_their_readings_are_tried(
    tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names of points without order: no list of stations or points makes the distances between them agree."""
    tried = []

    def noted(trials: Iterable[Trial]) -> Iterator[tuple[Mistake, Misfit, AdjustedJob]]:
        every = list(trials)
        tried.extend(mistake.input for mistake, _ in every)
        return adjusted_trials(every[:0])

    monkeypatch.setattr("metrocli.diagnosis.mistakes.adjusted_trials", noted)
    rng = np.random.default_rng(61)
    net = network(rng, 3, 12)
    point = np.concatenate([rng.permutation(net.point[net.station == station]) for station in range(3)])
    ran = metrocli("adjust-network", replace(net, point=point).write(tmp_path))
    assert ran.code == 5 and "set-ups contradict each other" in ran.err, ran.err
    assert set(tried) == {"readings"}


def test_one_angle_of_all_stations_in_gon_is_proposed(tmp_path: Path) -> None:
    """Both together alone were tried."""
    net = network(np.random.default_rng(71), 3, 14)
    seen = np.column_stack([np.degrees(net.seen[:, 0]) / 0.9, net.seen[:, 1:]])
    job = content(load(replace(net, seen=seen).write(tmp_path, header="az_deg,el_rad,d_mm")))
    assert "az is in gon" in [mistake.words for mistake, _ in other_settings(job, False)]


def test_an_instrument_at_most_stations_that_sees_the_points_mirrored_is_proposed(tmp_path: Path) -> None:
    """Only the stations of the minority were, with which the list of points then stands mirrored."""
    net = flipped(network(np.random.default_rng(72), 5, 14), [0, 1, 2], 0)
    job, stations = net.write(tmp_path), tmp_path / "stations.csv"
    stations.write_text(stations.read_text().replace("S4,A", "S4,B").replace("S5,A", "S5,B"))
    first = next(line for line in job.read_text().splitlines() if line.startswith("  A: "))
    job.write_text(job.read_text().replace(first, f"{first}\n{first.replace('A:', 'B:')}"))
    found = [mistake.words for mistake, _ in other_settings(content(load(job)), False)]
    assert "az of S1, S2 and S3 counts the other way" in found


@pytest.mark.parametrize("mixed", [pytest.param(True, marks=pytest.mark.slow), False])
def test_points_exchanged_in_all_sightings_are_named_where_others_name_points_too(
    mixed: bool, tmp_path: Path, metrocli: Metrocli
) -> None:
    """A bar was wrong by its length, beside three wrong readings; without others the list is as likely."""
    net = network(np.random.default_rng(74), 3, 11, mixed=mixed)
    point = np.where(net.point == 2, 9, np.where(net.point == 9, 2, net.point))
    found = json.loads(metrocli("diagnose", replace(net, point=point).write(tmp_path), "--json").out)["mistake"]
    assert found["what"] == "P003 and P010 are exchanged"
    files = [found["file"], *(one["file"] for one in found["alternatives"])]
    assert files == (["readings"] if mixed else ["points", "readings"])


def test_exchanged_points_are_found_where_a_mirror_image_is_as_far_off(tmp_path: Path, metrocli: Metrocli) -> None:
    """The interferometer had "two places that fit alike": none of them fitted."""
    rng = np.random.default_rng(75)
    net = network(rng, 3, 16, faces=2, mixed=True)
    net = replace(net, given=(), tracers=net.tracers[:1], lengths=net.lengths[:1])
    point, here = net.point.copy(), net.station == 1
    point[here & (net.point == 3)], point[here & (net.point == 9)] = 9, 3
    found = json.loads(metrocli("diagnose", replace(net, point=point).write(tmp_path), "--json").out)
    assert found["mistake"]["what"] == "P004 and P010 are exchanged at station S2"


def sexagesimal(angles: list[float]) -> list[float]:
    """Degrees, minutes and seconds as one number: 12.3045 for 12 deg 30' 45"."""
    found = []
    for angle in np.degrees(angles).tolist():
        seconds = round(abs(angle) * 3600, 5)
        degrees, rest = divmod(seconds, 3600)
        minutes, seconds = divmod(rest, 60)
        found.append(float(np.copysign(degrees + minutes / 100 + seconds / 10000, angle)))
    return found


def test_horizontal_distances_are_named(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(71), 3, 12, levelled=True)
    level = np.ones_like(net.seen)
    level[:, 2] = np.cos(net.seen[:, 1])
    ran = metrocli("adjust-network", replace(net, seen=net.seen * level).write(tmp_path))
    assert ran.code == 3 and "d is a horizontal distance: with this corrected" in ran.err, ran.err


def test_a_mistake_at_one_station_that_leaves_most_readings_plausible_is_named(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    rough = "{azimuth: 800 urad, elevation: 800 urad, lateral: 1.6 mm, distance: {constant: 0.8 mm, proportional: 0.12 mm/m}}"
    net = network(np.random.default_rng(76), 4, 11, levelled=True, noise=400.0)
    seen = net.seen.copy()
    here = net.station == 2
    seen[here, 2] *= np.cos(seen[here, 1])
    for one, code in ((net, 0), (replace(net, seen=seen), 6)):
        job = one.write(tmp_path)
        job.write_text(job.read_text().replace(NOISE, rough))
        ran = metrocli("adjust-network", job, "--force")
        assert ran.code == code, ran.err
    assert "d is a horizontal distance at station S3: with this corrected, the squared residuals are" in ran.out
    assert "write d over the sine of the zenith distance at station S3" in ran.out


def test_minutes_and_seconds_as_decimals_are_named(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(72), 3, 12, levelled=True)
    seen = net.seen.copy()
    seen[:, 0], seen[:, 1] = (sexagesimal(seen[:, k].tolist()) for k in range(2))
    ran = metrocli("adjust-network", replace(net, seen=seen).write(tmp_path, header="az_deg,el_deg,d_mm"))
    assert ran.code == 3 and "az and el have minutes and seconds as decimals (D.MMSS)" in ran.err, ran.err
