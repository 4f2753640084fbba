"""A method of evaluation that ends its process; workers find it by its module's name."""

from __future__ import annotations

import os
from dataclasses import dataclass

from turbseg_ros.segmentation.frame import Segmenter


@dataclass(frozen=True)
class Deadly:
    """Takes the process down that makes a segmenter of it, as running out of memory does."""

    name: str = "deadly"
    keeps_ids: bool = True
    recorded: bool = False

    def segmenter(self, clip: str = "", frames: int = 0) -> Segmenter:
        os._exit(1)
