"""Read image files as grey-value arrays and write them; every file is checked before it is decoded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import field
from itertools import pairwise
from pathlib import Path

from metrocli.arrays import Picture
from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, read_bytes, write_bytes
from metrocli.formats.image_headers import HeaderError, size_of
from metrocli.frozen import dataclass

MOST_PIXELS = 200_000_000
"""Images with more pixels are refused before they are decoded."""

MOST_BYTES = 12 * MOST_PIXELS
"""Largest file that is read: six bytes per pixel, and as much again for headers and metadata."""

Size = tuple[int, int]


def _untold(done: int, of: int | None) -> None:
    return None


@dataclass(frozen=True)
class DecodedImages:
    """Grey images in files, decoded one at a time."""

    paths: tuple[Path, ...]
    sizes: tuple[Size, ...]
    """Width and height of each in pixels."""
    lengths: tuple[int, ...]
    """Bytes of each file."""
    digests: tuple[str, ...]
    """SHA-256 of each file as it was checked; a file that changes before it is decoded is refused."""
    tell: Callable[[int, int | None], None] = field(default=_untold, compare=False)
    """Progress function: takes the number of images that have been used, and that of all"""

    @property
    def names(self) -> tuple[str, ...]:
        """File names without folder, in sorted order."""
        return tuple(path.name for path in self.paths)

    @property
    def size(self) -> Size:
        """Width and height of all images; raises InputError that names those of another size than most."""
        return self.size_of(self.names)

    def size_of(self, names: Collection[str]) -> Size:
        """Return width and height of the images with these names; raises as `size`."""
        pairs = zip(self.paths, self.sizes, strict=True)
        sizes = {path: size for path, size in pairs if path.name in names}
        if faults := _different_sizes(sizes):
            raise InputError(faults)
        return next(iter(sizes.values()))

    def chosen(self, names: Collection[str]) -> Iterator[Picture]:
        """Yield the images with these names; no other is read."""
        files = zip(self.paths, self.digests, strict=True)
        yield from (read(path, digest) for path, digest in files if path.name in names)

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[tuple[str, Picture]]:
        for done, (path, digest) in enumerate(zip(self.paths, self.digests, strict=True), 1):
            yield path.name, read(path, digest)
            self.tell(done, len(self.paths))


def read_images(paths: Sequence[Path]) -> DecodedImages:
    """Return the images sorted by name, and check all files without decoding them.

    Raises InputError with all faults of all files: not readable, unknown format, incomplete, too large, equal names,
    or the same content.
    """
    files = tuple(sorted(paths, key=lambda path: path.name))
    if not files:
        raise InputError("no image is given")
    faults: list[Fault] = []
    sizes: dict[Path, Size] = {}
    lengths: dict[Path, int] = {}
    digests: dict[Path, str] = {}
    contents: dict[str, Path] = {}
    for path in files:
        try:
            held = _bytes(path)
            sizes[path], lengths[path], digests[path] = size_of(held.data), len(held.data), held.sha256
            faults += _same_content(path, contents.setdefault(held.sha256, path))
            faults += _size_fault(path, sizes[path])
        except HeaderError as fault:
            faults.append(_fault(path, str(fault)))
        except InputError as error:
            faults += error.faults
    alike = [(first, path) for first, path in pairwise(files) if first.name == path.name]
    faults += [_fault(path, f"two images have this name; the other is {first}") for first, path in alike]
    if faults:
        raise InputError(faults)
    return DecodedImages(files, tuple(sizes.values()), tuple(lengths.values()), tuple(digests.values()))


def read(path: Path, digest: str = "") -> Picture:
    """Return grey values, (height, width), 8 or 16 bit, on the pixel grid of the sensor: EXIF rotation is ignored.

    Raises InputError if the SHA-256 of the file is another one than `digest`, where that is given.
    """
    import cv2
    import numpy as np

    held = _bytes(path)
    data = held.data
    try:
        faults = _size_fault(path, size_of(data))
    except HeaderError as fault:
        faults = [_fault(path, str(fault))]
    if digest and held.sha256 != digest:
        faults = [_fault(path, "the image changed while the job ran; run it again")]
    if faults:
        raise InputError(faults)
    # pixels are those of the sensor: EXIF orientation flips at random for a camera that looks down
    # (docs/decisions/001-pixel-grid.md)
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        picture = None
    if picture is None:
        raise InputError([_fault(path, "the image cannot be decoded: its data are damaged")])
    if picture.dtype == np.uint8:
        return picture.astype(np.uint8, copy=False)
    if picture.dtype == np.uint16:
        return picture.astype(np.uint16, copy=False)
    raise InputError([_fault(path, f"the grey values are {picture.dtype}; 8 or 16 bit whole numbers are needed")])


def write(path: Path, picture: Picture) -> None:
    """Write an image completely or not at all; the suffix of `path` selects the format (.png, .tif, .bmp, .pgm)."""
    import cv2

    try:
        encoded = cv2.imencode(path.suffix, picture)[1].tobytes()
    except cv2.error as error:
        raise InputError([_fault(path, f"an image cannot be written as '{path.suffix}'")]) from error
    write_bytes(path, encoded)


def _bytes(path: Path) -> FileBytes:
    return read_bytes(path, "an image", most=MOST_BYTES)


def _size_fault(path: Path, size: Size) -> list[Fault]:
    if size[0] * size[1] <= MOST_PIXELS:
        return []
    return [_fault(path, f"the image has {size[0]} x {size[1]} pixels; at most {MOST_PIXELS} pixels are read")]


def _same_content(path: Path, first: Path) -> list[Fault]:
    if path == first:
        return []
    hint = "one measurement that counts twice makes the uncertainty too small: remove the copy"
    return [Fault(f"this image is a copy of {first.name}, byte for byte", str(path), hint=hint)]


def _different_sizes(sizes: dict[Path, Size]) -> list[Fault]:
    if len(set(sizes.values())) < 2:
        return []
    (usual, count), *_ = Counter(sizes.values()).most_common(1)
    of_most = next(path for path, size in sizes.items() if size == usual)
    return [
        _fault(
            path,
            f"this image is {size[0]} x {size[1]} pixels, but {of_most} is {usual[0]} x {usual[1]}, as {count} of "
            f"{len(sizes)} are; the images of a camera have one size",
        )
        for path, size in sizes.items()
        if size != usual
    ]


def _fault(path: Path, message: str) -> Fault:
    return Fault(message, file=str(path))
