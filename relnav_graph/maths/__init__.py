"""Arrays only: linear algebra, rotations, the state manifold, orbits, frames, losses, inertia."""
