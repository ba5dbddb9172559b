"""What can be told about packets of which no layout is known."""
