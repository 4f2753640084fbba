"""Quality-of-service profiles as rosbag2 writes them into bags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    InvalidQoSProfileException,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

_POLICIES = {
    "history": HistoryPolicy,
    "reliability": ReliabilityPolicy,
    "durability": DurabilityPolicy,
    "liveliness": LivelinessPolicy,
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")
# What the middleware can hold.
_MAX_DEPTH = 2**31 - 1
_NANOSECONDS = 1_000_000_000


def to_metadata(profile: QoSProfile) -> dict[str, Any]:
    """Return a profile as an entry of `offered_qos_profiles`, metadata version 9."""
    return {
        "history": profile.history.short_key,
        "depth": profile.depth,
        "reliability": profile.reliability.short_key,
        "durability": profile.durability.short_key,
        "deadline": _seconds(profile.deadline),
        "lifespan": _seconds(profile.lifespan),
        "liveliness": profile.liveliness.short_key,
        "liveliness_lease_duration": _seconds(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def to_yaml(profiles: Sequence[QoSProfile]) -> str:
    """Return profiles as the text that a channel's metadata holds."""
    return yaml.safe_dump([to_metadata(profile) for profile in profiles], sort_keys=False)


def from_yaml(text: str) -> tuple[QoSProfile, ...]:
    """Read the profiles in a channel's metadata, policies as words or, as before Jazzy, numbers.

    :raises ValueError: when `text` holds no list of profiles.
    """
    try:
        entries = yaml.safe_load(text) or []
        return tuple(_from_metadata(entry) for entry in entries)
    except (
        *(yaml.YAMLError, KeyError, TypeError, AttributeError),
        # rclpy's own checks, and numbers that no profile can hold.
        *(AssertionError, InvalidQoSProfileException, OverflowError, ValueError, RecursionError),
    ) as error:
        raise ValueError("QoS profiles that can't be read") from error


def _from_metadata(entry: Mapping[str, Any]) -> QoSProfile:
    policies = {name: _policy(kind, entry[name]) for name, kind in _POLICIES.items()}
    durations = {name: _duration(entry[name]) for name in _DURATIONS}
    depth = int(entry["depth"])
    if depth > _MAX_DEPTH:
        raise ValueError(f"depth {depth}")
    return QoSProfile(depth=depth, **policies, **durations)


def _policy(kind: Any, value: str | int) -> Any:
    return kind.get_from_short_key(value) if isinstance(value, str) else kind(value)


def _seconds(duration: Duration) -> dict[str, int]:
    sec, nsec = divmod(duration.nanoseconds, _NANOSECONDS)
    return {"sec": sec, "nsec": nsec}


def _duration(value: Mapping[str, int]) -> Duration:
    # rosbag2 writes 2^63-1 for "for ever", older versions a little more.
    nanoseconds = int(value["sec"]) * _NANOSECONDS + int(value["nsec"])
    return Duration(nanoseconds=min(nanoseconds, 2**63 - 1))
