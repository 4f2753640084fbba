"""The refining network as it is shipped, run by OpenCV: nothing of this needs torch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from turbseg_ros.arrays import Map
from turbseg_ros.learning.torch_import import NetworkError
from turbseg_ros.learning.window_input import CHANNELS, SIDE, at_window_size, window_input
from turbseg_ros.segmentation.foreground import ObjectCrop

SHIPPED = Path(__file__).parent / "weights" / "refine_net.onnx"
"""The network that comes with the package; `turbseg_train` made it."""


# OpenCV 5 has two engines: on small networks the older one, 4's only one, takes a third less time.
_ENGINE = [cv2.dnn.ENGINE_CLASSIC] if hasattr(cv2.dnn, "ENGINE_CLASSIC") else []


class PretrainedRefiner:
    """Tells objects from background in one pass of a network over each crop.

    :raises NetworkError: when the file is missing or holds no such network.
    """

    def __init__(self, path: Path = SHIPPED) -> None:
        if not path.is_file():
            raise NetworkError(f"{path}: no such file; turbseg_train makes one")
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path), *_ENGINE)
            judged = self._judge(np.zeros((len(CHANNELS), SIDE, SIDE), np.float32))
        except cv2.error as error:
            reason = " ".join(str(error.err or error).split())
            raise NetworkError(f"{path}: not a network for refine.mode ({reason})") from error
        if judged.shape != (SIDE, SIDE):
            raise NetworkError(f"{path}: gives {judged.shape}, not one map of {SIDE}x{SIDE}")

    def refine(self, crops: Sequence[ObjectCrop]) -> list[Map]:
        """Return for each crop, hxw, the probability from 0 to 1 that a pixel is an object's."""
        return [at_window_size(self._judge(window_input(each)), each) for each in crops]

    def _judge(self, maps: Map) -> Map:
        self._net.setInput(maps[None])
        logits = np.squeeze(self._net.forward())
        probability: Map = 1.0 / (1.0 + np.exp(-logits))
        return probability
