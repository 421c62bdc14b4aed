"""Messages that only those can write who know the team's key.

A message carries a code over its rows and facts: HMAC with SHA-256 (RFC 2104,
https://doi.org/10.17487/RFC2104), cut to 16 bytes. What is repeated by a stranger is authentic, but
old: states that were told before change nothing.
"""

from __future__ import annotations

from hmac import compare_digest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, MissingExtraError, UpdateRefusedError
from infomap_ros.team.facts import layout_of, with_more_facts, without_last_fact

NOT_AUTHENTIC = "not authentic"
_SHORTEST_KEY, _CODE_BYTES = 16, 16
Rows = NDArray[np.void]


class TeamKey:
    """A secret that the robots of a team share.

    Args:
        secret: at least 16 bytes.

    Raises:
        InvalidInputError: it is shorter.
        MissingExtraError: the package cryptography is not installed.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) < _SHORTEST_KEY:
            raise InvalidInputError("team key", f"has {len(secret)} bytes, expected at least 16")
        try:
            from cryptography.hazmat.primitives import hashes, hmac
        except ImportError as error:
            raise MissingExtraError("security", "cryptography") from error
        self._start = hmac.HMAC(secret, hashes.SHA256())

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
        return with_more_facts(rows, {"code": self._code(rows).hex()})

    def verify(self, rows: Rows) -> Rows:
        """The message without its code.

        Raises:
            UpdateRefusedError: it has none, or not the right one.
        """
        plain, code = without_last_fact(rows, "code")
        if plain is None or self._code(plain).hex() != code:
            raise UpdateRefusedError("the message is not of this team", NOT_AUTHENTIC)
        return plain

    def code_of_text(self, text: str) -> str:
        """The code of a message that is a text, as hexadecimal digits."""
        summed = self._start.copy()
        summed.update(b"text\n" + text.encode("utf-8", "surrogatepass"))
        return bytes(summed.finalize()[:_CODE_BYTES]).hex()

    def is_code_of_text(self, text: str, code: str) -> bool:
        """Whether a code is that of a text; takes as long for a wrong one as for the right one."""
        return compare_digest(
            self.code_of_text(text).encode(), code.encode("utf-8", "surrogatepass")
        )

    def _code(self, rows: Rows) -> bytes:
        summed = self._start.copy()
        layout = [(name, repr(kind), at) for name, kind, at in layout_of(rows)]
        summed.update(repr((layout, rows.dtype.itemsize)).encode())
        summed.update(np.ascontiguousarray(rows).tobytes())
        return bytes(summed.finalize()[:_CODE_BYTES])
