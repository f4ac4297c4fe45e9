"""Motion that Hill's linear equations leave out: nonlinear relative motion with J2 and drag, and bounds."""
