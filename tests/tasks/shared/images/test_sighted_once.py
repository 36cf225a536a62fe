"""Images are searched for targets once, however often the tables beside them are read in another way."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats.images import read_images
from metrocli.targets.pattern import Pattern
from metrocli.tasks.shared.images.search import sight

DOT = Pattern(type="dot", diameter=5.0, polarity="bright")


def dot(path: Path, u: float, v: float) -> Path:
    """Write an image of 80 x 60 pixels with a bright dot of 9 pixels radius about a centre; edges 2 pixels wide."""
    x, y = np.meshgrid(np.arange(80), np.arange(60))
    inside = np.clip((9.0 - np.hypot(x - u, y - v)) / 2 + 0.5, 0, 1)
    cv2.imwrite(str(path), (40 + 160 * inside).astype(np.uint8))
    return path


def test_the_same_images_are_searched_once_and_changed_ones_again(tmp_path: Path) -> None:
    path = dot(tmp_path / "a.png", 30, 25)
    images = read_images([path])
    first, _ = sight(images, DOT)
    assert np.allclose([first.numbers("u")[0], first.numbers("v")[0]], [30, 25], atol=0.05)
    path.unlink()
    assert sight(images, DOT)[0] is first
    changed = read_images([dot(path, 42, 31)])
    assert np.allclose(sight(changed, DOT)[0].numbers("u"), 42, atol=0.05)
    path.unlink()
    with pytest.raises(InputError):
        sight(images, DOT)


def test_images_that_cannot_be_read_are_searched_once(tmp_path: Path) -> None:
    whole, damaged = dot(tmp_path / "a.png", 30, 25), dot(tmp_path / "b.png", 31, 25)
    data = bytearray(damaged.read_bytes())
    at = data.index(b"IDAT") + 4
    data[at : at + 8] = bytes(8)
    damaged.write_bytes(data)
    images = read_images([whole, damaged])
    with pytest.raises(InputError, match=r"b\.png: error: the image cannot be decoded"):
        sight(images, DOT)
    whole.unlink()
    with pytest.raises(InputError, match=r"b\.png: error: the image cannot be decoded"):
        sight(images, DOT)
