"""Conversions guarded by what they once made: folders with an input, parameters, and the expected output."""

from pc2scan.callable_package import make_callable

make_callable(__name__)
