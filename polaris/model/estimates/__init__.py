"""How far estimates may be off: an observer's, and predictions from them."""
