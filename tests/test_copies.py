"""Blocks of readings that stand in a file twice are found; readings that are equal by rounding are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats import csv, images
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.files import LINES, POINTS, TRACK
from metrocli.tasks.locate_launch_unit.readings import POSES
from metrocli.tasks.multilaterate.settings import LENGTHS
from metrocli.tasks.selfcal_grid.settings import VIEWS
from metrocli.tasks.shared.images.search import OBSERVATIONS

Rows = list[list[object]]
CHANCE = np.random.default_rng(2053)


def draws(*shape: int, digits: int = 4) -> list[list[float]]:
    found: list[list[float]] = CHANCE.normal(scale=10, size=shape).round(digits).tolist()
    return found


def views() -> Rows:
    return [[f"img{k}", f"M{m}", *uv] for k in range(3) for m, uv in enumerate(draws(12, 2, digits=2))]


def grid() -> Rows:
    return [
        [f"{v}", i, j, 0, *xyz] for v in range(3) for (i, j), xyz in zip(np.ndindex(3, 3), draws(9, 3), strict=True)
    ]


def lines() -> Rows:
    return [[f"x{k}", "x", 50.0 * i, *six] for k in range(3) for i, six in enumerate(draws(5, 6))]


HEADS: dict[str, tuple[object, str, Callable[[], Rows]]] = {
    "views": (OBSERVATIONS, "image,target,u_px,v_px", views),
    "grid": (VIEWS, "view,i,j,k,x_mm,y_mm,z_mm", grid),
    "lines": (LINES, "line,axis,position_mm,ex_um,ey_um,ez_um,ea_urad,eb_urad,ec_urad", lines),
    "stops": (
        POINTS,
        "point,x_mm,y_mm,z_mm,mx_mm,my_mm,mz_mm",
        lambda: [[f"P{k}", 10 * k, 0, 0, *m] for k, m in enumerate(draws(20, 3))],
    ),
    "lengths": (
        LENGTHS,
        "point,tracer,length_mm",
        lambda: [[f"P{p}", f"T{t}", x] for p, row in enumerate(draws(30, 4)) for t, x in enumerate(row)],
    ),
    "poses": (
        POSES,
        "pose,x_mm,y_mm,z_mm,spindle_deg,phi1_deg,phi2_deg,phi3_deg,phi4_deg",
        lambda: [[f"Q{k}", *row] for k, row in enumerate(draws(12, 8))],
    ),
    "track": (TRACK, "x_mm,y_mm,z_mm", lambda: [list(row) for row in draws(400, 3)]),
}  # fmt: skip


def read(tmp_path: Path, kind: str, rows: Rows) -> Table:
    columns, head, _ = HEADS[kind]
    path = tmp_path / "file.csv"
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return csv.read(path, columns)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", HEADS)
def test_a_copied_block_is_refused_and_a_whole_file_is_not(kind: str, tmp_path: Path) -> None:
    columns, _, rows = HEADS[kind]
    made = rows()
    assert len(read(tmp_path, kind, made)) == len(made)
    size = {"views": 12, "grid": 9, "lines": 5, "track": 100}.get(kind, len(made) * 2 // 3)
    again = [[f"copy{row[0]}" if isinstance(row[0], str) else row[0], *row[1:]] for row in made[:size]]
    with pytest.raises(InputError) as told:
        read(tmp_path, kind, made + again)
    text = str(told.value)
    assert "remove the copy" in text
    if getattr(columns, "group", ()):
        assert f"{made[0][0]}, copy{made[0][0]}: the readings are the same" in text
    else:
        assert text.startswith(f"{tmp_path / 'file.csv'}:{len(made) + 2}: error: {size} rows repeat line 2")


@pytest.mark.parametrize("kind", ["views", "grid"])
def test_a_copy_in_another_order_is_found(kind: str, tmp_path: Path) -> None:
    made = HEADS[kind][2]()
    first = [row for row in made if row[0] == made[0][0]]
    again = [[f"copy{row[0]}", *row[1:]] for row in reversed(first)]
    mixed = [row for pair in zip(first, again, strict=True) for row in pair] + made[len(first) :]
    with pytest.raises(InputError, match="the readings are the same, value for value"):
        read(tmp_path, kind, mixed)


def test_rounded_readings_of_one_place_are_no_copies(tmp_path: Path) -> None:
    """Single lengths read many times, rounded to three values: their order repeats by chance only."""
    for seed in range(40):
        chance = np.random.default_rng(seed)
        values = (chance.normal(scale=0.6, size=400).round() / 1000 + 500).tolist()
        rows: Rows = [[f"P{k}", "T1", value] for k, value in enumerate(values)]
        assert len(read(tmp_path, "lengths", rows)) == 400


def test_an_instrument_at_rest_makes_no_copies(tmp_path: Path) -> None:
    chance = np.random.default_rng(9)
    rest = (chance.normal(scale=0.4, size=(3000, 3)).round() / 1000 + [1, 2, 3]).tolist()
    still = [[5.0, 5.0, 5.0]] * 500
    assert len(read(tmp_path, "track", [*draws(200, 3), *rest, *draws(200, 3), *still])) == 3900


def test_one_point_measured_again_with_the_same_lengths_is_no_copy(tmp_path: Path) -> None:
    made = HEADS["lengths"][2]()
    assert len(read(tmp_path, "lengths", [*made, *[["back", *row[1:]] for row in made[:4]]])) == 124


def test_an_image_that_is_a_copy_is_refused(tmp_path: Path) -> None:
    for name, grey in (("a.png", 10), ("b.png", 20), ("c.png", 10)):
        images.write(tmp_path / name, np.full((40, 50), grey, dtype=np.uint8))
    with pytest.raises(InputError, match=r"c.png: error: this image is a copy of a.png, byte for byte"):
        images.read_images([tmp_path / name for name in ("a.png", "b.png", "c.png")])
    assert len(images.read_images([tmp_path / name for name in ("a.png", "b.png")]).names) == 2
