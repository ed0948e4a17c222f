"""Pictures of recordings: pages to look at and to turn knobs on."""
