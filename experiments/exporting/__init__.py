"""Exported policies beside those in JAX."""
