"""MCAP bags in and out."""
