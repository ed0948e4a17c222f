"""What a recording shows, and what is said about it: facts of the first messages, and checks."""
