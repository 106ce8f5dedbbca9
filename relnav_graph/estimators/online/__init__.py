"""Estimators driven online: one epoch at a time, as transactions."""
