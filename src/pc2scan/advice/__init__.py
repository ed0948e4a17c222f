"""What a recording shows, and warnings about it: facts of the first messages, and checks."""
