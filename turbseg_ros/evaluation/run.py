"""The unit of an evaluation's work: one bag through one segmenter, here or in another process."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.section import WHOLE, Section
from turbseg_ros.evaluation.baselines import Method
from turbseg_ros.evaluation.disturbance import Disturbance, DisturbanceError, DisturbedClip
from turbseg_ros.evaluation.evaluate import EvaluationError, evaluate_segmenter
from turbseg_ros.evaluation.pictures import Illustrations, Illustrator
from turbseg_ros.evaluation.scores import BagScores
from turbseg_ros.evaluation.truth import BoxesByStamp, read_ignored, read_truth
from turbseg_ros.execution import Progress
from turbseg_ros.overlay import DEFAULT_ANNOTATORS, OutlineAnnotator
from turbseg_ros.parameters import ParameterError, RegionsParameters
from turbseg_ros.region_file import marked_regions
from turbseg_ros.segmentation.frame import Frame


@dataclass(frozen=True)
class Source:
    """A bag with its truth: what tables call it, where it lies, which topics and part to take.

    Without an `image_topic` the bag must have images on one topic only. What `regions` mark to be
    ignored is left out of the scores, whoever segments.
    """

    name: str
    path: Path
    image_topic: str | None
    truth_topic: str
    section: Section = WHOLE
    regions: RegionsParameters = field(default_factory=RegionsParameters)

    @property
    def clip(self) -> str:
        """The name of what it recorded: that of the bag's folder, or its file's without suffix."""
        return self.path.stem if self.path.is_file() else self.path.name


@dataclass(frozen=True)
class RunResult:
    """What came of a run; `illustrations` only where they were asked for."""

    scores: BagScores
    illustrations: Illustrations | None


@dataclass(frozen=True)
class Run:
    """One bag through one method, under a disturbance or as it was recorded.

    Equal runs give equal scores, apart from their times; pictures are no part of that.
    """

    source: Source
    method: Method
    disturbance: Disturbance | None = None
    illustrated: bool = field(default=False, compare=False)
    foreseen: ClassVar[tuple[type[Exception], ...]] = (BagError, EvaluationError, ParameterError)

    @property
    def name(self) -> str:
        """The bag's name."""
        return self.source.name

    @property
    def full_name(self) -> str:
        """What tells it from other runs."""
        return f"{self.source.name}: {self.method.name}"

    @property
    def title(self) -> str:
        """What a progress bar calls it."""
        return f"{Path(self.source.name).name}, {self.method.name}"

    def run(self, progress: Progress = iter) -> RunResult:
        """Segment the bag and score the results.

        :raises BagError: when the bag can't be read or lacks a topic.
        :raises EvaluationError: when frames and truth don't go together, or can't be disturbed.
        """
        reader = BagReader(self.source.path, self.source.section)
        truth = read_truth(reader, self.source.truth_topic)
        # What counts in no frame may be told before the section begins.
        ignored = read_ignored(
            reader if self.source.section == WHOLE else BagReader(self.source.path)
        )
        images = BagFrames(reader, reader.find_image_topic(self.source.image_topic))
        frames: Iterable[Frame] = progress(images)
        if self.disturbance is not None:
            if isinstance(truth, BoxesByStamp):
                name = self.source.name
                raise EvaluationError(f"{name}: only a truth of masks can be disturbed, not boxes")
            frames = clip = DisturbedClip(frames, len(images), truth, self.disturbance)
            truth = clip.truth
        illustrator = self._illustrator(len(images))
        try:
            scores = evaluate_segmenter(
                self.source.name,
                frames,
                self.method.segmenter(self.source.clip, len(images)),
                truth,
                [] if illustrator is None else [illustrator],
                ignored,
                marked_regions(self.source.regions),
            )
        except DisturbanceError as error:
            raise EvaluationError(f"{self.source.name}: {error}") from error
        if self.method.recorded:
            scores = scores.without_times()
        return RunResult(
            # What numbers its objects anew in each frame can't confuse them.
            scores=scores if self.method.keeps_ids else scores.without_ids(),
            illustrations=None if illustrator is None else illustrator.illustrations(),
        )

    def _illustrator(self, frames: int) -> Illustrator | None:
        if not self.illustrated:
            return None
        keeps_ids = self.method.keeps_ids
        return Illustrator(frames, DEFAULT_ANNOTATORS if keeps_ids else (OutlineAnnotator(),))
