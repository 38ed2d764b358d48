"""What people's sentences are worth, and how well they are understood."""
