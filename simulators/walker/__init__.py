"""A person who walks: motion of feet and waist, known exactly, and what sensors say of it."""
