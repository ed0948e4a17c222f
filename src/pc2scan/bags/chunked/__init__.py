"""What containers that keep messages in chunks have in common."""
