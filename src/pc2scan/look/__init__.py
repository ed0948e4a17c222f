"""Pictures of recordings: interactive HTML pages, figures and maps."""
