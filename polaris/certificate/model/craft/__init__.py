"""Loop of the craft under its safety controller, and the tightening by its errors."""
