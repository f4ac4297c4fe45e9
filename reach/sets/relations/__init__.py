"""Questions about two sets: distance, separation, containment."""
