"""Pair two streams by stamp; see `infomap_ros.geometry.pairing`."""

from infomap_ros.geometry.pairing import StampPairing

__all__ = ["StampPairing"]
