"""The live node: images in, masks, markers and diagnostics out."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import SetBool, Trigger

from turbseg_ros.factory import motion_segmenter
from turbseg_ros.messages.events import EventMessages, EventWatch
from turbseg_ros.messages.images import frame_from_serialised
from turbseg_ros.messages.results import CentroidMarkers, outputs, views
from turbseg_ros.nodes.demand import Demand
from turbseg_ros.nodes.diagnostics import Event, NodeState, Report, Statistics, status_message
from turbseg_ros.nodes.operator_log import (
    EventLog,
    InputWatch,
    first_image_text,
    mismatch_text,
    missing_image_text,
)
from turbseg_ros.nodes.parameters import ParameterHandler
from turbseg_ros.nodes.publishers import ResultPublisher
from turbseg_ros.nodes.rcl_take import MessageTaker
from turbseg_ros.nodes.receiving_node import ReceivingNode
from turbseg_ros.nodes.subscription import MatchingSubscription
from turbseg_ros.nodes.worker import SegmentationWorker
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.region_file import marked_regions
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter
from turbseg_ros.segmentation.resolution import pixels_of

_DIAGNOSTICS_PERIOD = 1.0
# A camera that offers less than is asked for goes unheard until its offer is looked at.
_MATCH_PERIOD = 0.2
# Messages that may wait in the middleware. There nobody counts what a full queue drops, so a short
# stall of this process must not fill it.
_MIN_DEPTH = 10
# Seconds that listeners get for the last results when the node ends.
_SHUTDOWN_TIMEOUT = 1.0
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# A clock that is set back by less is being adjusted; by more, a bag begins again.
_CLOCK_JUMP = JumpThreshold(
    min_forward=None, min_backward=Duration(seconds=-0.1), on_clock_change=False
)


class TurbsegNode(ReceivingNode):
    """Segments what really moves before a camera that looks through turbulent air.

    Subscribes to `image_raw` and, if there is one, `camera_info`; publishes results below its
    own name and `/diagnostics`; serves `~/reset` and `~/enable`. While it is disabled, or nobody
    has listened to results for a while, it subscribes to nothing, and before it is enabled for
    the first time it has no segmenter.
    Callbacks only take note: images are received in one thread and segmented in another, which
    `destroy_node` ends.

    :raises ParameterError: when a parameter that it was started with is refused, or fits recorded
        clips only.
    """

    def __init__(self) -> None:
        super().__init__("turbseg", automatically_declare_parameters_from_overrides=True)
        self._parameter_handler = ParameterHandler(
            self, on_change=self._on_parameters, check=lambda p: marked_regions(p.regions)
        )
        parameters = self._parameter_handler.current
        _refuse_whole_clip(parameters)

        compressed = parameters.image_transport == "compressed"
        self._image_type: type[Any] = CompressedImage if compressed else Image
        self._statistics = Statistics()
        self._markers = CentroidMarkers(on_misfit=self._tell_misfit)
        self._event_log = EventLog.on(self.get_logger())
        events = EventMessages(
            EventWatch(lambda: self._parameter_handler.current.tracking.max_age),
            tell=self._event_log.add,
        )
        self._results = ResultPublisher(
            self,
            (*outputs(parameters.max_objects, self._markers, events), *views()),
            on_incomplete=lambda: self._statistics.count(Event.INCOMPLETE),
        )
        self._input_watch = InputWatch(self.get_logger())
        self._enabled = parameters.enabled
        # How often it was enabled again, and the last such time whose first image was told of.
        self._enabling = 0
        self._told_enabling = -1
        self._demand = Demand()
        self._work: _Work | None = None
        self._taker = MessageTaker(self)
        self._images: MatchingSubscription | None = None
        self._camera_info: list[Subscription] = []
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/enable", self._on_enable)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # These go on when the time of /clock stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=steady)
        self.create_timer(_MATCH_PERIOD, self._look_around, clock=steady)
        self._clock_jumps = self.get_clock().create_jump_callback(
            _CLOCK_JUMP, post_callback=self._on_clock_jump
        )
        if self._enabled:
            self._listen()
        else:
            self.get_logger().info("disabled: no image is heard until ~/enable is called")

    def destroy_node(self) -> None:
        """Answer the frames at hand, then take the node out of the graph."""
        try:
            if self._images is not None:
                self._images.destroy()
        finally:
            if self._work is not None:
                self._work.worker.stop()
            # What a busy listener has not got by now would go with the publishers.
            self._results.wait_until_received(_SHUTDOWN_TIMEOUT)
            super().destroy_node()

    def _listen(self) -> None:
        """Subscribe to images and calibration, and have a segmenter for them.

        :raises ParameterError: when a segmenter, or the subscription, can't be had as asked for.
        """
        if self._work is None:
            self._work = self._started_work()
        self._images = self._subscribe(self._work.worker)
        # What is latched, only the second one gets; what isn't, only the first.
        self._camera_info = [
            self.create_subscription(
                CameraInfo,
                self._camera_info_topic(),
                self._markers.calibrate,
                qos,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            )
            for qos in (qos_profile_sensor_data, _LATCHED)
        ]
        self._tell_what_is_heard(self._images, self._work)

    def _stop_listening(self) -> None:
        """Leave nothing to receive, so that standing by costs no network either."""
        if self._images is not None:
            self._images.destroy()
            self._images = None
        for subscription in self._camera_info:
            self.destroy_subscription(subscription)
        self._camera_info = []
        if self._work is not None:
            self._work.worker.end_stream()

    def _started_work(self) -> _Work:
        parameters = self._parameter_handler.current
        segmenter = motion_segmenter(parameters)
        worker = SegmentationWorker(
            segmenter,
            convert=self._frame,
            publish=self._publish,
            now=lambda: self.get_clock().now().nanoseconds,
            statistics=self._statistics,
            logger=self.get_logger(),
            queue_size=parameters.queue_size,
            on_pause=self._results.remove_marks,
        )
        worker.start()
        return _Work(segmenter, worker)

    def _subscribe(self, worker: SegmentationWorker) -> MatchingSubscription:
        parameters, enabling = self._parameter_handler.current, self._enabling
        # Resolved first, so that remapping image_raw moves the compressed topic along.
        topic = self.resolve_topic_name("image_raw")
        if self._image_type is CompressedImage:
            topic = f"{topic}/compressed"
        return MatchingSubscription(
            self,
            self._image_type,
            topic,
            lambda serialised: worker.submit(_Heard(serialised, enabling)),
            taker=self._taker,
            depth=max(parameters.queue_size, _MIN_DEPTH),
            reliability=parameters.qos.reliability,
            on_lost=lambda count: self._statistics.count(Event.LOST, count),
        )

    def _camera_info_topic(self) -> str:
        """Return the topic beside the images', as image_transport does, unless it is remapped.

        A rule that names the topic beside the images remaps it like any other.
        """
        remapped = self.resolve_topic_name("camera_info")
        if remapped != self.resolve_topic_name("camera_info", only_expand=True):
            return str(remapped)
        namespace, _, _ = self.resolve_topic_name("image_raw").rpartition("/")
        return f"{namespace}/camera_info"

    def _tell_what_is_heard(self, images: MatchingSubscription, work: _Work) -> None:
        latency = self._parameter_handler.current.latency
        self.get_logger().info(
            f"listening to {images.topic} ({images.type_name}), {images.qos}; camera_info on "
            f"{self._camera_info[0].topic_name}; latency mode {latency.mode}: results come "
            f"{work.segmenter.look_ahead} frames later"
        )

    def _publish(self, result: SegmentationResult) -> None:
        self._results.publish(result)
        self._event_log.catch_up()

    def _frame(self, heard: _Heard) -> Frame:
        wanted = self._results.image_wanted
        # Of what nobody looks at, outlines need no more than their own resolution.
        enough = pixels_of(self._parameter_handler.current.resolution.detail)
        frame = frame_from_serialised(
            heard.serialised, self._image_type, enough=None if wanted else enough
        )
        if heard.enabling > self._told_enabling:
            self._told_enabling = heard.enabling
            self.get_logger().info(
                first_image_text(heard.serialised, frame, self._image_type is CompressedImage)
            )
        return frame

    def _on_parameters(self, before: Parameters, after: Parameters) -> None:
        changed = after.as_mapping().items() - before.as_mapping().items()
        for name, value in sorted(changed):
            self.get_logger().info(f"{name} is now {value}")
        if after == before:
            self.get_logger().info("regions are read again")
        if self._work is None:
            return
        # What only the node itself reads leaves the window as it is.
        if after == before or dataclasses.replace(after, diagnostics=before.diagnostics) != before:
            self._work.worker.reconfigure(after)

    def _tell_misfit(self, reason: str) -> None:
        self.get_logger().warning(f"markers stay in pixels: {reason}")

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._work is not None:
            self._work.worker.restart("reset was called")
        response.success = True
        response.message = "the window and all tracks are cleared"
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data and not self._enabled:
            self._enabling += 1
            try:
                self._resume()
            except ParameterError as error:
                self.get_logger().error(f"not enabled: {error}")
                response.success, response.message = False, str(error)
                return response
            self._enabled = True
            self.get_logger().info("enabled")
        elif not request.data and self._enabled:
            self._enabled = False
            self._stop_listening()
            self.get_logger().info("disabled: no image is heard until ~/enable is called again")
        response.success = True
        response.message = "enabled" if request.data else "disabled"
        return response

    def _resume(self) -> None:
        self._demand.renew()
        self._statistics.expect_images()
        self._listen()

    def _on_clock_jump(self, jump: TimeJump) -> None:
        # Cameras need not follow /clock, and images from before the jump may still wait: their
        # stamps tell when the stream really begins anew.
        self.get_logger().info(f"/clock jumped by {jump.delta.nanoseconds / 1e9:.3f} s")

    def _look_around(self) -> None:
        """Follow what publishers offer, and whether anybody listens."""
        if self._enabled:
            self._heed_listeners()
        if self._images is not None:
            self._images.match()

    def _heed_listeners(self) -> None:
        patience = self._parameter_handler.current.idle_after
        wanted = self._demand.lasts(self._results.listened, patience)
        if wanted and self._images is None:
            self._resume()
        elif not wanted and self._images is not None:
            self._stop_listening()
            self.get_logger().info(
                f"idle: nobody has listened to results for {patience:g} s, so no image is heard "
                "until somebody does (idle_after:=0 to go on all the same)"
            )

    def _publish_diagnostics(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        report = self._statistics.take()
        message.status = [status_message(self.get_fully_qualified_name(), report, self._state())]
        self._diagnostics.publish(message)
        self._watch_input(report)

    def _watch_input(self, report: Report) -> None:
        images, work = self._images, self._work
        if images is not None and work is not None:
            self._input_watch.check(
                images.topic,
                report.silence,
                work.worker.pause_timeout,
                report.totals[Event.RECEIVED],
                lambda: self._why_silent(images),
            )

    def _why_silent(self, images: MatchingSubscription) -> str:
        own = dict(
            self.get_publisher_names_and_types_by_node(self.get_name(), self.get_namespace())
        )
        published = {
            topic: types
            for topic, types in self.get_topic_names_and_types()
            if topic not in own and self.count_publishers(topic)
        }
        # The graph's types of a topic are those of its subscribers, too.
        published[images.topic] = sorted(set(images.published_types))
        reliability = images.reliability.name.lower()
        return missing_image_text(
            images.topic, images.type_name, reliability, published, images.incompatibility
        )

    def _state(self) -> NodeState:
        images, parameters = self._images, self._parameter_handler.current
        work = self._work
        return NodeState(
            topic=images.topic if images else "",
            enabled=self._enabled,
            idle=self._enabled and images is None,
            publishers=images.publisher_count if images else 0,
            mismatch=(
                mismatch_text(images.topic, images.type_name, sorted(set(images.published_types)))
                if images
                else ""
            ),
            reliability=images.reliability.name.lower() if images else "",
            pause_timeout=work.worker.pause_timeout if work else 0.0,
            limits=parameters.diagnostics,
            has_time=self.get_clock().now().nanoseconds > 0,
            latency_mode=parameters.latency.mode,
            look_ahead=work.segmenter.look_ahead if work else 0,
            waiting=work.worker.waiting if work else 0,
            device=work.segmenter.device if work else "none yet",
        )


@dataclass(frozen=True)
class _Heard:
    """An image as it came, and how often the node had been enabled again by then.

    One that waits while the node is disabled and enabled is not the first since.
    """

    serialised: memoryview
    enabling: int


@dataclass(frozen=True)
class _Work:
    """What segments, and the thread that drives it."""

    segmenter: MotionSegmenter
    worker: SegmentationWorker


def _refuse_whole_clip(parameters: Parameters) -> None:
    if parameters.tracking.mode == "kmeans":
        raise ParameterError(
            "parameter tracking.mode is kmeans, which needs the whole clip before it answers; "
            "set -p tracking.mode:=kalman, or segment a recorded bag with turbseg_replay"
        )
