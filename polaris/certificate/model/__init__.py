"""Plant, errors, controllers and surroundings of a certificate, as the checker models them."""
