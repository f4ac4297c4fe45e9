"""What the world is: systems, obstacles, distances, and what every other room needs."""
