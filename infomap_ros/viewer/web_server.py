"""The web server of a page: viser's, open to those alone who know its address in full.

The address holds a token. A browser shows it to the server when it asks for the data, so neither
another user of the machine nor a foreign web page, which may ask any address, gets in; a foreign
page that has got hold of the token is refused by its origin.
"""

from __future__ import annotations

import contextlib
import errno
import hmac
import importlib
import io
import secrets
import socket
from typing import Any
from urllib.parse import parse_qs, urlsplit

from infomap_ros.errors import ConfigError, MissingExtraError

_NOT_ALLOWED = 4403  # status of a closed WebSocket: an application's own numbers begin at 4000
_EVERYWHERE = ("", "0.0.0.0", "::")


class WebServer:
    """Serves a viser scene.

    Args:
        title: above the controls.
        host: address to listen at; 127.0.0.1 for this machine alone.
        port: to listen at; 0 for any that is free.

    Attributes:
        viser: the server, with its ``scene`` and ``gui``.
        address: to open in a browser, with the token.

    Raises:
        MissingExtraError: viser is not installed.
        ConfigError: host or port cannot be listened at.
    """

    def __init__(self, title: str, host: str, port: int) -> None:
        viser = _viser()
        _check_free(host, port)
        self._token = secrets.token_urlsafe(16)
        with contextlib.redirect_stdout(io.StringIO()):
            self.viser = viser.ViserServer(host, port, label=title, verbose=False)
        # viser has no access control: what it asks before it tells anything to a browser.
        self._connections = self.viser._websock_server
        self._connections.on_client_connect(self._admit)
        self._connections.disconnect_all_clients()  # who came before that
        name = socket.gethostname() if host in _EVERYWHERE else host
        place = f"{name}:{self.viser.get_port()}"
        self.address = f"http://{place}/?websocket=ws://{place}/?token={self._token}"

    @property
    def is_watched(self) -> bool:
        """Whether a browser shows the page."""
        return bool(self.viser.get_clients())

    def close(self) -> None:
        """End it."""
        self.viser.stop()

    async def _admit(self, client: Any) -> None:
        """Close a connection that does not show the token, or that another page has opened."""
        connection = self._connections._live_connections[client.client_id]
        headers, query = connection.request.headers, urlsplit(connection.request.path).query
        shown = parse_qs(query).get("token", [""])[0]
        origin = headers.get("Origin")  # browsers say it, other programs need not
        is_own = origin is None or urlsplit(origin).netloc == headers.get("Host")
        if not (is_own and hmac.compare_digest(shown.encode(), self._token.encode())):
            await connection.close(_NOT_ALLOWED, "open the whole address, with its token")


def _viser() -> Any:
    try:
        found = importlib.import_module("viser")
    except ImportError as error:
        raise MissingExtraError("viewer", "viser") from error
    importlib.import_module("rich").get_console().quiet = True  # where viser alone prints
    return found


def _check_free(host: str, port: int) -> None:
    """Refuse an address that cannot be listened at; viser would take another port."""
    try:
        family, *_, place = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(place)
    except OSError as error:
        taken = error.errno in (errno.EADDRINUSE, errno.EACCES)
        expected = f"a place to serve the page at ({error.strerror or error})"
        if taken:
            raise ConfigError("port", port, expected) from error
        raise ConfigError("host", host, expected) from error
