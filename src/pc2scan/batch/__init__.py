"""Converts a whole dataset: each recording by itself, in worker processes; a killed run can be continued."""

from pc2scan.arguments import make_callable

make_callable(__name__)
