"""Feed-forward networks: read, enclosed by zonotopes, in the loop with a linear system."""
