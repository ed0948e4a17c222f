"""Reads the transforms of whole recordings, and looks them up by tf2's rules."""
