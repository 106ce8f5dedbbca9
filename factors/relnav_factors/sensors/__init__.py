"""Measurement models, one file each."""
