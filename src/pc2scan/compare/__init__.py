"""Compares the scans and clouds of two recordings, message by message."""
