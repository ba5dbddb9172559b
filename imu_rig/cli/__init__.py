"""The command line: thin commands that parse, call and render. Nothing imports this room."""
