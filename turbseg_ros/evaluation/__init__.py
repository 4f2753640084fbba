"""Scores of a segmentation against truth."""

CONTRIB_BASELINES = ("gsoc", "lsbp", "cnt")
"""Those that only an OpenCV with its contrib modules has."""

BASELINES = ("mog2", "knn", *CONTRIB_BASELINES, "paper")
"""The names of the methods that there are to compare with, see `baselines.py`."""
