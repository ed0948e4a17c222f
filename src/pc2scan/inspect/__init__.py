"""Shows the content of recordings, and checks them; nothing is changed."""
