"""What recordings have: `info`, `check` and `tf`, pages, figures and maps; nothing is changed."""
