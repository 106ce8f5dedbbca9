"""Published observers, each for one system: no general machinery, and none of it changed."""
