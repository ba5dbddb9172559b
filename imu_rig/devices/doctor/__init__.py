"""What of this machine stands in the way of a session or a recording, and what to do about it."""
