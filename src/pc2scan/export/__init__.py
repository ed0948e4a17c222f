"""Scans with poses, trajectories and clouds in the formats that learning and evaluation read."""

import sys

from pc2scan.arguments import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
