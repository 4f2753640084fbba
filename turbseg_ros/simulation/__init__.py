"""Turbulence and scenes with exact truth."""
