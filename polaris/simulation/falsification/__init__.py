"""The search for a counterexample: closed loops that do their worst against what a schedule claims."""
