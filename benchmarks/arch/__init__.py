"""Public ARCH-COMP reachability benchmarks of linear and switched affine systems."""
