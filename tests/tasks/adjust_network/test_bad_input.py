"""What a network refuses, with the words that say what would help."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
JOB = """\
metrocli: 1
job: adjust-network
inputs: {{readings: readings.csv, stations: stations.csv{more}}}
instruments:
  LT1: {{type: tracker, noise: {{azimuth: 2 urad, elevation: 2 urad, lateral: 4 um, distance: {{constant: 2 um}}}}}}
  TS1: {{type: total-station, noise: {{azimuth: 2 urad, elevation: 2 urad, distance: {{constant: 0.3 mm}}}}}}
  IF1: {{type: interferometer, noise: {{distance: {{constant: 0.3 um}}}}}}
  BARE: {{type: tracker}}
{keys}output: result.h5
"""
FOUR = "S1,A,0,0,1000\nS1,B,90,8.53,2022\nS1,C,45,5,3000\nS1,D,10,-20,1500\n"
POLAR = "station,point,az_deg,el_deg,d_mm\n"
POINTS = "point,x_mm,y_mm,z_mm,sigma_mm\nA,1000,0,0,0.1\nB,0,2000,300,0.1\n"
SQUARE = "point_a,axis_a,point_b,axis_b,covariance_mm2\nA,x,A,x,0.01\nA,y,A,y,0.01\nA,x,A,y,0.02\n"
CASES: dict[str, tuple[int, str, dict[str, str], str, str]] = {
    # exit code, words, files beside S1 of LT1, further keys of the job, further inputs
    "both of a pair": (3, "both 'az' and 'hz'", {"readings": "station,point,az_deg,hz_deg,d_mm\nS1,A,1,1,1\n"}, "", ""),
    "face": (3, "the face is 1 or 2", {"readings": "station,point,az_deg,el_deg,d_mm,face\nS1,A,1,1,9,3\n"}, "", ""),
    "distance": (3, "a distance is not above zero", {"readings": POLAR + "S1,A,1,1,-5\n"}, "", ""),
    "station": (3, "'S9' is not in the stations", {"readings": POLAR + "S9,A,1,1,5\n"}, "", ""),
    "exact": (3, "no standard deviation", {"readings": POLAR + FOUR, "stations": "station,instrument\nS1,BARE\n"}, "", ""),
    "datum point twice": (3, "named more than once: A", {"readings": POLAR + FOUR}, "datum_points: [A, B, A, C]\n", ""),
    "one datum point": (
        4, "`datum_points` leave open: rotation about x, rotation about y and rotation about z", {"readings": POLAR + FOUR}, "datum_points: [A]\n", "",
    ),
    "two datum points": (
        4, "Name more points", {"readings": POLAR + FOUR}, "datum_points: [A, B]\n", "",
    ),
    "negative sigmas": (
        3, "in column 'sigma_mm'", {"readings": POLAR + FOUR, "points": POINTS.replace(",0.1", ",-0.1")}, "",
        ", points: points.csv",
    ),
    "datum point": (3, "no file names the points X", {"readings": POLAR + FOUR}, "datum_points: [A, X]\n", ""),
    "covariance": (
        3, "not positive definite", {"readings": POLAR + FOUR, "points": POINTS, "covariance": SQUARE}, "",
        ", points: points.csv, covariance: covariance.csv",
    ),
    "over a mark": (
        3, "needs an instrument that is levelled",
        {"readings": POLAR + FOUR, "stations": "station,instrument,over,height_mm\nS1,LT1,A,100\n"}, "", "",
    ),
    "two shared points": (
        4, "it shares A, B with the rest; it needs three points",
        {"readings": POLAR + FOUR + "S2,A,0,0,1000\nS2,B,70,10,2000\n", "stations": "station,instrument\nS1,LT1\nS2,LT1\n"},
        "", "",
    ),
    "on a line": (
        4, "lie on a line",
        {
            "readings": POLAR + "S1,A,0,0,1000\nS1,B,0,0,2000\nS1,C,0,0,3000\nS1,D,10,-20,1500\n"
            "S2,A,0,0,1000\nS2,B,0,0,2000\nS2,C,0,0,3000\n",
            "stations": "station,instrument\nS1,LT1\nS2,LT1\n",
        },
        "", "",
    ),
    "angles alone": (4, "seen by angles of one station only: E", {"readings": POLAR + FOUR + "S1,E,1,2,\n"}, "", ""),
    "point of a bar": (
        4, "points have no place: X",
        {"readings": POLAR + FOUR, "bars": "bar,from,to,length_mm,sigma_mm\nB,A,X,5,0.1\n"}, "", ", bars: bars.csv",
    ),
    "few lengths": (
        4, "I1 reads 2 points; an interferometer needs 5",
        {
            "readings": POLAR + FOUR,
            "stations": "station,instrument\nS1,LT1\nI1,IF1\n",
            "lengths": "station,point,length_mm\nI1,A,1\nI1,B,2\n",
        },
        "", ", lengths: lengths.csv",
    ),
    "height without a tie": (
        4, "needs a tie",
        {
            "readings": "station,point,hz_gon,zd_gon,d_mm\nS1,A,0,90,10000\nS1,B,90,100,20000\nS1,C,45,95,30000\n",
            "stations": "station,instrument,over,height_mm,sigma_height_mm\nS1,TS1,M,1600,\n",
        },
        "", "",
    ),
    "given points": (
        4, "the given points leave open", {"readings": POLAR + FOUR, "points": POINTS}, "datum: given\n", ", points: points.csv"
    ),
    "a list that the datum leaves unused": (
        3, "these are of inner constraints", {"readings": POLAR + FOUR}, "datum: given\ndatum_points: [A]\n", ""
    ),
}  # fmt: skip


def test_what_an_interferometer_measures_is_no_key_of_a_tracker(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "readings.csv").write_text(POLAR + FOUR)
    (tmp_path / "stations.csv").write_text("station,instrument\nS1,LT1\n")
    job = JOB.format(keys="", more="").replace("{type: tracker, ", "{type: tracker, measures: absolute, ")
    (tmp_path / "job.yaml").write_text(job)
    ran = metrocli("check", tmp_path / "job.yaml")
    assert ran.code == 3 and "a tracker reads distances" in ran.err


@pytest.mark.parametrize("case", CASES)
def test_it_is_refused_in_words(case: str, tmp_path: Path, metrocli: Metrocli) -> None:
    code, words, files, keys, more = CASES[case]
    for name, text in {"stations": "station,instrument\nS1,LT1\n", **files}.items():
        (tmp_path / f"{name}.csv").write_text(text)
    (tmp_path / "job.yaml").write_text(JOB.format(keys=keys, more=more))
    ran = metrocli("adjust-network", tmp_path / "job.yaml")
    assert ran.code == code, ran.err
    assert words in ran.err
    assert not (tmp_path / "result.h5").exists()


def _of_bars(folder: Path, more: str) -> Path:
    """A job of listed points, and of a bar between two of them if `more` names it."""
    (folder / "stations.csv").write_text("station,instrument\nS1,LT1\n")
    (folder / "points.csv").write_text(POINTS + "C,0,1000,0,0.1\nD,0,0,9,\n")
    (folder / "bars.csv").write_text("bar,from,to,length_mm,sigma_mm\nL,A,B,2256.1,0.01\n")
    job = folder / "job.yaml"
    job.write_text(JOB.format(keys="", more=", points: points.csv" + more).replace("readings: readings.csv, ", ""))
    return job


def test_a_network_that_nothing_reads_is_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", _of_bars(tmp_path, ""))
    assert ran.code == 3 and "no input has a reading" in ran.err, ran.err


def test_a_listed_point_without_a_reading_has_no_uncertainty_of_0(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", _of_bars(tmp_path, ", bars: bars.csv"))
    assert ran.code == 0 and "2 points have no reading, and no row in /points: C, D" in ran.err, ran.err
    points = hdf5.read(tmp_path / "result.h5")[0].tables["points"]
    assert points.texts("point") == ["A", "B"]
    assert (points.stacked(("sx", "sy", "sz")) > 0).all()
