"""The pipeline from a recording to a recording."""
