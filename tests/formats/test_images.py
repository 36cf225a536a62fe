"""Images are hostile input: every fault names its file, and nothing large is decoded."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from metrocli.errors import InputError
from metrocli.formats.images import read, read_images, write

RAMP = np.arange(6 * 8, dtype=np.uint8).reshape(6, 8) * 5


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_that_claims(width: int, height: int) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def saved(path: Path, array: npt.NDArray[np.generic]) -> Path:
    path.write_bytes(cv2.imencode(path.suffix, array)[1].tobytes())
    return path


def turned(jpeg: bytes, orientation: int) -> bytes:
    """Put an EXIF segment with an orientation into a JPEG file."""
    tiff = b"MM\0*" + struct.pack(">IH", 8, 1) + struct.pack(">HHIHH", 0x0112, 3, 1, orientation, 0) + bytes(4)
    body = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


def message(*paths: Path) -> str:
    with pytest.raises(InputError) as caught:
        list(read_images(paths)) and read_images(paths).size
    return str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".pgm", ".jpg"])
def test_reads_what_it_wrote(tmp_path: Path, suffix: str) -> None:
    flat = np.full((32, 48), 77, np.uint8)
    write(tmp_path / f"a{suffix}", flat)
    [(name, picture)] = read_images([tmp_path / f"a{suffix}"])
    assert name == f"a{suffix}"
    np.testing.assert_array_equal(picture, flat)
    assert [path.name for path in tmp_path.iterdir()] == [f"a{suffix}"]


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_sixteen_bits_stay(tmp_path: Path, suffix: str) -> None:
    deep = RAMP.astype(np.uint16) * 257 + 3
    write(tmp_path / f"a{suffix}", deep)
    np.testing.assert_array_equal(read(tmp_path / f"a{suffix}"), deep)


def test_colour_and_alpha_become_grey(tmp_path: Path) -> None:
    colour = saved(tmp_path / "c.png", np.dstack([RAMP, RAMP, RAMP]))
    alpha = saved(tmp_path / "d.png", np.dstack([RAMP, RAMP, RAMP, np.full_like(RAMP, 9)]))
    for name, picture in read_images([alpha, colour]):
        np.testing.assert_array_equal(picture, RAMP, err_msg=name)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_rotation_is_ignored(tmp_path: Path, orientation: int) -> None:
    plain = cv2.imencode(".jpg", RAMP)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(turned(plain, orientation))
    (tmp_path / "b.jpg").write_bytes(plain)
    (_, a), (_, b) = read_images([tmp_path / "a.jpg", tmp_path / "b.jpg"])
    np.testing.assert_array_equal(a, b)


def test_names_are_sorted_and_without_folder(tmp_path: Path) -> None:
    paths = [saved(tmp_path / "b.png", RAMP), saved(tmp_path / "a.png", RAMP[::-1])]
    assert read_images(paths).names == ("a.png", "b.png")


@pytest.mark.parametrize("size", [(100_000, 100_000), (2**31 - 1, 2**31 - 1), (1, 2**31 - 1), (14_143, 14_143)])
def test_absurd_size_is_refused_before_decoding(tmp_path: Path, size: tuple[int, int]) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png_that_claims(*size))
    assert f"{size[0]} x {size[1]} pixels" in message(path)
    assert "bomb.png" in message(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm"])
def test_truncated_file_is_refused(tmp_path: Path, suffix: str) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8)
    whole = cv2.imencode(suffix, noise)[1].tobytes()
    path = tmp_path / f"short{suffix}"
    for length in [*range(0, 64, 5), len(whole) // 3, len(whole) * 9 // 10]:
        path.write_bytes(whole[:length])
        assert f"short{suffix}" in message(path), length


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm"])
def test_damage_never_ends_in_anything_but_an_input_error(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(2)
    whole = cv2.imencode(suffix, rng.integers(0, 255, (16, 16), np.uint8))[1].tobytes()
    path = tmp_path / f"hurt{suffix}"
    for _ in range(60):
        hurt = bytearray(whole)
        for place in rng.integers(0, min(len(whole), 200), 3):
            hurt[place] = rng.integers(0, 256)
        path.write_bytes(hurt)
        try:
            list(read_images([path]))
        except InputError as error:
            assert path.name in str(error)


@pytest.mark.parametrize("text", [b"", b"u_px,v_px\n1,2\n", b"BM", b"P5", b"P5 x y z", b"II*\0", b"\xff\xd8\xff"])
def test_what_is_not_an_image(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "table.png"
    path.write_bytes(text)
    assert "table.png" in message(path)


def test_floating_point_grey_values_are_refused(tmp_path: Path) -> None:
    assert "float32" in message(saved(tmp_path / "f.tif", RAMP.astype(np.float32)))


def test_missing_file_and_folder(tmp_path: Path) -> None:
    text = message(tmp_path / "none.png", tmp_path)
    assert "none.png: error: there is no such file" in text
    assert f"{tmp_path}: error: this is a folder, not an image" in text


def test_two_sizes_name_both(tmp_path: Path) -> None:
    text = message(saved(tmp_path / "a.png", RAMP), saved(tmp_path / "b.png", RAMP[:5]))
    assert "a.png" in text and "b.png" in text and "8 x 6" in text and "8 x 5" in text


def test_two_images_of_one_name(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    text = message(saved(tmp_path / "a.png", RAMP), saved(tmp_path / "x" / "a.png", RAMP))
    assert "two images have this name" in text


def test_no_image_at_all() -> None:
    with pytest.raises(InputError, match="no image"):
        read_images([])


def test_unwritable_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        (tmp_path / "file").touch()
        write(tmp_path / "file" / "a.png", RAMP)
    with pytest.raises(InputError, match="cannot be written as '.doc'"):
        write(tmp_path / "a.doc", RAMP)
