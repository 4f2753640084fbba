"""The topics that this package's own bags hold."""

from __future__ import annotations

IMAGE_TOPIC = "/camera/image_raw"

# What lies below it is truth to score against, not input.
TRUTH_NAMESPACE = "ground_truth"
TRUTH_TOPIC = f"/{TRUTH_NAMESPACE}/labels"

# Below it lies what the node publishes, or what it would have.
RESULT_NAMESPACE = "/turbseg"
LABELS_TOPIC = f"{RESULT_NAMESPACE}/labels"
