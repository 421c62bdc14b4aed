"""The quality of service of every topic, as three named profiles.

Each publisher and subscription may be overridden by the ROS parameters
``qos_overrides.<topic>.<publisher|subscription>.<history|depth|reliability|durability>``.
"""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

_CURRENT = Duration(seconds=2)
"""Longer than a subscriber on a busy machine takes to fetch a sample."""
_LEASE = Duration(seconds=1)
"""Of a publisher's sign of life, which the middleware gives in a thread of its own."""
_LONG = 1000  # messages; a node that plans for minutes is sent two a second


def sensor_data(depth: int = 10) -> QoSProfile:
    """Profile for incoming sensor streams: best effort, so that any publisher fits."""
    return _newest(depth, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)


def stream(depth: int = 10) -> QoSProfile:
    """Profile for outgoing streams: reliable, which both kinds of subscription accept."""
    return _newest(depth, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def latched(depth: int = 1) -> QoSProfile:
    """Profile for maps and descriptions: who comes late gets the last one (or `depth`)."""
    return _newest(depth, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)


def current() -> QoSProfile:
    """As `latched`, for what is built only while somebody subscribes: it is not kept for long.

    Who comes late would get what the last subscriber got, however old. The publisher builds it
    anew for each new subscriber instead.
    """
    profile = latched()
    profile.lifespan = _CURRENT
    return profile


def alive(profile: QoSProfile) -> QoSProfile:
    """As `profile`; subscribers of the same quality notice a killed publisher within a second."""
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = _LEASE
    return profile


def complete(profile: QoSProfile) -> QoSProfile:
    """As `profile`, with nothing lost: no message gives way to a newer one, or goes astray."""
    whole = _newest(_LONG, ReliabilityPolicy.RELIABLE, profile.durability)
    whole.liveliness = profile.liveliness
    whole.liveliness_lease_duration = profile.liveliness_lease_duration
    return whole


def _newest(depth: int, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    """Profile that keeps the newest `depth` messages."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability
    )


def overridable() -> QoSOverridingOptions:
    """Let ROS parameters override history, depth, reliability and durability."""
    names = "HISTORY", "DEPTH", "RELIABILITY", "DURABILITY"
    return QoSOverridingOptions([QoSPolicyKind[name] for name in names])
