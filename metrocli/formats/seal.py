"""The seal of a result file: two lines of text before the HDF5 part, with a digest of all that follows the first.

    metrocli-result 1 sha256 HEX
    {"format": "metrocli-result", "kind": ..., "inputs": [...]}

HDF5 calls this part the user block and skips it: it ends at a power of two, at least 512 bytes. The digest is checked
before anything else of the file is read, so that damage cannot reach the HDF5 library, and whether a result is up to
date is known without that library.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.record import InputFile

FORMAT, VERSION = "metrocli-result", 1
HDF5 = b"\x89HDF\r\n\x1a\n"
_MAGIC = f"{FORMAT} ".encode()
_DAMAGED = "the result file is damaged or was edited: its content does not match its digest"
_AGAIN = "run its job again"


@dataclass(frozen=True)
class Label:
    """What decides whether a result is up to date and fit for use."""

    kind: str
    status: str
    metrocli_version: str
    meaning: str
    """Digest of the job as meant"""
    content: str
    """Digest of the result and of the content of its inputs, without times, texts of jobs and versions"""
    inputs: tuple[InputFile, ...]
    job_file: str = ""
    """Relative to the folder of the result"""
    exit_code: int = 0
    warned: bool = False
    """Whether it has warnings that are not doubts"""


def sealed(label: Label, body: bytes) -> tuple[bytes, bytes]:
    """Return what a result file begins with, from its label and its HDF5 part, and that part."""
    text = json.dumps({"format": FORMAT, **asdict(label)}, ensure_ascii=False).encode() + b"\n"
    # a digest has always the same length, so that of nothing gives the place of the rest
    first = len(_first_line(b""))
    padded = text + b"\n" * (_start_of_body(first + len(text)) - first - len(text))
    return _first_line(padded, body) + padded, body


def unsealed(data: bytes, shown: str) -> tuple[Label, memoryview]:
    """Return the label and the HDF5 part of a result file, which is not copied.

    Raises InputError unless the file is as it was written.
    """
    if not data.startswith(_MAGIC):
        if not is_remains(data):
            raise InputError([Fault("this is not a result file of metrocli", shown)])
        raise InputError([Fault(_DAMAGED, shown, hint=_AGAIN)])
    line = data[: len(_first_line())].partition(b"\n")[0]
    rest = memoryview(data)[len(line) + 1 :]
    words = line.split(b" ")
    # nine digits are enough: int() refuses more than 4300 with an error of its own
    if len(words) == 4 and words[1].isdigit() and int(words[1][:9]) > VERSION:
        message = f"the file has version {words[1].decode()} of the format; this metrocli reads up to {VERSION}"
        raise InputError([Fault(message, shown)])
    # before the label is parsed: damage is named as such, and reaches neither JSON nor HDF5
    if line + b"\n" != _first_line(rest):
        raise InputError([Fault(_DAMAGED, shown, hint=_AGAIN)])
    text = data[len(line) + 1 : data.find(b"\n", len(line) + 1)]
    start = _start_of_body(len(line) + 1 + len(text) + 1) - len(line) - 1
    try:
        label = _label_of(json.loads(text))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError([Fault(f"the label of the result file is malformed: {error}", shown)]) from error
    if rest[start : start + len(HDF5)] != HDF5:
        raise InputError([Fault("the result file has no HDF5 part", shown)])
    return label, rest[start:]


def is_remains(head: bytes) -> bool:
    """Return whether a file that begins so is a result, what is left of one, or empty."""
    return _MAGIC.startswith(head[: len(_MAGIC)]) or FORMAT.encode() in head[:4096]


def _first_line(*rest: bytes | memoryview) -> bytes:
    digest = hashlib.sha256()
    for part in rest:
        digest.update(part)
    return f"{FORMAT} {VERSION} sha256 {digest.hexdigest()}\n".encode()


def _start_of_body(length: int) -> int:
    # the user block of HDF5 ends at a power of two, 512 bytes at least
    return max(512, 1 << (length - 1).bit_length())


def _label_of(held: dict[str, Any]) -> Label:
    names = ("kind", "status", "metrocli_version", "meaning", "content", "job_file")
    texts = {name: held[name] for name in names}
    inputs = tuple(InputFile(**file) for file in held["inputs"])
    words = [*texts.values(), *(part for file in inputs for part in (file.path, file.sha256, file.content))]
    if not all(isinstance(word, str) for word in words):
        raise TypeError("a text is missing")
    return Label(**texts, inputs=inputs, exit_code=int(held["exit_code"]), warned=bool(held["warned"]))
