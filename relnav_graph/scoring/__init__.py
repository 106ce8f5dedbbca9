"""Tracks against truth: errors, consistency, bounds, observability; tables of them."""
