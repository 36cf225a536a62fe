"""A board that is not the one of the job is named from three images; unfit images alone stop no search."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats.images import DecodedImages, read_images
from metrocli.targets.find import FoundTargets, find
from metrocli.targets.pattern import Pattern
from metrocli.tasks.shared.images import search

CHESS = Pattern("chessboard", columns=7, rows=5, pitch=25.0)
OTHERS = (
    Pattern("charuco", columns=7, rows=5, pitch=25.0, marker_size=18.0, dictionary="4x4_50"),
    Pattern("aprilgrid", columns=4, rows=3, pitch=26.0, marker_size=20.0),
    Pattern("circles", columns=7, rows=5, pitch=25.0, diameter=12.0),
    Pattern("chessboard", columns=6, rows=5, pitch=25.0),
)


def images(folder: Path, blank: tuple[int, ...] = ()) -> DecodedImages:
    """Write nine images of a chessboard of 7 x 5 corners, each shifted a little; some blank."""
    squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.full((40, 40), 210)).astype(np.uint8) + 20
    for number in range(9):
        picture = cv2.copyMakeBorder(squares, 60 + number, 60, 60, 60 + number, cv2.BORDER_CONSTANT, value=230)
        picture = picture * 0 + 100 + number if number in blank else cv2.GaussianBlur(picture, (0, 0), 1.0)
        cv2.imwrite(str(folder / f"v{number}.png"), cv2.resize(picture, (440, 360)))
    return read_images(sorted(folder.glob("*.png")))


@pytest.mark.parametrize(
    "pattern",
    [OTHERS[0], *(pytest.param(pattern, marks=pytest.mark.slow) for pattern in OTHERS[1:])],
    ids=[pattern.type for pattern in OTHERS],
)
def test_three_images_name_the_board(pattern: Pattern, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sought = list[int]()

    def counted(wanted: Pattern, picture: np.ndarray) -> FoundTargets:  # type: ignore[type-arg]
        sought.append(1)
        return find(wanted, picture)

    monkeypatch.setattr(search, "find", counted)
    with pytest.raises(InputError, match=r"v0.png, v4.png.* v8.png.*columns: 7, rows: 5\?") as error:
        search.sight(images(tmp_path), pattern)
    assert len(sought) == 3
    assert ("type: chessboard" in str(error.value)) == (pattern.type != "chessboard")


def test_unfit_images_at_these_places_stop_no_search(tmp_path: Path) -> None:
    table, warnings = search.sight(images(tmp_path, blank=(0, 4, 8)), CHESS)
    assert len(set(table.texts("image"))) == 6 and len(warnings) == 3
