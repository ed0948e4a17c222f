"""Files: where bytes come from and go to."""
