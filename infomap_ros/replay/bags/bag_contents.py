"""What a bag holds beside images and poses: frames, fixed transforms, joints, the description."""

from __future__ import annotations

from infomap_ros.errors import BagError
from infomap_ros.geometry import TextRecord, TransformRecord
from infomap_ros.messages import JOINT_STATE, STRING, TF
from infomap_ros.replay.bags.reader import Recording
from infomap_ros.replay.bags.topics import Topics, check_present

_TF_TYPES = (TF, "tf/msg/tfMessage")


def types_of(bag: Recording) -> dict[str, str]:
    """Type name of each topic of a bag."""
    return {topic: channel.type_name for topic, channel in bag.topics.items()}


def frame_of(bag: Recording, topic: str) -> str:
    """Frame of the first message on a topic.

    Raises:
        BagError: there is none that can be read.
    """
    first = next(bag.records([topic]), None)
    if first is None:
        raise BagError(f"topic {topic} has no message that can be read")
    return first.record.frame_id


def tf_topics_of(types: Topics) -> list[str]:
    """Topics of transforms, fixed ones included."""
    return [name for name, kind in types.items() if kind in _TF_TYPES]


def moving_tf_topics(tf_topics: list[str]) -> list[str]:
    """Those of the topics of transforms that carry changing ones."""
    return [name for name in tf_topics if not name.endswith("tf_static")]


def static_transforms(bag: Recording, tf_topics: list[str]) -> list[TransformRecord]:
    """All transforms on those of the topics that carry fixed ones."""
    static = [name for name in tf_topics if name.endswith("tf_static")]
    records = (entry.record for entry in bag.records(static)) if static else iter(())
    return [record for record in records if isinstance(record, TransformRecord)]


def joint_topics_of(types: Topics, given: str = "") -> list[str]:
    """Topics of joint states: the given one, or all.

    Raises:
        BagError: the given one is not there.
    """
    if given:
        check_present(types, [given])
        return [given]
    return [name for name, kind in types.items() if kind == JOINT_STATE]


def description_in(bag: Recording, types: Topics) -> str:
    """The robot description that a bag holds, empty where it holds none."""
    topics = [n for n, kind in types.items() if kind == STRING and n.endswith("robot_description")]
    records = (entry.record for entry in bag.records(topics)) if topics else iter(())
    texts = (record.text for record in records if isinstance(record, TextRecord))
    return next((text for text in texts if "<robot" in text), "")
