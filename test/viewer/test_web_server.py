"""Who is let in, and where a page can be served."""

from __future__ import annotations

import base64
import contextlib
import resource
import socket
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import urlopen

import msgspec
import numpy as np
import pytest
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
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


def place_of(server: WebServer) -> str:
    """Where browsers connect, without the token."""
    return server.address.partition("?")[0].replace("http", "ws")


def memory() -> float:
    """What this process holds [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def test_who_knows_the_whole_address_sees_the_run(server: WebServer) -> None:
    server.viser.scene.add_label("/secret", "where the robot is")
    page, _, data = server.address.partition("?websocket=")

    assert b"<html" in urlopen(page, timeout=10.0).read()
    told = messages(data)[0]
    block = told[told.index(ZSTANDARD) :]
    assert b"where the robot is" in zstandard.ZstdDecompressor().decompressobj().decompress(block)


@pytest.mark.parametrize(
    "more",
    [
        "",
        "?token=",
        "?token=guessed",
        "?token=%00",
        "?token=%ff%fe",
        "?token=guessed&token={token}",
    ],
)
def test_others_are_told_nothing(server: WebServer, more: str) -> None:
    server.viser.scene.add_label("/secret", "where the robot is")
    place, token = place_of(server), server.address.rpartition("=")[2]

    with pytest.raises(ConnectionClosed) as refusal:
        messages(place + more.format(token=token))

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


CAMERA = {  # with which a browser begins
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 1.0),
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
    **{"fov": 1.0, "near": 0.1, "far": 100.0, "image_height": 480, "image_width": 640},
}


def test_only_who_has_the_token_presses_a_button() -> None:
    pressed: list[str] = []
    orders = {
        name: lambda name=name: pressed.append(name) or "done" for name in ("Start", "Stop", "Home")
    }
    page = LivePage("a run", orders=orders)
    try:
        buttons = page._server.viser.gui._gui_input_handle_from_uuid
        button = next(key for key, it in buttons.items() if it.label == "Robot")

        def press(name: str) -> bytes:
            update = {"type": "GuiUpdateMessage", "uuid": button, "updates": {"value": name}}
            return bytes(msgspec.msgpack.encode(update))

        data = page.address.partition("websocket=")[2]
        place = urlsplit(data)
        with socket.create_connection((place.hostname, place.port), 10.0) as stranger:
            # All at once: the server has the messages before it looks at the token.
            handshake = (
                f"GET / HTTP/1.1\r\nHost: {place.netloc}\r\nUpgrade: websocket\r\n"
                f"Connection: Upgrade\r\nSec-WebSocket-Key: {base64.b64encode(bytes(16)).decode()}"
                f"\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {PROTOCOL[0]}\r\n\r\n"
            )
            frames = [msgspec.msgpack.encode(CAMERA), press("Home")]
            sent = [Frame(Opcode.BINARY, frame).serialize(mask=True) for frame in frames]
            stranger.sendall(handshake.encode() + b"".join(sent))
            answer = b""
            while b"with its token" not in answer:
                answer += stranger.recv(1 << 16)
        with connect(data, subprotocols=PROTOCOL, max_size=None) as operator:
            assert pressed == []
            operator.send(msgspec.msgpack.encode(CAMERA))
            until = time.monotonic() + 10.0
            while not pressed and time.monotonic() < until:
                operator.send(press("Stop"))
                time.sleep(0.1)
        assert set(pressed) == {"Stop"}
    finally:
        page.close()


PATHS = [
    "/../../../../../../../..{file}",
    "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e{file}",
    "/..%5c..%5c..%5c..%5c..%5c..%5c..%5c..{file}",
    "/{file}",
    "/%2f{file}",
    "{file}%00.js",
    "/%00",
    "/" + 5000 * "a",
    "/" + 40_000 * "a",
]


@pytest.mark.parametrize("path", PATHS)
def test_no_path_leads_out_of_the_page(server: WebServer, tmp_path: Path, path: str) -> None:
    (tmp_path / "secret.txt").write_text("the key of the team")
    host, port = urlsplit(server.address).netloc.split(":")
    asked = path.format(file=tmp_path / "secret.txt")
    with socket.create_connection((host, int(port)), timeout=10.0) as client:
        client.sendall(f"GET {asked} HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        answer = b""
        while part := client.recv(65536):
            answer += part
    assert not answer.startswith(b"HTTP/1.1 200")
    assert b"the key" not in answer
    assert messages(server.address.partition("websocket=")[2])


def test_requests_that_do_not_end_keep_nobody_out(server: WebServer) -> None:
    host, port = urlsplit(server.address).netloc.split(":")
    before = memory()
    with contextlib.ExitStack() as stack:
        for _ in range(200):
            client = stack.enter_context(socket.create_connection((host, int(port))))
            client.sendall(b"GET /?token=x HTTP/1.1\r\n")
        assert messages(server.address.partition("websocket=")[2])
        assert memory() - before < 50.0


def test_a_huge_message_of_a_stranger_is_not_kept(server: WebServer) -> None:
    size = 45_000_000
    before = memory()
    with (
        pytest.raises(ConnectionClosed) as refusal,
        connect(place_of(server), subprotocols=PROTOCOL) as stranger,
    ):
        stranger.send(bytes(size))
        stranger.recv(timeout=10.0)
    assert refusal.value.rcvd is not None
    assert refusal.value.rcvd.code == 4403
    assert memory() - before < size / 1e6
    assert messages(server.address.partition("websocket=")[2])


def test_a_browser_that_never_reads_costs_little_and_nobody_else(server: WebServer) -> None:
    """60 clouds of 3 MB are drawn, each in place of the last."""
    data = urlsplit(server.address.partition("websocket=")[2])
    ask = f"GET /?{data.query} HTTP/1.1\r\nHost: {data.netloc}\r\nUpgrade: websocket\r\n"
    ask += "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    ask += f"Sec-WebSocket-Key: {base64.b64encode(bytes(16)).decode()}\r\n"
    ask += f"Sec-WebSocket-Protocol: {PROTOCOL[0]}\r\n\r\n"
    colors = np.zeros((200_000, 3), np.uint8)
    with socket.create_connection((str(data.hostname), int(data.port or 0))) as client:
        client.sendall(ask.encode())
        assert client.recv(1024).startswith(b"HTTP/1.1 101")  # and nothing more
        before = memory()
        for number in range(60):
            points = np.full((200_000, 3), number, np.float32)
            server.viser.scene.add_point_cloud("/cloud", points, colors, precision="float32")
            time.sleep(0.02)
        assert memory() - before < 90.0
        newest = points.tobytes()[:1000]
        with connect(data.geturl(), subprotocols=PROTOCOL, max_size=None) as reader:
            while newest not in bytes(reader.recv(timeout=10.0)):
                pass


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
