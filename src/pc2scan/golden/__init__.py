"""Conversions guarded by what they once made: folders with an input, parameters, and the expected output."""
