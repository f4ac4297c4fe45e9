"""The target's orbit in a scenario: what bounds it, its elements, and where both may come from."""

from typing import Annotated, Any, Literal

from pydantic import Field

from ...model import keys as f
from ...simulation.orbit.environment import Environment
from ...simulation.orbit.inertial import state_of_elements
from ...simulation.orbit.oem import Frame, TimeSystem, parse_epoch
from .fields import Described, ScenarioPart, unit

Below = Annotated[f.Real, Field(ge=0, lt=0.2)]
Turn = Annotated[f.Real, Field(ge=-360, le=360)]


class Elements(ScenarioPart):
    """Osculating Kepler elements of the target at time 0, about the Earth."""

    epoch: f.Text = unit("-", "Time 0, such as 2026-01-31T12:00:00.0.", min_length=1, max_length=40)
    semi_major_axis_m: f.Positive = unit("m", "Semi-major axis.")
    eccentricity: Below = unit("-", "Eccentricity.")
    inclination_deg: Annotated[f.Real, Field(ge=0, le=180)] = unit("deg", "Inclination.")
    ascending_node_deg: Turn = unit("deg", "Right ascension.")
    perigee_deg: Turn = unit("deg", "Argument of perigee.")
    true_anomaly_deg: Turn = unit("deg", "True anomaly.")
    frame: Frame = unit("-", "Inertial frame.", default="EME2000")
    time_system: TimeSystem = unit("-", "Time system.", default="UTC")

    def state(self) -> Any:
        """Inertial state (6,) [m, m/s]."""
        a, e = self.semi_major_axis_m, self.eccentricity
        values = self.arguments()
        angles = ["inclination_deg", "ascending_node_deg", "perigee_deg", "true_anomaly_deg"]
        return state_of_elements(a, e, *(values[self.python_names()[key]] for key in angles))

    def nanoseconds(self) -> int:
        """Epoch [ns]."""
        return parse_epoch(self.epoch)


class Orbit(Described, makes=Environment):
    """See `Environment`."""

    elements: Elements | None = unit("-", default=None)
    """Inertial state of the target, for `polaris export oem`."""


class OrbitSource(ScenarioPart):
    """Keys of ``[orbit]`` that others follow from; a run folder holds the derived ones."""

    two_line_elements: tuple[f.Text, f.Text] | None = unit("-", default=None)
    """Two lines of elements for SGP4."""
    ephemeris: f.Text | None = unit("-", default=None)
    """File of the target's ephemeris, a CCSDS OEM (502.0) in KVN; its place is relative to the scenario's."""
    epoch: f.Text | None = unit("-", default=None)
    """Time 0 of the scenario, in the time system of the source; its first epoch by default, that of the first
    covariance if a start set is read too."""

    within_m: f.Positive | None = unit("m", default=None)
    """Distance up to which `system.disturbance_max_m_s2`, if it is not given, covers what the linear model
    leaves out, at speeds up to twice the mean motion, or twice in the horizon if that is more, times it."""


class StartSource(ScenarioPart):
    """A start set from two ephemerides: the chaser's here, the target's in ``[orbit]``."""

    kind: Literal["ephemeris"] = unit("-", "Start set from ephemerides.")
    ephemeris: f.Text = unit("-", "File of the chaser's ephemeris, a CCSDS OEM (502.0) in KVN.")
    sigma: Annotated[f.Real, Field(gt=0, le=10)] = unit("-", default=3.0)
    """Multiple of the standard deviation up to which errors are covered: an assumption."""
    velocity_frame: Literal["inertial", "rotating"] = unit("-", default="inertial")
    """Whose velocities a covariance in RTN is about: those that an inertial observer sees, given along the
    axes of RTN (UVW of spaceflight safety), or those that an observer sees who turns with RTN."""
