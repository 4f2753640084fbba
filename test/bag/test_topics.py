"""Which recorded topics are the node's own results."""

from __future__ import annotations

import pytest

from support.result_topics import fresh_outputs
from turbseg_ros.bag.topics import is_result
from turbseg_ros.messages.results import IMAGE_TYPE, views

PUBLISHED = [each.name for each in (*fresh_outputs(1), *views()) if each.type_name == IMAGE_TYPE]


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("node", ["/turbseg", "/north/turbseg"])
def test_every_image_that_is_published_is_known_for_a_result(node: str, name: str) -> None:
    assert is_result(f"{node}/{name}", {})


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_node_of_another_name_is_known_by_its_markers(name: str) -> None:
    types = {"/eye/centroids": "visualization_msgs/msg/MarkerArray"}
    assert is_result(f"/eye/{name}", types)
    assert not is_result(f"/eye/{name}", {})
