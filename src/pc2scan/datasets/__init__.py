"""Converts a whole dataset: each recording by itself, in worker processes; a killed run can be continued."""
