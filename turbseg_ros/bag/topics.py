"""The topics that this package's own bags hold."""

from __future__ import annotations

from collections.abc import Mapping

IMAGE_TOPIC = "/camera/image_raw"

# What lies below it is truth to score against, not input.
TRUTH_NAMESPACE = "ground_truth"
TRUTH_TOPIC = f"/{TRUTH_NAMESPACE}/labels"
TRUTH_BOXES_TOPIC = f"/{TRUTH_NAMESPACE}/detections"
# Images, non-zero where neither what is found nor what is missed counts, from their stamp on.
IGNORED_TOPIC = f"/{TRUTH_NAMESPACE}/ignored"

# Below it lies what the node publishes, or what it would have.
NODE_NAME = "turbseg"
RESULT_NAMESPACE = f"/{NODE_NAME}"
DIAGNOSTICS_TOPIC = "/diagnostics"
LABELS_TOPIC = f"{RESULT_NAMESPACE}/labels"

# Images among the node's results, by the first name below the node's own.
_RESULT_IMAGES = ("labels", "mask", "objects", "overlay", "motion", "clutter")
# What else it publishes; where a node of another name has both, it is one of ours.
_MARKERS, _MARKER_TYPE = "centroids", "visualization_msgs/msg/MarkerArray"


def is_result(topic: str, type_names: Mapping[str, str]) -> bool:
    """Whether a topic holds images that this package's node published.

    :param type_names: the types of all recorded topics, by topic: a node may have had another
        name, in any namespace, and its pictures another transport (`overlay/compressed`).
    """
    names = topic.split("/")
    return any(
        name in _RESULT_IMAGES
        and (
            names[place - 1] == NODE_NAME
            or type_names.get("/".join([*names[:place], _MARKERS])) == _MARKER_TYPE
        )
        for place, name in enumerate(names)
        if place
    )
