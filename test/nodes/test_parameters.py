"""The package's parameters as a node has them; in one process, nothing goes over the network."""

import math

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from turbseg_ros.nodes.parameters import ParameterHandler, descriptor_of
from turbseg_ros.parameters import (
    Declaration,
    ParameterError,
    Parameters,
    declarations,
)
from turbseg_ros.region_file import marked_regions

LIVE_FLOAT = "diagnostics.min_rate"
READ_ONLY = "queue_size"


@pytest.fixture
def start(context):
    """Make nodes as the command line would: with arguments after --ros-args."""
    nodes = []

    def start(*arguments):
        node = Node(
            "turbseg",
            context=context,
            cli_args=["--ros-args", *arguments],
            automatically_declare_parameters_from_overrides=True,
        )
        nodes.append(node)
        changes = []
        handler = ParameterHandler(
            node,
            lambda *change: changes.append(change),
            check=lambda parameters: marked_regions(parameters.regions),
        )
        return node, handler, changes

    yield start
    for node in nodes:
        node.destroy_node()


def test_every_parameter_is_declared_with_its_default_and_described(start):
    node, handler, _ = start()
    assert handler.current == Parameters()
    for declaration in declarations():
        assert node.get_parameter(declaration.name).value == declaration.default
        descriptor = node.describe_parameter(declaration.name)
        assert declaration.description in descriptor.description
        assert descriptor.read_only == declaration.read_only


def test_a_file_of_regions_is_read_before_it_is_taken(start, tmp_path):
    node, handler, changes = start()
    missing = RosParameter("regions.file", value=str(tmp_path / "missing.yaml"))
    refused = node.set_parameters_atomically([missing])
    assert not refused.successful
    assert refused.reason == (
        f"parameter regions.file: {tmp_path}/missing.yaml: No such file or directory"
    )
    assert handler.current == Parameters()
    assert not changes


def test_a_file_that_is_set_again_is_told_again(start, tmp_path):
    file = tmp_path / "regions.yaml"
    file.write_text("regions: [{polygon: [[0, 0], [1, 0], [1, 1]]}]")
    node, handler, changes = start()
    given = RosParameter("regions.file", value=str(file))
    for _ in range(2):
        assert node.set_parameters_atomically([given]).successful
    (_, first), again = changes
    assert first == handler.current
    assert again == (first, first)


def test_an_integer_range_and_unit_are_described():
    descriptor = descriptor_of(Declaration("a.b", 4, "How many.", "frames", minimum=1))
    assert descriptor.description == "How many. Unit: frames."
    (limits,) = descriptor.integer_range
    assert (limits.from_value, limits.to_value) == (1, 2**63 - 1)
    assert not descriptor.floating_point_range


def test_a_floating_range_is_described():
    (limits,) = descriptor_of(Declaration("a", 0.5, "x", maximum=1)).floating_point_range
    assert (limits.from_value, limits.to_value) == (-math.inf, 1.0)


def test_choices_are_described():
    descriptor = descriptor_of(Declaration("a", "x", "Which.", choices=("x", "y")))
    assert descriptor.additional_constraints == "One of x, y."


def test_values_given_at_start_are_taken(start):
    node, handler, _ = start("-p", "queue_size:=3", "-p", "image_transport:=compressed")
    assert handler.current.queue_size == 3
    assert handler.current.image_transport == "compressed"
    assert node.get_parameter("queue_size").value == 3
    assert node.describe_parameter("queue_size").integer_range


def test_values_come_from_a_parameter_file(start, tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("/**:\n  ros__parameters:\n    queue_size: 5\n    flow: {interval: 2}\n")
    _, handler, _ = start("--params-file", str(file))
    assert (handler.current.queue_size, handler.current.flow.interval) == (5, 2)


def test_a_whole_number_will_do_for_a_float(start):
    node, handler, changes = start("-p", f"{LIVE_FLOAT}:=7")
    assert handler.current.diagnostics.min_rate == 7.0
    (result,) = node.set_parameters([RosParameter(LIVE_FLOAT, value=9)])
    assert result.successful
    assert node.get_parameter(LIVE_FLOAT).value == 9.0
    ((before, after),) = changes
    assert (before.diagnostics.min_rate, after.diagnostics.min_rate) == (7.0, 9.0)
    assert handler.current == after


@pytest.mark.parametrize(
    ("argument", "reason"),
    [
        ("queue_size:=0", "queue_size lies between 1"),
        ("queue_size:=many", "queue_size takes a whole number"),
        ("queue_size:=2.5", "queue_size takes a whole number"),
        ("image_transport:=theora", "image_transport is one of raw, compressed"),
        (f"{LIVE_FLOAT}:=.nan", "min_rate lies between"),
        (f"{LIVE_FLOAT}:=[1.0, 2.0]", "min_rate takes a number"),
    ],
)
def test_a_refused_value_at_start_is_an_error_that_names_it(start, argument, reason):
    with pytest.raises(ParameterError, match=reason):
        start("-p", argument)


def test_an_unknown_name_is_warned_about_and_left_out(start, capfd):
    node, handler, _ = start("-p", "flow.intervl:=2", "-p", "use_sim_time:=true")
    assert handler.current == Parameters()
    assert not node.has_parameter("flow.intervl")
    printed = capfd.readouterr().err
    assert "unknown parameter flow.intervl; did you mean flow.interval?" in printed
    assert "use_sim_time" not in printed


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({READ_ONLY: 3}, "read-only"),
        ({LIVE_FLOAT: -1.0}, "range"),
        ({LIVE_FLOAT: math.nan}, "range"),
        ({LIVE_FLOAT: "fast"}, "type"),
        ({LIVE_FLOAT: 5.0, READ_ONLY: 3}, "read-only"),
    ],
    ids=str,
)
def test_a_refused_change_changes_nothing_and_says_why(start, changes, reason):
    node, handler, seen = start()
    result = node.set_parameters_atomically(
        [RosParameter(name, value=value) for name, value in changes.items()]
    )
    assert not result.successful
    assert reason in result.reason
    assert handler.current == Parameters()
    assert node.get_parameter(LIVE_FLOAT).value == 0.0
    assert seen == []


def test_a_change_to_the_same_value_is_none(start):
    node, _, seen = start()
    (result,) = node.set_parameters([RosParameter(LIVE_FLOAT, value=0.0)])
    assert result.successful
    assert seen == []


IDLE_LINE = (
    "outline.threshold has no effect while refine.mode is pretrained; "
    "it is used with refine.mode none or optimise"
)


def test_a_value_at_start_that_has_no_effect_is_warned_about(start, capfd):
    start("-p", "outline.threshold:=3.5")
    assert IDLE_LINE in capfd.readouterr().err


def test_a_change_that_has_no_effect_is_warned_about(start, capfd):
    node, handler, _ = start()
    assert "no effect" not in capfd.readouterr().err
    node.set_parameters([RosParameter("outline.threshold", value=3.5)])
    assert handler.current.outline.threshold == 3.5
    assert IDLE_LINE in capfd.readouterr().err


def test_nothing_is_said_of_what_has_an_effect(start, capfd):
    start("-p", "refine.mode:=none", "-p", "outline.threshold:=3.5", "-p", "queue_size:=4")
    assert "no effect" not in capfd.readouterr().err


def test_a_condition_is_described():
    described = {each.name: descriptor_of(each).description for each in declarations()}
    condition = "Used only with outline.method background and refine.mode none or optimise."
    assert described["outline.threshold"].endswith(condition)
    assert described["queue_size"].endswith("Used by the live node only.")


def test_a_former_name_given_at_start_sets_the_parameter_under_its_present_one(start):
    node, handler, _ = start("-p", "tracking.patience:=77")
    assert handler.current.tracking.max_age == 77
    assert node.get_parameter("tracking.max_age").value == 77
    assert not node.has_parameter("tracking.patience")


def test_a_parameter_that_is_gone_is_left_out_of_the_node(start):
    node, handler, _ = start("-p", "tracking.travel:=2.0")
    assert handler.current == Parameters()
    assert not node.has_parameter("tracking.travel")
