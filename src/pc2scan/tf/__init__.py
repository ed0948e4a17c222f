"""The transforms of a whole recording."""

from pc2scan.callable_package import make_callable

make_callable(__name__)
