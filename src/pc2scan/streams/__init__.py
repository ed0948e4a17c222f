"""Scans and clouds of recordings, message by message, for Python."""
