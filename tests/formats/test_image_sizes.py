"""All images of another size than most are named at once."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats.images import read_images


def test_all_odd_images_are_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for i, side in enumerate((40, 60, 60, 80, 60)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), rng.integers(0, 255, (30, side), dtype=np.uint8))
    with pytest.raises(InputError) as raised:
        read_images(sorted(tmp_path.glob("*.png"))).size  # noqa: B018
    text = str(raised.value)
    assert "0.png: error: this image is 40 x 30 pixels" in text and "3.png: error: this image is 80 x 30" in text
    assert text.count("error:") == 2 and "as 3 of 5 are" in text
