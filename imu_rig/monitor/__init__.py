"""Watch devices live: figures in a terminal, a plot in a process of its own; nothing is kept."""
