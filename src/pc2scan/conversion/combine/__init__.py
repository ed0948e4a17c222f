"""Makes one scan of several messages: finds which messages belong together, and projects all their points."""
