"""`turbseg_evaluate`: bags through the method, scored against the truth that they hold."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.errors import UsageError, executable
from turbseg_ros.cli.options import add_parameter_options, parameters_from, with_progress
from turbseg_ros.evaluation.evaluate import (
    EvaluationError,
    evaluate_labels,
    evaluate_segmenter,
)
from turbseg_ros.evaluation.labels import (
    LABELS_TOPIC,
    TRUTH_TOPIC,
    LabelsByStamp,
    read_labels,
)
from turbseg_ros.evaluation.replay import BagFrames
from turbseg_ros.evaluation.scores import BagScores, Table, write_json
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.pipeline import MotionSegmenter


@executable("turbseg_evaluate")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; give its exit status, 1 when a bag couldn't be scored."""
    options = _parser().parse_args(arguments)
    if options.predictions is not None and len(options.bags) > 1:
        raise UsageError("--predictions are those of one BAG; give one")
    parameters = parameters_from(options)
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)

    table = Table.of([str(bag) for bag in options.bags])
    print(table.head)
    scored: list[BagScores] = []
    for bag in options.bags:
        scores = _evaluated_or_reported(bag, parameters, options)
        if scores is not None:
            print(table.row(scores), flush=True)
            scored.append(scores)
    if len(scored) > 1:
        print(table.mean(scored))
    if options.json is not None and scored:
        # Who made recorded predictions, and with which parameters, is not known.
        known = {} if options.predictions is not None else parameters.as_mapping()
        write_json(options.json, scored, known)
    return 0 if len(scored) == len(options.bags) else 1


def _evaluated_or_reported(
    bag: Path, parameters: Parameters, options: argparse.Namespace
) -> BagScores | None:
    """Score a bag; when that fails, say so and give None, for the sake of the other bags."""
    try:
        return _evaluated(bag, parameters, options)
    except (BagError, EvaluationError) as error:
        print(f"turbseg_evaluate: {error}", file=sys.stderr)
    except Exception:
        logging.getLogger(__name__).exception("%s could not be evaluated", bag)
    return None


def _evaluated(bag: Path, parameters: Parameters, options: argparse.Namespace) -> BagScores:
    reader = BagReader(bag)
    truth = LabelsByStamp(read_labels(reader, options.truth_topic))
    if options.predictions is not None:
        predictions = read_labels(BagReader(options.predictions), options.labels_topic)
        return evaluate_labels(str(bag), predictions, truth)
    frames = BagFrames(reader, reader.find_image_topic(options.image_topic))
    return evaluate_segmenter(
        str(bag), with_progress(frames, bag.name), MotionSegmenter(parameters), truth
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="turbseg_evaluate",
        description="Segment bags and score the results against the truth that the bags hold.",
    )
    parser.add_argument(
        "bags", nargs="+", type=Path, metavar="BAG", help="rosbag2 directory or MCAP file"
    )
    parser.add_argument(
        "--image-topic", metavar="T", help="images to segment, where bags have several topics"
    )
    parser.add_argument(
        "--truth-topic", default=TRUTH_TOPIC, metavar="T", help="true labels (%(default)s)"
    )
    parser.add_argument("--json", type=Path, metavar="F", help="also write the scores as JSON")
    recorded = parser.add_argument_group("recorded results, instead of segmenting")
    recorded.add_argument(
        "--predictions", type=Path, metavar="BAG", help="bag with the labels found in BAG"
    )
    recorded.add_argument(
        "--labels-topic", default=LABELS_TOPIC, metavar="T", help="found labels (%(default)s)"
    )
    add_parameter_options(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
