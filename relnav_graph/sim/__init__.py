"""Truth and instruments: what a pass would really have been, and what would have been seen."""
