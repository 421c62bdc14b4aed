r"""The map file: named arrays and a configuration in one checked, versioned file.

Layout, little endian::

    8 bytes    b"\x89INFOMAP"
    uint32     version, 3
    uint32     length of the header in bytes
    uint64     length of the whole file in bytes
    header     JSON: {"config": {...}, "arrays": [{"name", "dtype", "shape", "bytes"}, ...]}
    arrays     one after the other, each compressed with zlib to "bytes" bytes
    32 bytes   SHA-256 of all that stands before it

The file replaces an older one at once or not at all (`infomap_ros.geometry.atomic_file`).
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import MapFileError
from infomap_ros.geometry.atomic_file import MALFORMED, replacing

MAP_FILE_VERSION = 4
"""Version of the layout; others are refused."""

_MAGIC = b"\x89INFOMAP"
_FIXED = struct.Struct("<8sIIQ")
_DIGEST_SIZE = 32
_COMPRESSION = 1  # of zlib: the fastest; occupancy shrinks tenfold already
_MOST_INFLATION = 230
"""At the level with which the file is written, zlib packs zeros to 1/229.2 of their size and
nothing to less; at other levels to 1/1030."""


def write_map_file(
    path: str | Path, config: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write a map file, atomically.

    Args:
        path: where to; a file, or a symbolic link, that is there is replaced.
        config: bool, int, finite float, str, or tuples of these, by name.
        arrays: bool, integer or real arrays by name.

    Raises:
        MapFileError: the file cannot be written, or holds what the layout cannot; an old file is
            left as it was.
    """
    target = Path(path)
    try:
        chunks = _chunks(config, arrays)
        with replacing(target) as file:
            digest = hashlib.sha256()
            for chunk in chunks:
                digest.update(chunk)
                file.write(chunk)
            file.write(digest.digest())
    except OSError as error:
        raise MapFileError(f"cannot write map file {target}: {error.strerror}") from error
    except (TypeError, ValueError) as error:
        raise MapFileError(f"cannot write map file {target}: {error}") from error


def read_map_file(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a map file.

    Returns:
        The configuration (tuples as tuples) and the arrays by name, both as written.

    Raises:
        MapFileError: the file is missing, is no map file, of another version, truncated or
            corrupt; names it and says which.
    """
    source = Path(path)
    try:
        content = source.read_bytes()
    except OSError as error:
        raise MapFileError(f"cannot read map file {source}: {error.strerror}") from error
    try:
        return _parse(memoryview(content))
    except _DefectError as defect:
        raise MapFileError(f"map file {source} {defect}") from defect
    except (*MALFORMED, MemoryError, zlib.error) as error:
        raise MapFileError(
            f"map file {source} is whole, but what it holds is not valid: {error}"
        ) from error


class _DefectError(Exception):
    """What is wrong with a file, as the end of a sentence."""


def _chunks(config: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> list[bytes]:
    """All of the file but the checksum."""
    entries, payloads = [], []
    for name, array in arrays.items():
        values = np.asarray(array, order="C")
        dtype = _storable(values.dtype.newbyteorder("<"))
        payloads.append(zlib.compress(values.astype(dtype, copy=False).data, _COMPRESSION))
        shape, size = list(values.shape), len(payloads[-1])
        entries.append({"name": name, "dtype": dtype.str, "shape": shape, "bytes": size})
    header = json.dumps({"config": dict(config), "arrays": entries}, allow_nan=False).encode()
    length = _FIXED.size + len(header) + sum(map(len, payloads)) + _DIGEST_SIZE
    return [_FIXED.pack(_MAGIC, MAP_FILE_VERSION, len(header), length), header, *payloads]


def _storable(dtype: np.dtype[Any]) -> np.dtype[Any]:
    if dtype.kind not in "biuf":
        raise TypeError(f"arrays of type {dtype} cannot be stored")
    return dtype


def _parse(content: memoryview) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    start = _checked_start(content)
    header = json.loads(bytes(content[_FIXED.size : start]))
    end = len(content) - _DIGEST_SIZE
    _check_total(header["arrays"], end - start)
    arrays: dict[str, NDArray[Any]] = {}
    for entry in header["arrays"]:
        payload = content[start : min(start + entry["bytes"], end)]
        arrays[entry["name"]] = _unpack(payload, np.dtype(entry["dtype"]), tuple(entry["shape"]))
        start += len(payload)
    if start != end:
        raise ValueError(f"{end - start} bytes belong to no array")
    config = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in header["config"].items()
    }
    return config, arrays


def _checked_start(content: memoryview) -> int:
    """Check everything that surrounds the arrays; returns where they start."""
    if bytes(content[: len(_MAGIC)]) != _MAGIC[: len(content)] or not content:
        raise _DefectError("is no map file of infomap_ros")
    if len(content) < _FIXED.size:
        raise _DefectError(f"is truncated: it ends after {len(content)} bytes")
    _, version, header_length, length = _FIXED.unpack(content[: _FIXED.size])
    if version != MAP_FILE_VERSION:
        raise _DefectError(
            f"has version {version} of the layout, this program reads {MAP_FILE_VERSION}"
        )
    if len(content) < length:
        raise _DefectError(f"is truncated: {len(content)} of {length} bytes are there")
    body, digest = content[:-_DIGEST_SIZE], content[-_DIGEST_SIZE:]
    if len(content) != length or hashlib.sha256(body).digest() != bytes(digest):
        raise _DefectError("is corrupt: its checksum does not fit its content")
    start = _FIXED.size + int(header_length)
    if start > len(body):
        raise _DefectError("is corrupt: its header is longer than the file")
    return start


def _check_total(entries: list[dict[str, Any]], packed: int) -> None:
    """Compare what the arrays need with what there is of them, before anything is allocated.

    Raises:
        ValueError: they need more than can be meant.
    """
    needed = sum(
        _storable(np.dtype(entry["dtype"])).itemsize * math.prod(map(abs, entry["shape"]))
        for entry in entries
    )
    if needed > _MOST_INFLATION * packed:
        raise ValueError(f"{packed} bytes are to hold arrays of {needed} bytes")


def _unpack(payload: memoryview, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Decompress an array; never to more than its type and shape need."""
    size = _storable(dtype).itemsize * math.prod(shape)
    if min(shape, default=0) < 0:
        raise ValueError(f"an array has the shape {shape}")
    inflater = zlib.decompressobj()
    raw = inflater.decompress(payload, size + 1)
    if len(raw) != size or not inflater.eof:
        raise ValueError(f"an array of type {dtype} and shape {shape} does not fit its bytes")
    values = np.frombuffer(raw, dtype).reshape(shape)
    return values.astype(dtype.newbyteorder("="))
