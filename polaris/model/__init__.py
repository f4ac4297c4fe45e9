"""Model of the world: systems, obstacles, distances, and basics that every other package uses."""
