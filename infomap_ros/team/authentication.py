"""Messages that only those can write who know the team's key.

A message carries a code over its rows and header: HMAC with SHA-256 (RFC 2104,
https://doi.org/10.17487/RFC2104), cut to its first 16 bytes. What is repeated by a stranger is
authentic, but old: states that were told before change nothing.

For a message of rows the code is made from the description of a row and the bytes of the rows. The
description is JSON in ASCII without blanks: a list with one list for each field in the order of the
message (its name, its type as in numpy's array interface, such as ``<f4``, its shape, its offset in
the row [bytes]) and the length of a row [bytes]. For a text it is made from ``text``, a line feed
and the text in UTF-8.
"""

from __future__ import annotations

import hmac
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, UpdateRefusedError
from infomap_ros.team.message_header import layout_of, with_header_values, without_last_entry

NOT_AUTHENTIC = "not authentic"
_SHORTEST_KEY, _CODE_BYTES = 16, 16
Rows = NDArray[np.void]


class TeamKey:
    """A secret that the robots of a team share.

    Args:
        secret: at least 16 bytes.

    Raises:
        InvalidInputError: it is shorter.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) < _SHORTEST_KEY:
            raise InvalidInputError("team key", f"has {len(secret)} bytes, expected at least 16")
        self._start = hmac.new(secret, digestmod="sha256")

    @classmethod
    def read(cls, path: str | Path) -> TeamKey:
        """The key in a file; white space at its ends does not count.

        Raises:
            InvalidInputError: the file cannot be read, or holds too short a key.
        """
        try:
            return cls(Path(path).read_bytes().strip())
        except OSError as error:
            raise InvalidInputError("team key", f"cannot read {path}: {error.strerror}") from error

    @classmethod
    def of_team(cls, path: str) -> TeamKey | None:
        """The key in a file; None, for a team without one, where no file is named.

        Raises:
            InvalidInputError: the file cannot be read, or holds too short a key.
        """
        return cls.read(path) if path else None

    def sign(self, rows: Rows) -> Rows:
        """The message with its code."""
        return with_header_values(rows, {"code": self._code(rows)})

    def verify(self, rows: Rows) -> Rows:
        """The message without its code.

        Raises:
            UpdateRefusedError: it has none, or not the right one.
        """
        plain, code = without_last_entry(rows, "code")
        if plain is None or not _is_same(self._code(plain), code):
            raise UpdateRefusedError("the message is not of this team", NOT_AUTHENTIC)
        return plain

    def code_of_text(self, text: str) -> str:
        """The code of a message that is a text, as hexadecimal digits."""
        return self._code_of(b"text\n", text.encode("utf-8", "surrogatepass"))

    def is_code_of_text(self, text: str, code: str) -> bool:
        """Whether a code is that of a text; takes as long for a wrong one as for the right one."""
        return _is_same(self.code_of_text(text), code)

    def _code(self, rows: Rows) -> str:
        fields = [(name, kind.base.str, kind.shape, at) for name, kind, at in layout_of(rows)]
        layout = json.dumps([fields, rows.dtype.itemsize], separators=(",", ":"))
        return self._code_of(layout.encode("ascii"), np.ascontiguousarray(rows).tobytes())

    def _code_of(self, *parts: bytes) -> str:
        summed = self._start.copy()
        for part in parts:
            summed.update(part)
        return summed.digest()[:_CODE_BYTES].hex()


def _is_same(code: str, other: str) -> bool:
    """Whether two codes are the same, in a time that does not depend on where they differ."""
    return hmac.compare_digest(code.encode(), other.encode("utf-8", "surrogatepass"))
