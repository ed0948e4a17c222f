"""What is in a recording: read, counted, and never changed."""
