"""The physical models, one file each: kernels, Jacobians, noise. No estimator logic."""
