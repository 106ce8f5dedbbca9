"""Quantities computed from the state, for tables and covariances."""
