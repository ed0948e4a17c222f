"""Scans with poses, trajectories and clouds in the formats that learning and evaluation read."""
