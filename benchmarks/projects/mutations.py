"""Mutations of files: of their bytes, and of what is written there, which gets further."""

from __future__ import annotations

import random
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from resealing import resealed

Chance = random.Random
NUMBERS = (
    "0",
    "-1",
    "1",
    "1e160",
    "-1e160",
    "1e300",
    "1e308",
    "1e-150",
    "1e-320",
    "1e30",
    "1e-30",
    "1e20",
    "1e9",
    "nan",
    "inf",
    "-inf",
    "99999999999999999999",
    "1e5",
    "-0.0",
    "0.1",
    "1_000",
    "0x10",
    "\u0661",
    "1,5",
)
WORDS = (
    "",
    "~",
    "null",
    "[]",
    "{}",
    "[[]]",
    "true",
    "..",
    "../..",
    "/",
    ".",
    "/dev/zero",
    "/dev/full",
    "*",
    "**/*",
    "\u00e4",
    "a/b",
    "{part}",
    "'",
    '"',
    "&a",
    "*a",
    "!!x",
    "estimated",
    "structured",
    "all",
    "x" * 300,
    "\u202e",
    "\u0000",
)
PIECES = (
    ": ",
    "\n",
    "  ",
    "[",
    "]",
    "{",
    "}",
    "- ",
    "'",
    '"',
    "&a",
    "*a",
    "!!x",
    "|",
    ">",
    "?",
    "#",
    ",",
    "\t",
    "0",
    "nan",
    "\u00b5",
    "\0",
    "---\n",
    "~",
    "<<",
    "%",
    "\u2028",
    "\ufeff",
    ";",
    "\r",
    "\u00e9",
)
_NUMBER = re.compile(r"(?<![\w.])[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?")
KEYS = (
    "effects",
    "require",
    "noise",
    "estimate",
    "outliers",
    "output",
    "inputs",
    "for",
    "define",
    "effects_from",
    "ranges",
    "certificate",
    "datum",
    "scale",
    "machine",
    "grid",
    "views",
    "camera",
    "rig",
    "pattern",
    "plan",
    "method",
)


def mutated(path: Path, chance: Chance) -> bytes:
    """Return the content of a file after one mutation of the kind of its ending."""
    data = path.read_bytes()
    if not data or chance.random() < 0.1:
        return _bytes(data, chance)
    if path.suffix == ".h5":
        return _result(path, chance) if chance.random() < 0.8 else _bytes(data, chance)
    if path.suffix == ".png":
        return _image(data, chance)
    text = data.decode("utf-8", errors="replace")
    kinds: tuple[Callable[[str, Chance], str], ...] = (_number, _number, _number, _piece, _line)
    kinds += (_column, _cell, _rows) if path.suffix == ".csv" else (_value, _value, _key)
    return chance.choice(kinds)(text, chance).encode("utf-8", errors="surrogatepass")


def _bytes(data: bytes, chance: Chance) -> bytes:
    at = chance.randrange(len(data) + 1)
    kind = chance.randrange(4)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + chance.randbytes(chance.randrange(1, 9)) + data[at:]
    if kind == 2:
        return data[:at] + bytes([data[at] ^ (1 << chance.randrange(8))]) + data[at + 1 :] if at < len(data) else b""
    return data[at:]


def _number(text: str, chance: Chance) -> str:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text
    one = chance.choice(found)
    return text[: one.start()] + chance.choice(NUMBERS) + text[one.end() :]


def _piece(text: str, chance: Chance) -> str:
    at = chance.randrange(len(text) + 1)
    return text[:at] + chance.choice(PIECES) + text[at + chance.randrange(6) :]


def _line(text: str, chance: Chance) -> str:
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    at, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    kind = chance.randrange(3)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(other, lines[at])
    else:
        lines[at], lines[other] = lines[other], lines[at]
    return "".join(lines)


def _value(text: str, chance: Chance) -> str:
    """Replace what stands behind a colon or in a list."""
    found = list(re.finditer(r"(?<=[:\[,] )[^,\[\]{}\n#]+|(?<=\[)[^,\[\]{}\n#]+", text))
    if not found:
        return text
    one = chance.choice(found)
    new = chance.choice((*WORDS, chance.choice(found)[0], chance.choice(found)[0]))
    return text[: one.start()] + new + text[one.end() :]


def _key(text: str, chance: Chance) -> str:
    found = list(re.finditer(r"[\w-]+(?=:)", text))
    kind = chance.randrange(3)
    if kind == 0 or not found:
        return f"{text}\n{chance.choice(KEYS)}: {chance.choice((*WORDS, *NUMBERS))}\n"
    one = chance.choice(found)
    new = chance.choice(KEYS) if kind == 1 else chance.choice(found)[0]
    return text[: one.start()] + new + text[one.end() :]


def _table(text: str) -> list[list[str]]:
    return [line.split(",") for line in text.splitlines()]


def _text(rows: list[list[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in rows)


def _column(text: str, chance: Chance) -> str:
    """Change a whole column: left out, twice, another name, all cells alike, or multiplied."""
    rows = _table(text)
    if not rows or not rows[0]:
        return text
    at, kind = chance.randrange(len(rows[0])), chance.randrange(5)
    factor = chance.choice((0.0, -1.0, 1e-6, 1e3, 1e9))
    for number, row in enumerate(rows):
        if at >= len(row):
            continue
        if kind == 0:
            del row[at]
        elif kind == 1:
            row.append(row[at])
        elif kind == 2 and number == 0:
            row[at] = chance.choice(("x_mm", "t_s", "temp_degC", "sigma_mm", "point", "x_kg", "", row[at].upper()))
        elif kind == 3 and number > 0:
            row[at] = rows[-1][at] if at < len(rows[-1]) else "0"
        elif kind == 4 and number > 0 and _NUMBER.fullmatch(row[at].strip()):
            row[at] = repr(float(row[at]) * factor)
    return _text(rows)


def _cell(text: str, chance: Chance) -> str:
    rows = _table(text)
    row = chance.choice(rows) if rows else []
    if row:
        row[chance.randrange(len(row))] = chance.choice((*NUMBERS, *WORDS))
    return _text(rows)


def _rows(text: str, chance: Chance) -> str:
    """Leave out many rows, or put them in another order, or repeat them."""
    head, *rows = text.splitlines(keepends=True) or [""]
    kind = chance.randrange(4)
    if kind == 0:
        rows = rows[: chance.randrange(4)]
    elif kind == 1:
        rows = [row for row in rows if chance.random() < 0.5]
    elif kind == 2:
        chance.shuffle(rows)
    else:
        rows = rows * 2
    return "".join([head, *rows])


def _result(path: Path, chance: Chance) -> bytes:
    """Change objects of a result and seal it again, as somebody who means harm would."""

    def change(file: Any) -> None:
        names: list[str] = []
        file.visit(names.append)
        name = chance.choice(names)
        kind = chance.randrange(7)
        if kind == 0:
            del file[name]
        elif kind == 1:
            del file[name]
            file[name] = chance.choice((1.0, "text", np.nan, np.zeros((3, 0)), np.arange(5), True, b"x" * 9))
        elif kind == 2:
            file[name].attrs[chance.choice(list(file[name].attrs) or ["units"])] = chance.choice(
                (1.0, "text", np.nan, np.arange(3), "")
            )
        elif kind == 3:
            file.attrs[chance.choice(list(file.attrs))] = chance.choice(
                (1.0, "text", np.nan, np.arange(3), "", "\x1b[2J")
            )
        elif kind == 4:
            file.move(name, chance.choice(("..x/y", "a" * 300, "\u00e4 b", "new", "x/../y")))
        elif kind == 5 and isinstance(file[name], h5py.Dataset):
            _other_values(file[name], chance)
        else:
            file[f"{name}-link"] = (
                h5py.ExternalLink("/etc/passwd", "/") if chance.random() < 0.5 else h5py.SoftLink("/x")
            )

    before = path.read_bytes()
    try:
        resealed(path, change)
        return path.read_bytes()
    except Exception:  # not every change can be made with the library, or to what is already mutated
        return _bytes(before, chance)


def _other_values(data: Any, chance: Chance) -> None:
    values = data[()]
    if not getattr(values, "size", 0):
        return
    part = values[chance.choice(values.dtype.names)] if values.dtype.names else values
    if part.dtype.kind in "fiu":
        new = chance.choice((0.0, -1.0, np.nan, np.inf, 1e300, 1e-300))
        part.flat[chance.randrange(part.size)] = new if part.dtype.kind == "f" else 0
        data[...] = values


def _image(data: bytes, chance: Chance) -> bytes:
    import cv2

    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    kind = chance.randrange(6)
    if picture is None or kind == 0:
        return _bytes(data, chance)
    seed = np.random.default_rng(chance.randrange(1 << 30))
    if kind == 1:
        picture = np.zeros_like(picture)
    elif kind == 2:
        picture = seed.integers(0, 255, picture.shape, dtype=np.uint8)
    elif kind == 3:
        picture = picture[: chance.randint(1, picture.shape[0]), : chance.randint(1, picture.shape[1])]
    elif kind == 4:
        picture = picture[::-1, ::-1]
    else:
        picture = cv2.GaussianBlur(picture, (0, 0), chance.uniform(1, 30))
    return bytes(cv2.imencode(".png", picture)[1])


def renamed_images(folder: Path, chance: Chance) -> None:
    """Give an image a name that paths and tables do not expect."""
    path = chance.choice(sorted(folder.rglob("*.png")))
    name = chance.choice(
        ("a b.png", "\u00e4.png", "-x.png", "a,b.png", "a;b.png", "\n.png", "'.png", "*.png", "[1].png")
    )
    path.rename(path.with_name(name))
