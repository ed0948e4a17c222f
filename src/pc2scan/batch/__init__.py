"""A whole dataset: every recording of folders and lists, each converted by itself, in processes that may be killed."""

from pc2scan.callable_package import make_callable

make_callable(__name__)
