"""Foreign recordings: text tables of other tools and loggers, read into sample blocks."""
