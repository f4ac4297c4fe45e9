"""Claims of a certificate, each derived again: safety, goal, velocity change, drifts, aborts."""
