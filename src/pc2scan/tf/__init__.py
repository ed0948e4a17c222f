"""The transforms of a whole recording."""
