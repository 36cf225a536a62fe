"""Read the size of an image from its file header, without decoding the image."""

from __future__ import annotations

import struct
from collections.abc import Callable

Size = tuple[int, int]

_JPEG_FRAMES = frozenset({0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})
_JPEG_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD9)})
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_OFFSETS, _TIFF_BYTES = 256, 257, (273, 324), (279, 325)
_TIFF_TYPES = {3: "H", 4: "I"}


class HeaderError(ValueError):
    """The file is not an image of a known format, or it is damaged or truncated."""


def size_of(data: bytes) -> Size:
    """Return (width, height) of a PNG, JPEG, TIFF, BMP or PNM file, and check that the file is complete.

    Only the structure is read, not the pixels. Raises HeaderError with the reason.
    """
    for magic, read in _FORMATS.items():
        if data[: len(magic)] == magic:
            return _guarded(read, data)
    raise HeaderError("not an image (PNG, JPEG, TIFF, BMP, PGM and PPM are read)")


def _guarded(read: Callable[[bytes], Size], data: bytes) -> Size:
    try:
        width, height = read(data)
    except (struct.error, IndexError, ValueError) as fault:
        if isinstance(fault, HeaderError):
            raise
        raise HeaderError("the file is truncated or its header is damaged") from fault
    if width < 1 or height < 1:
        raise HeaderError(f"the header gives a size of {width} x {height}")
    return width, height


def _png(data: bytes) -> Size:
    if data[12:16] != b"IHDR":
        raise HeaderError("the PNG header is damaged")
    place, kind = 8, b""
    while kind != b"IEND":
        (length,) = struct.unpack_from(">I", data, place)
        kind, place = bytes(data[place + 4 : place + 8]), place + 12 + length
        if place > len(data):
            raise HeaderError("the file is truncated")
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _jpeg(data: bytes) -> Size:
    place, size = 2, (0, 0)
    while True:
        mark, kind = data[place], data[place + 1]
        if mark != 0xFF:
            raise HeaderError("the JPEG structure is damaged")
        # 0xFF repeats as filler before a marker
        if kind == 0xFF or kind in _JPEG_WITHOUT_LENGTH:
            place += 1 if kind == 0xFF else 2
            continue
        (length,) = struct.unpack_from(">H", data, place + 2)
        if kind in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, place + 5)
            size = (width, height)
        place += 2 + length
        # the scan follows, whose length is not stated: only its end can be looked for
        if kind == 0xDA:
            break
    if data.find(b"\xff\xd9", place) < 0:
        raise HeaderError("the file is truncated")
    return size


def _bmp(data: bytes) -> Size:
    offset, header, width, height, _, depth, compression = struct.unpack_from("<IIiiHHI", data, 10)
    if header < 40:
        raise HeaderError("BMP files in the OS/2 format are not read")
    # rows of a bitmap are padded to four bytes
    row = (width * depth + 31) // 32 * 4
    if compression in (0, 3) and offset + row * abs(height) > len(data):
        raise HeaderError("the file is truncated")
    # the height is negative where the rows run from the top
    return width, abs(height)


def _pnm(data: bytes) -> Size:
    lines = [line.split(b"#")[0] for line in bytes(data[:4096]).split(b"\n")]
    words = b" ".join(lines).split()
    width, height, highest = (int(word) for word in words[1:4])
    samples = width * height * (3 if data[:2] == b"P6" else 1) * (2 if highest > 255 else 1)
    if data[:2] in (b"P5", b"P6") and samples > len(data):
        raise HeaderError("the file is truncated")
    return width, height


def _tiff(data: bytes) -> Size:
    order = "<" if data[:2] == b"II" else ">"
    (place,) = struct.unpack_from(order + "I", data, 4)
    (entries,) = struct.unpack_from(order + "H", data, place)
    values: dict[int, tuple[int, ...]] = {}
    for entry in range(place + 2, place + 2 + 12 * entries, 12):
        tag, kind, count = struct.unpack_from(order + "HHI", data, entry)
        if kind in _TIFF_TYPES:
            values[tag] = _tiff_values(data, order, _TIFF_TYPES[kind], count, entry + 8)
    for offsets, lengths in zip(_TIFF_OFFSETS, _TIFF_BYTES, strict=True):
        for start, length in zip(values.get(offsets, ()), values.get(lengths, ()), strict=False):
            if start + length > len(data):
                raise HeaderError("the file is truncated")
    if _TIFF_WIDTH not in values or _TIFF_HEIGHT not in values:
        raise HeaderError("the TIFF directory does not give the size of the image")
    return values[_TIFF_WIDTH][0], values[_TIFF_HEIGHT][0]


def _tiff_values(data: bytes, order: str, code: str, count: int, place: int) -> tuple[int, ...]:
    # up to four bytes are in the entry itself, more where it points to
    if count * struct.calcsize(code) > 4:
        (place,) = struct.unpack_from(order + "I", data, place)
    if count * struct.calcsize(code) > len(data):
        raise HeaderError("the TIFF directory is damaged")
    return struct.unpack_from(f"{order}{count}{code}", data, place)


_FORMATS: dict[bytes, Callable[[bytes], Size]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8\xff": _jpeg,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"BM": _bmp,
    b"P2": _pnm,
    b"P3": _pnm,
    b"P5": _pnm,
    b"P6": _pnm,
}
