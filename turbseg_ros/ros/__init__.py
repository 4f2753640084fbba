"""The live node and its messages."""
