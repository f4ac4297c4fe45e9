"""Options of Algorithm 2, and the objective by which schedules are compared."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from ...model.checks import MAX_STEPS, positive
from ...model.keys import Key, NonNegative, Positive, Whole, check_fields

CHECKED = 1e-2  # share by which a bound keeps below a demand: a checker finds the bound within this share
Steps = Annotated[Whole, Field(ge=1, le=MAX_STEPS)]


@dataclass(frozen=True)
class Prices:
    """Objective of a flight: weighted time under U less priced velocity change and switches.

    All three count as shares of the horizon.
    """

    weights: tuple[float, ...]  # of the time under mode 1, 2, ...; 1 for modes beyond
    delta_v: float  # price of a velocity change of one `unit`
    switch: float  # price of a switch
    unit: float  # velocity change of S alone [m/s]

    def __call__(self, shares: Mapping[int, float], delta_v: float, switches: float) -> float:
        """Return the objective for shares of the time by mode, a velocity change [m/s] and switches."""
        weights = dict(enumerate(self.weights, start=1)) | {0: 0.0}
        time = sum(weights.get(mode, 1.0) * share for mode, share in shares.items())
        return time - self.delta_v * delta_v / self.unit - self.switch * switches


@dataclass(frozen=True)
class SwitchingRules:
    """Options of Algorithm 2 beyond the paper.

    Parameters
    ----------
    strategy : {"greedy", "look_ahead"}
        `greedy`: Algorithm 2, U whenever it is safe now. `look_ahead`: most use of U over the horizon, by
        weight; never less than `greedy`.
    min_dwell : int
        Least number of steps between switches (the dwell).
    max_switches : int, optional
        Largest number of switches (the cap). One is reserved for the return to S; 0 leaves S alone.
    weights : tuple of float
        Objective of one step under each experimental controller, in their order of preference.
    beam : int
        Width of the search of `look_ahead`: schedules kept per step, number of switches and controller.
    delta_v_price : float
        Share of U given up to save the delta-v of S alone.
    switch_price : float
        Share of U given up to save one switch.
    delta_v_max : float [m/s], optional
        Delta-v budget until the goal, or the end if the goal is not proven. Schedules provably keep it, with
        1 % spare; otherwise exit code 4. By default none.
    """

    strategy: Annotated[str, Key("strategy", "-", Literal["greedy", "look_ahead"])] = "greedy"
    min_dwell: Annotated[int, Key("min_dwell_steps", "steps", Steps)] = 1
    max_switches: Annotated[int | None, Key("max_switches", "-", Annotated[Whole, Field(ge=0)])] = None
    weights: tuple[float, ...] = ()
    beam: Annotated[int, Key("beam", "-", Annotated[Whole, Field(ge=1, le=1000)])] = 1
    delta_v_price: Annotated[float, Key("delta_v_price", "-", NonNegative)] = 0.06
    switch_price: Annotated[float, Key("switch_price", "-", NonNegative)] = 0.005
    delta_v_max: Annotated[float | None, Key("delta_v_max_m_s", "m/s", Positive)] = None

    def __post_init__(self) -> None:
        check_fields(self, "schedule")
        for weight in self.weights:
            positive("schedule.weights", weight, "-")

    def mode_values(self, modes: int) -> tuple[float, ...]:
        """Return the objective of a step under each mode: 0 under S, 1 where no weight is given."""
        weights = (0.0, *self.weights)[:modes]
        return weights + (1.0,) * (modes - len(weights))

    def prices(self, unit: float) -> Prices:
        """Return the objective by which schedules are compared; S alone spends `unit` [m/s]."""
        return Prices(self.weights, self.delta_v_price, self.switch_price, unit)

    def affords(self, delta_v: float) -> bool:
        """Return True if the budget allows a velocity change [m/s]."""
        return self.delta_v_max is None or delta_v * (1 + CHECKED) <= self.delta_v_max
