"""One scan of several messages: which of them belong together, and the projection of all their points."""
