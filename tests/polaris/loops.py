"""The checker's loop of a tracking error alone, for tests of what it derives from one."""

from flint import arb

from polaris.certificate.kernel.balls import identity
from polaris.certificate.model.craft.states import States


def loop_of_errors(plant, gain):
    """Build the loop of a law that sees its error exactly and at once, under a disturbance alone."""
    n = plant.A.nrows()
    nothing = [arb(0)] * n
    return States.from_plant(plant).closed(gain, [plant.disturbance], (identity(n), nothing), nothing)
