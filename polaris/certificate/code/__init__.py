"""Flight code of a certificate: its text, the answer to each call, and the check of its tables."""
