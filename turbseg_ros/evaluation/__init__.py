"""Scores of a segmentation against truth."""

BASELINES = ("mog2", "knn", "paper")
"""The names of the methods that there are to compare with, see `baselines.py`."""
