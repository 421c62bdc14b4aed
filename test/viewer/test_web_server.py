"""Who is let in, and where a page can be served."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from importlib.metadata import version
from urllib.request import urlopen

import pytest
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from infomap_ros.errors import ConfigError, MissingExtraError
from infomap_ros.viewer import LivePage, PageConfig
from infomap_ros.viewer.live_page import WebServer

ZSTANDARD = b"\x28\xb5\x2f\xfd"  # with which a compressed block begins
PROTOCOL = [Subprotocol(f"viser-v{version('viser')}")]


@pytest.fixture
def server() -> Iterator[WebServer]:
    running = WebServer("a run", "127.0.0.1", 0)
    yield running
    running.close()


def messages(address: str, count: int = 1, origin: str | None = None) -> list[bytes]:
    """The first things that the server tells a browser that asks at an address."""
    page = None if origin is None else Origin(origin)
    with connect(address, subprotocols=PROTOCOL, max_size=None, origin=page) as socket_:
        return [bytes(socket_.recv(timeout=10.0)) for _ in range(count)]


def test_who_knows_the_whole_address_sees_the_run(server: WebServer) -> None:
    server.viser.scene.add_label("/secret", "where the robot is")
    page, _, data = server.address.partition("?websocket=")

    assert b"<html" in urlopen(page, timeout=10.0).read()
    told = messages(data)[0]
    block = told[told.index(ZSTANDARD) :]
    assert b"where the robot is" in zstandard.ZstdDecompressor().decompressobj().decompress(block)


@pytest.mark.parametrize("more", ["", "?token=", "?token=guessed", "?token=%00"])
def test_others_are_told_nothing(server: WebServer, more: str) -> None:
    server.viser.scene.add_label("/secret", "where the robot is")
    place = server.address.partition("?")[0].replace("http", "ws")

    with pytest.raises(ConnectionClosed) as refusal:
        messages(place + more)

    assert refusal.value.rcvd is not None
    assert refusal.value.rcvd.code == 4403
    assert not server.is_watched


def test_a_foreign_page_gets_nothing_though_it_has_the_token(server: WebServer) -> None:
    page, _, data = server.address.partition("/?websocket=")
    assert messages(data, origin=page)
    with pytest.raises(ConnectionClosed) as refusal:
        messages(data, origin="http://elsewhere.example")
    assert refusal.value.rcvd is not None
    assert refusal.value.rcvd.code == 4403


def test_two_pages_have_two_tokens(server: WebServer) -> None:
    other = WebServer("another run", "127.0.0.1", 0)
    try:
        place, token = other.address.partition("websocket=")[2], server.address.rpartition("=")[2]
        with pytest.raises(ConnectionClosed):
            messages(f"{place.rpartition('=')[0]}={token}")
    finally:
        other.close()


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError) as refusal:
            LivePage("a run", PageConfig(port=port))

    assert (refusal.value.parameter, refusal.value.value) == ("port", port)


@pytest.mark.parametrize("host", ["nowhere.invalid", "203.0.113.7"])
def test_an_address_that_is_not_of_this_machine_is_named(host: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        LivePage("a run", PageConfig(host=host))

    assert (refusal.value.parameter, refusal.value.value) == ("host", host)


def test_where_viser_is_missing_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "viser", None)

    with pytest.raises(MissingExtraError, match=r"infomap_ros\[viewer\]"):
        LivePage("a run")
