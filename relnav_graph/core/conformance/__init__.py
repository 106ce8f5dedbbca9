"""Whether a model keeps its contract: what `relnav check` and the tests ask of every model."""
