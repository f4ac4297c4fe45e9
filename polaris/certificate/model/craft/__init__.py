"""Loop of the craft under its safety controller, and what errors need in it."""
