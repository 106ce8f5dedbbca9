"""Arrays only: algebra, rotations, the state manifold, orbits, the Earth, losses, inertia."""
