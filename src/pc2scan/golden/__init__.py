"""Golden cases: folders with an input, parameters and the expected output, against which conversions are checked."""

import sys

from pc2scan.arguments import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
