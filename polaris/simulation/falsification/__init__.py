"""The search for a counterexample: closed loops that do their worst against a schedule's claims."""
