"""Safety controller: limits along its reference, continuations that keep them, and Algorithm 1."""
