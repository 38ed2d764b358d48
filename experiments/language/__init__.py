"""The worth of people's sentences, and how well they are understood."""
