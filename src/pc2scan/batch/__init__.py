"""Converts a whole dataset: each recording by itself, in worker processes; a killed run can be continued."""

import sys

from pc2scan.arguments import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
