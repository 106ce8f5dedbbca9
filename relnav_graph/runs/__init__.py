"""One place that makes a run: a pass opened or flown, and estimators run on it."""
