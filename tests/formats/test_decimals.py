"""Decimal numbers of whole columns: each must be the one that Python reads, to the last bit."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pytest

from metrocli.formats.csv_plain import decimals, plain_cells


def read(texts: list[str]) -> np.ndarray:
    cells = plain_cells("\n".join(texts), ",", 1)
    assert cells is not None
    numbers = cells.numbers(0)
    assert numbers is not None
    return numbers


def bits(values: object) -> list[int]:
    return np.asarray(values, dtype=float).view(np.int64).tolist()


@pytest.mark.parametrize("size", [1.0, 1e-9, 1e4, 1e13, 1e17])
@pytest.mark.parametrize("form", [repr, "{:.4f}".format, "{:+.8f}".format, "{:.17g}".format, "{:.6e}".format])
def test_numbers_are_those_of_python(size: float, form: object) -> None:
    drawn = np.random.default_rng(1).normal(size=20_000) * size
    texts = [form(value) for value in drawn.tolist()]  # type: ignore[operator]
    assert bits(read(texts)) == bits(list(map(float, texts)))


def test_a_number_in_the_middle_between_two_is_rounded_once() -> None:
    rng, texts = np.random.default_rng(2), list[str]()
    for value in rng.uniform(1, 1000, 2000).tolist():
        middle = (Decimal(value) + Decimal(float(np.nextafter(value, np.inf)))) / 2
        # 18 digits are near the middle, on either side of it
        texts += [f"{middle:.{16 - len(str(int(middle))) + 1}f}", f"{middle:.{18 - len(str(int(middle)))}f}"]
    assert bits(read(texts)) == bits(list(map(float, texts)))


def test_unusual_notations_of_numbers_are_read_as_well() -> None:
    texts = [
        "0",
        "-0",
        "+5",
        "-.5",
        "7.",
        "00012.50",
        "1e3",
        "-2.5E-7",
        "1234567890123456789",
        "0.00000000000000000012",
    ]
    assert bits(read(texts)) == bits(list(map(float, texts)))


@pytest.mark.parametrize("text", ["-", "+", ".", "-.", "1-2", "1.2.3", "--1", "1+", "nan", "1_0", "0x1", "5-", "-+5"])
def test_what_is_no_number_is_none(text: str) -> None:
    cells = plain_cells(f"1.5\n{text}\n22.75\n", ",", 1)
    assert cells is not None
    assert cells.numbers(0) is None


def test_most_cells_need_no_other_reader() -> None:
    texts = [repr(value) for value in np.random.default_rng(3).uniform(0, 2000, 20_000).tolist()]
    width = max(map(len, texts))
    letters = np.frombuffer("".join(text.rjust(width, "\0") for text in texts).encode(), dtype=np.uint8)
    sure = decimals(letters.reshape(-1, width))[1]
    if np.finfo(np.longdouble).nmant == 63:
        assert sure.mean() > 0.99
