"""Reads the transforms of whole recordings, and looks them up by tf2's rules."""

import sys

from pc2scan.arguments import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
