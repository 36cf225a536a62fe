"""Markers of Metashape become image points and targets; what is not measured is left out and counted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Metrocli = Callable[..., Any]
FILE = """<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
  <chunk label="Chunk 1" enabled="true">
    <sensors next_id="1"><sensor id="0" label="C" type="frame"/></sensors>
    <cameras next_id="2"><camera id="0" sensor_id="0" label="a b.jpg"/><group><camera id="7" label="c.jpg"/></group></cameras>
    <markers next_id="3" next_group_id="0">
      <marker id="0" label="target 1"><reference x="0.1" y="0.2" z="-0.3" enabled="true"/></marker>
      <marker id="2" label="P2"/>
    </markers>
    <frames next_id="1"><frame id="0"><markers>
      <marker marker_id="0">
        <location camera_id="0" pinned="true" x="100.5" y="20"/>
        <location camera_id="7" pinned="false" x="11" y="12"/>
      </marker>
      <marker marker_id="2"><location camera_id="7" pinned="true" x="3.25" y="0.5"/></marker>
    </markers></frame></frames>
  </chunk>
</document>
"""


def imported(folder: Path, metrocli: Metrocli, text: str, *options: str) -> Any:
    folder.mkdir(exist_ok=True)
    (folder / "m.xml").write_text(text)
    return metrocli("import", folder / "m.xml", "--from", "metashape-markers", "--out", folder / "out", *options)


def rows(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def test_pinned_markers_are_image_points(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = imported(tmp_path, metrocli, FILE, "--unit", "m")
    assert ran.code == 0, ran.err
    assert rows(tmp_path / "out" / "observations.csv") == [
        "image,target,u_px,v_px", "a b.jpg,target 1,100.0,19.5", "c.jpg,P2,2.75,0.0",
    ]  # fmt: skip
    assert rows(tmp_path / "out" / "targets.csv") == ["target,x_m,y_m,z_m", "target 1,0.1,0.2,-0.3"]
    assert "1 places that are not pinned are left out" in ran.err


def test_without_a_unit_places_are_not_written(tmp_path: Path, metrocli: Metrocli) -> None:
    assert imported(tmp_path, metrocli, FILE).code == 0
    assert not (tmp_path / "out" / "targets.csv").exists()


def test_longitudes_are_no_lengths(tmp_path: Path, metrocli: Metrocli) -> None:
    """They were written as x_m and y_m."""
    base = 'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,298.257223563]]'
    for system, code in (
        (f"{base}]", 3),
        (f'PROJCS["WGS 84 / UTM zone 32N",{base}]]', 0),
        ('LOCAL_CS["Local Coordinates (m)"]', 0),
    ):
        text = FILE.replace("    <frames", f"    <reference>{system}</reference>\n    <frames")
        ran = imported(tmp_path / str(len(system)), metrocli, text, "--unit", "m")
        assert (ran.code, "longitude and latitude" in ran.err) == (code, code == 3), ran.err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('x="3.25"', 'x="3,25"', "marker 'P2' in camera 7: x or y is not a number"),
        ('marker_id="2"><location camera_id="7"', 'marker_id="2"><location camera_id="9"', "which the file does not list"),
        ('pinned="true"', 'pinned="false"', "no marker is measured in an image"),
        ('label="P2"', 'label="target 1"', "markers with one label: target 1"),
        ('label="c.jpg"', 'label="a b.jpg"', "cameras with one label: a b.jpg"),
        ('camera_id="7" pinned="false"', 'camera_id="0" pinned="true"', "image points that are there twice: a b.jpg/target 1"),
        ("</document>", "", "this is not XML"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(old: str, new: str, words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    ran = imported(tmp_path, metrocli, FILE.replace(old, new))
    assert (ran.code, words in ran.err) == (3, True), ran.err
    assert not (tmp_path / "out").exists()


def test_the_format_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "m.xml").write_text(FILE)
    assert "--from metashape-markers" in metrocli("import", tmp_path / "m.xml").err
