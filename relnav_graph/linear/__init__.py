"""A pass linearised: whitened rows, update, filter, smoother, elimination; GTSAM adapters."""
