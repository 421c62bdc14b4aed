"""A cable between two network namespaces that loses frames and delays them.

Where the kernel has no netem scheduler, this does the same from outside: each namespace has one end
of a pair of virtual cards, this process holds the other ends and carries frames between them.
"""

from __future__ import annotations

import array
import fcntl
import heapq
import os
import random
import select
import socket
import struct
import subprocess
import threading
import time
from types import TracebackType
from typing import Self

_SIOCETHTOOL, _ETHTOOL_STXCSUM = 0x8946, 0x17
_ALL_PROTOCOLS = 0x0003
_OUTGOING = 4


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, timeout=20)


def _complete_checksums(card: str) -> None:
    """Have frames leave a virtual card with their checksums, which it leaves to hardware."""
    value = array.array("I", [_ETHTOOL_STXCSUM, 0])
    request = struct.pack("16sP", card.encode(), value.buffer_info()[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, _SIOCETHTOOL, request)


class LossyLink:
    """Two hosts as network namespaces, with the addresses 10.77.0.1 and 10.77.0.2.

    Args:
        loss: share of the frames that are lost, in each direction.
        delay: of the others [s].

    Attributes:
        carried: number of frames that arrived.
        lost: number of those that did not.
    """

    def __init__(self, loss: float, delay: float) -> None:
        self._loss, self._delay, self._random = loss, delay, random.Random(1)
        tag = f"{os.getpid() % 100000:x}"
        self.hosts = [f"infomap-{tag}-{end}" for end in "ab"]
        self._inner = [f"im{tag}{end}0" for end in "ab"]
        self._outer = [f"im{tag}{end}1" for end in "ab"]
        self.carried = self.lost = 0
        self._stop = threading.Event()

    def __enter__(self) -> Self:
        try:
            for number, host in enumerate(self.hosts):
                inner, outer = self._inner[number], self._outer[number]
                _ip("netns", "add", host)
                _ip("link", "add", outer, "type", "veth", "peer", "name", inner)
                _complete_checksums(inner)
                _ip("link", "set", inner, "netns", host)
                address = f"10.77.0.{number + 1}/24"
                _ip("-n", host, "address", "add", address, "dev", inner)
                for words in (("lo", "up"), (inner, "up")):
                    _ip("-n", host, "link", "set", *words)
                _ip("-n", host, "route", "add", "224.0.0.0/4", "dev", inner)
                _ip("link", "set", outer, "promisc", "on", "up")
            self._cards = [self._card(name) for name in self._outer]
        except BaseException:
            self._remove()
            raise
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join(5.0)
        for card in self._cards:
            card.close()
        self._remove()

    def command(self, host: int, *words: str) -> list[str]:
        """A command line that runs on a host."""
        return ["ip", "netns", "exec", self.hosts[host], *words]

    def _remove(self) -> None:
        for host in self.hosts:
            subprocess.run(["ip", "netns", "del", host], capture_output=True, timeout=20)
        for outer in self._outer:
            subprocess.run(["ip", "link", "del", outer], capture_output=True, timeout=20)

    @staticmethod
    def _card(name: str) -> socket.socket:
        card = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL_PROTOCOLS))
        card.bind((name, 0))
        return card

    def _carry(self) -> None:
        """Carry frames until the end."""
        in_transit: list[tuple[float, int, socket.socket, bytes]] = []
        count = 0
        while not self._stop.is_set():
            now = time.monotonic()
            while in_transit and in_transit[0][0] <= now:
                _, _, card, frame = heapq.heappop(in_transit)
                card.send(frame)
                self.carried += 1
            wait = min(0.05, in_transit[0][0] - now) if in_transit else 0.05
            for card in select.select(self._cards, [], [], wait)[0]:
                frame, sender = card.recvfrom(65536)
                if sender[2] == _OUTGOING:
                    continue
                if self._random.random() < self._loss:
                    self.lost += 1
                    continue
                other = self._cards[1 - self._cards.index(card)]
                count += 1
                heapq.heappush(in_transit, (time.monotonic() + self._delay, count, other, frame))
