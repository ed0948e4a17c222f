"""Reads and writes files: sources, destinations, compression, temporary copies."""
