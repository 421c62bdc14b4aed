"""What holds for a whole message, as the name of one of its fields.

A point cloud has fields and rows but no place for values that hold for all rows. Repeated in every
row they would cost more than the rows; so they stand once, in the name of a further field that lies
on the first byte of each row: ``infomap robot=7 version=12 voxel_size=0.05 ...``. Tools that read
clouds see one more field of bytes; rows and points are as in every cloud.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError

_PREFIX = "infomap "
_MAX_LENGTH = 400


def dtype_with_header(dtype: np.dtype[np.void], header: Mapping[str, object]) -> np.dtype[np.void]:
    """A row's dtype with one more field, whose name is the header, in the order given."""
    fields = dict(dtype.fields or {})
    text = _PREFIX + " ".join(f"{name}={value}" for name, value in header.items())
    return np.dtype(
        {
            "names": [*fields, text],
            "formats": [*(entry[0] for entry in fields.values()), "u1"],
            "offsets": [*(entry[1] for entry in fields.values()), 0],
            "itemsize": dtype.itemsize,
        }
    )


def with_header_values(rows: NDArray[np.void], header: Mapping[str, object]) -> NDArray[np.void]:
    """The same rows, with more values in the header."""
    fields = dict(rows.dtype.fields or {})
    old = next(name for name in fields if name.startswith(_PREFIX))
    text = old + "".join(f" {name}={value}" for name, value in header.items())
    names = [text if name == old else name for name in fields]
    formats = [entry[0] for entry in fields.values()]
    offsets = [entry[1] for entry in fields.values()]
    size = rows.dtype.itemsize
    return rows.view(
        np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    )


def layout_of(rows: NDArray[np.void]) -> list[tuple[str, np.dtype[np.generic], int]]:
    """Name, type and offset of all fields, the one with the header included."""
    return [(name, entry[0], entry[1]) for name, entry in (rows.dtype.fields or {}).items()]


def without_last_entry(rows: NDArray[np.void], name: str) -> tuple[NDArray[np.void] | None, str]:
    """The same rows without their last fact, and its value; None if it is not of this name."""
    fields = dict(rows.dtype.fields or {})
    texts = [text for text in fields if text.startswith(_PREFIX)]
    start, mark, value = texts[0].rpartition(f" {name}=") if len(texts) == 1 else ("", "", "")
    if not mark:
        return None, ""
    names = [start if text == texts[0] else text for text in fields]
    formats = [entry[0] for entry in fields.values()]
    offsets = [entry[1] for entry in fields.values()]
    size = rows.dtype.itemsize
    plain = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    return rows.view(plain), value


def header_of(rows: NDArray[np.void], what: str) -> dict[str, str]:
    """The header of the rows of a message.

    Args:
        rows: structured array.
        what: kind of message, for the error.

    Raises:
        InvalidInputError: there are none, or they are malformed.
    """
    names = [name for name in rows.dtype.names or () if name.startswith(_PREFIX)]
    if len(names) != 1 or len(names[0]) > _MAX_LENGTH:
        raise InvalidInputError(what, f"fields {rows.dtype.names} do not say whose it is")
    pairs = [part.partition("=") for part in names[0][len(_PREFIX) :].split(" ")]
    header = {name: value for name, mark, value in pairs if mark and name and value}
    if len(header) != len(pairs):
        raise InvalidInputError(what, f"header '{names[0]}' is malformed")
    return header


def without_header(rows: NDArray[np.void], dtypes: Sequence[np.dtype[np.void]]) -> NDArray[np.void]:
    """The rows as one of some dtypes, whichever has their fields.

    Raises:
        InvalidInputError: none has.
    """
    fields = {n: f[:2] for n, f in (rows.dtype.fields or {}).items() if not n.startswith(_PREFIX)}
    for dtype in dtypes:
        expected = {name: entry[:2] for name, entry in (dtype.fields or {}).items()}
        if fields == expected and rows.dtype.itemsize == dtype.itemsize:
            return rows.view(dtype)
    raise InvalidInputError("message", f"fields {tuple(fields)}")


def whole_number(header: Mapping[str, str], name: str, low: int, high: int, what: str) -> int:
    """A fact that is a whole number within [low, high].

    Raises:
        InvalidInputError: it is missing or is not.
    """
    text = header.get(name, "")
    digits = text[1:] if text.startswith("-") else text
    if not (digits.isascii() and digits.isdigit() and len(digits) < 20):
        raise InvalidInputError(what, f"{name} '{text}' is not a whole number")
    if not low <= int(text) <= high:
        raise InvalidInputError(what, f"{name} {text}, expected {low} to {high}")
    return int(text)


def positive_number(header: Mapping[str, str], name: str, what: str) -> float:
    """A fact that is a positive, finite number.

    Raises:
        InvalidInputError: it is missing or is not.
    """
    try:
        value = float(header.get(name, "nan"))
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and value > 0.0):
        raise InvalidInputError(what, f"{name.replace('_', ' ')} '{header.get(name, '')}'")
    return value
