"""Footage that is drawn: a square that goes over textured ground."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from support.drawn_scene import DrawnScene


@dataclass(frozen=True)
class DrawnFootage:
    """A scene's frames in colour, with what moves in them, or without."""

    scene: DrawnScene = field(default_factory=DrawnScene)
    length: int = 16
    has_masks: bool = True

    def pictures(self, first: int, count: int) -> list[npt.NDArray[np.uint8]]:
        images = list(self.scene.images(self.length))[first : first + count]
        return [np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8) for image in images]

    def masks(self, first: int, count: int) -> list[npt.NDArray[np.bool_]] | None:
        if not self.has_masks:
            return None
        return [self.scene.truth(number) for number in range(first, first + count)]
