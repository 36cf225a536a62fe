"""What the tests of targets share."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def few_dictionaries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search markers of few dictionaries: all take seconds an image. The hints of a ChArUco board are tested with all."""
    monkeypatch.setattr("metrocli.targets.charuco.DICTIONARIES", ("4x4_250", "5x5_250"))
