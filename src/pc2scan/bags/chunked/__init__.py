"""Common parts of containers that store messages in chunks."""
