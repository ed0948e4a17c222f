"""Scans with poses, trajectories and clouds in the formats that learning and evaluation read."""

from pc2scan.arguments import make_callable

make_callable(__name__)
