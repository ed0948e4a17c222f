"""Reads the transforms of whole recordings, and looks them up by tf2's rules."""

from pc2scan.arguments import make_callable

make_callable(__name__)
