"""Golden cases: folders with an input, parameters and the expected output, against which conversions are checked."""

from pc2scan.arguments import make_callable

make_callable(__name__)
