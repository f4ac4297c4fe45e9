"""The constraints of the second paper, as barriers."""
