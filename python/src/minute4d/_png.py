"""Reads PNG images as the program writes them, with zlib and numpy alone."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from ._errors import Category, Minute4dError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 6: 4}
_BATCH_BYTES = 1 << 26
"""Bytes of images that are decoded together."""


def read(paths: Sequence[Path]) -> NDArray[Any]:
    """Return images of one size and type as an array (n, height, width, channels).

    uint8 or uint16; greyscale has 1 channel, RGB 3, RGBA 4. Raises `Minute4dError` for files that
    are missing, damaged, palette or interlaced images, or unlike the first.
    """
    first: Union[tuple[int, int, int, int], None] = None
    rows: list[NDArray[np.uint8]] = []
    out: list[NDArray[Any]] = []
    for path in paths:
        kind, data = _inflate(path)
        first = first or kind
        if kind != first:
            raise _bad(path, "it has another size or type than the images before it")
        rows.append(data)
        if sum(r.size for r in rows) > _BATCH_BYTES:
            out.append(_decode(paths, rows, first))
            rows = []
    if first is None:
        raise ValueError("no images")
    if rows:
        out.append(_decode(paths, rows, first))
    return np.concatenate(out) if len(out) > 1 else out[0]


def _bad(path: Path, what: str) -> Minute4dError:
    return Minute4dError(Category.BAD_INPUT, f"{path}: {what}")


def _inflate(path: Path) -> tuple[tuple[int, int, int, int], NDArray[np.uint8]]:
    """Return (width, height, bits, channels) and the filtered rows."""
    try:
        data = path.read_bytes()
    except OSError as error:
        category = Category.NO_INPUT if isinstance(error, FileNotFoundError) else Category.IO
        raise Minute4dError(category, f"{path}: {error.strerror}") from error
    if data[:8] != _SIGNATURE:
        raise _bad(path, "it is not a PNG image")
    at, packed, kind, ended = 8, bytearray(), None, False
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        chunk = data[at + 8 : at + 8 + length]
        crc = data[at + 8 + length : at + 12 + length]
        if len(crc) < 4 or struct.unpack(">I", crc)[0] != zlib.crc32(name + chunk):
            raise _bad(path, "it is damaged")
        if name == b"IHDR" and len(chunk) == 13:
            width, height, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunk)
            if bits not in (8, 16) or colour not in _CHANNELS or interlaced:
                raise _bad(path, "only grey, RGB and RGBA of 8 or 16 bits, not interlaced, are read")
            kind = (width, height, bits, _CHANNELS[colour])
        elif name == b"IDAT":
            packed += chunk
        at += 12 + length
        ended = ended or name == b"IEND"
    if kind is None or not ended:
        raise _bad(path, "it is damaged: its header or its end is missing")
    width, height, bits, channels = kind
    size = height * (1 + width * channels * bits // 8)
    stream = zlib.decompressobj()
    try:
        unpacked = stream.decompress(bytes(packed), size + 1)
    except zlib.error as error:
        raise _bad(path, f"it is damaged: {error}") from error
    if len(unpacked) != size or not stream.eof:
        raise _bad(path, "it is damaged: it has too few or too many pixels")
    return kind, np.frombuffer(unpacked, np.uint8).reshape(height, -1)


def _decode(
    paths: Sequence[Path], rows: list[NDArray[np.uint8]], kind: tuple[int, int, int, int]
) -> NDArray[Any]:
    """Undo the filters of the rows, diagonal by diagonal.

    A pixel needs its neighbours to the left, above and above left: all of those are on the two
    diagonals before its own, so that the pixels of a diagonal, of all images, are independent.
    """
    width, height, bits, channels = kind
    n, size = len(rows), channels * bits // 8
    filtered = np.stack(rows)
    filters = filtered[:, :, 0]
    if filters.max() > 4:
        raise _bad(paths[0], "it or a later image is damaged: a row has an unknown filter")
    # A row above and a column to the left, of zeros.
    stride = width + 1
    pixels = np.zeros((n, height + 1, stride, size), np.uint8)
    pixels[:, 1:, 1:] = filtered[:, :, 1:].reshape(n, height, width, size)
    flat = pixels.reshape(n, -1, size)
    for diagonal in range(width + height - 1):
        top = max(0, diagonal - width + 1)
        count = min(height - 1, diagonal) - top + 1
        first = (top + 1) * stride + diagonal - top + 1

        def at(start: int) -> NDArray[np.uint8]:
            return flat[:, start : start + (count - 1) * (stride - 1) + 1 : max(1, stride - 1)]

        own = at(first)
        left, up, corner = (
            at(first - back).astype(np.int16) for back in (1, stride, stride + 1)
        )
        near = left + up - corner
        to_left, to_up, to_corner = abs(near - left), abs(near - up), abs(near - corner)
        paeth = np.where(
            (to_left <= to_up) & (to_left <= to_corner),
            left,
            np.where(to_up <= to_corner, up, corner),
        )
        which = filters[:, top : top + count, None]
        guess = np.choose(which, [np.int16(0), left, up, (left + up) >> 1, paeth])
        own += guess.astype(np.uint8)
    image = np.ascontiguousarray(pixels[:, 1:, 1:])
    if bits == 16:
        image = image.view(">u2").astype(np.uint16)
    return image
