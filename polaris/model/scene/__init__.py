"""Surroundings: obstacles, keep-in sets and other spacecraft, and distances to them."""
