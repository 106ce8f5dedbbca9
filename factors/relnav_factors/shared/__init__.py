"""Formulas that several models share."""
