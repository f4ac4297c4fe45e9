"""The scenario file's model of the orbit: what acts on both craft that Hill's linear equations leave out."""

from __future__ import annotations

from .fields import NonNegative, Positive, Real, ScenarioPart, unit


class Orbit(ScenarioPart):
    """The target's real orbit: near a circle of the system's mean motion, perturbed by J2 and drag.

    What is declared here bounds the difference between Hill's linear equations and the nonlinear motion;
    `polaris model-error` works it out, and the system's disturbance bound must cover it. The target must stay
    within the deviations from the circle for as long as a guarantee is to hold.
    """

    inclination_max_deg: Real = unit(
        "deg",
        "Largest angle between the plane of the orbit and that of the equator, at any time; a retrograde "
        "orbit counts from its own side. 90 covers every orbit.",
        default=90.0,
        ge=0,
        le=90,
    )
    radius_deviation_max_m: NonNegative = unit(
        "m", "How far the target's distance from the Earth's centre may be off that of the circle."
    )
    radial_rate_max_m_s: NonNegative = unit("m/s", "Largest rate at which that distance changes.")
    rate_deviation_max: Real = unit(
        "-", "How far the frame's rate about the orbit normal may be off, as a share of it.", ge=0, le=0.1
    )
    density_kg_m3: NonNegative = unit("kg/m^3", "Density of the air at the radius of the circle; 0 for none.")
    scale_height_m: Positive = unit(
        "m", "Height over which the density falls by a factor of e, the smallest that may occur."
    )
    ballistic_coefficient_m2_kg: NonNegative = unit(
        "m^2/kg", "Drag coefficient times area over mass of the target."
    )
    ballistic_difference_max_m2_kg: NonNegative = unit(
        "m^2/kg", "How far any other craft's may be off the target's."
    )
    other_acceleration_max_m_s2: NonNegative = unit(
        "m/s^2",
        "Bound on everything else that accelerates the chaser relative to the target: errors of thrust, "
        "radiation pressure, plumes, higher harmonics.",
        default=0.0,
    )
