"""Finds what moves in frames to come, beside what else is done: in threads of its own."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.flow import Flow, FlowBackend, dis_flow
from turbseg_ros.segmentation.moving import Moving, measured_motions, what_moves
from turbseg_ros.segmentation.window import Neighbourhood


@dataclass(frozen=True)
class MotionJob:
    """A frame in which motion is to be measured, and how.

    `near` is the largest interval of the short time, `size` the width and height that areas are
    told at.
    """

    index: int
    surroundings: Neighbourhood
    near: int
    parameters: Parameters
    size: tuple[int, int]


class MotionWorker:
    """Measures motion in the frames that are ordered, one after the other.

    :param threads: threads in which flow is computed.
    :param flow: computes the optical flow; without one, OpenCV's DIS does.
    """

    def __init__(self, threads: int, flow: FlowBackend | None = None) -> None:
        self._flow = flow
        self._executor = ThreadPoolExecutor(threads, thread_name_prefix="flow")
        self._motion_worker = ThreadPoolExecutor(1, thread_name_prefix="motion")
        self._ordered: dict[int, Future[Moving | None]] = {}

    @property
    def device(self) -> str:
        """Where optical flow is computed: cpu or cuda."""
        return "cpu" if self._flow is None else self._flow.device

    def reset(self) -> None:
        """Forget what was ordered."""
        for found in self._ordered.values():
            found.cancel()
        self._ordered.clear()

    def __contains__(self, index: int) -> bool:
        return index in self._ordered

    def __len__(self) -> int:
        """How many frames are ordered and not taken."""
        return len(self._ordered)

    def order(self, order: MotionJob) -> None:
        """Have what moves in a frame found; orders come in the order of the frames."""
        self._ordered[order.index] = self._motion_worker.submit(self._find, order)

    def take(self, index: int) -> Moving | None:
        """Wait for what moves in a frame; None where there was too little to compare it with."""
        return self._ordered.pop(index).result()

    def drop(self, index: int) -> None:
        """Forget what was ordered of a frame, if it was."""
        self._ordered.pop(index, None)

    def _find(self, order: MotionJob) -> Moving | None:
        if len(order.surroundings.neighbours) < 2:
            return None
        flows = self._flows(order)
        motions = measured_motions(order.surroundings, flows, order.near, order.parameters)
        return what_moves(motions, order.parameters, order.size)

    def _flows(self, order: MotionJob) -> dict[int, Flow]:
        """Return the flows of a frame to its neighbours, which are aligned to it."""
        grey, aligned = order.surroundings.grey, order.surroundings.aligned()
        if self._flow is not None:
            return self._flow.flows_to(grey, aligned)
        iterations = order.parameters.flow.variational_iterations
        flows = self._executor.map(
            lambda neighbour: dis_flow(grey, neighbour, iterations), aligned.values()
        )
        return dict(zip(aligned, flows, strict=True))
