"""Explicit active set invariance filter for one flight, call by call, that never passes on bad input."""

import numpy as np

from ...model.checks import number, of_kind
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.filter_input import FilterInput
from ...rta.one_call import Backup, CallByCall, RawDecision, by_name
from ...rta.projection import DESIRED, FAILED, FILTERED, SHORT
from ..constraints.families import BarrierRows
from ..vectors import dot
from .explicit import Centralized, Decentralized

TIGHT = 1e-7  # a condition counts as active if the input misses equality by less [N]


class ActiveSetFilter(CallByCall):
    """Nearest input that keeps every constraint (eq. 5), with defined answers to bad input.

    - A deputy whose state is unknown is taken to be where its last state and thrust lead (see
      `InputCheck`); where that is not known either, every deputy coasts, which h7 and h8
      keep clear of collisions for T.
    - The desired input of a deputy whose state is unknown, or that is missing or not finite itself, is
      replaced by the backup controller's, which is then filtered.
    - Where no input satisfies all conditions, the one that violates them least is used, separations before
      speeds, speeds before the zone, the zone before the sun (see `priorities`); should the program
      fail altogether, the backup controller's.

    The desired input is never passed on in any of these cases, and `Decision.fallback` says which it was.

    Parameters
    ----------
    filtering : Centralized or Decentralized
        Its answers are for the period of sampled data if its constraints are tightened for that.
    backup : Backup, optional
        Default: no thrust.
    sun_start : float
        Angle of the sun at t = 0 [rad].
    """

    def __init__(
        self, filtering: Centralized | Decentralized, backup: Backup | None = None, sun_start: float = 0.0
    ) -> None:
        of_kind("filtering", filtering, Centralized | Decentralized)
        if backup is not None and not callable(backup):
            raise ScenarioError("backup", backup, "must be a function of the time and the states")
        self.filtering, self.backup = filtering, backup
        self.sun_start = number("sun_start", sun_start)
        self.families, self.inspection = filtering.families, filtering.families.inspection
        sampled = self.families.sampled
        labels, names = np.array(self.families.labels), self.families.labels
        self._words = (*names, *(f"thrust[{i}]" for i in range(self.inspection.deputies)))
        self._limit = self.inspection.thrust_max * (1 - 1e-12)
        # Several rows may stand for one constraint; they follow each other.
        self._starts = np.flatnonzero(np.append(True, labels[1:] != labels[:-1]))
        self._names = tuple(labels[self._starts].tolist())
        self._nobody = np.zeros(self.inspection.deputies, dtype=bool)
        self._nobody.flags.writeable = False
        super().__init__(self.inspection, None if sampled is None else sampled.period)
        if filtering.loops:  # what compiles them, or reads them from disk, is not left to the first decision
            at_rest = np.zeros((1, self.inspection.deputies, 6))
            filtered = filtering.batch(at_rest, np.zeros(1), at_rest[..., :3].copy())
            self._active(filtered.rows, np.zeros_like(filtered.u[0]))

    def reset(self) -> None:
        """Forget the last states: a new flight begins."""
        self._receiver.forget()

    def decide(self, call: FilterInput) -> RawDecision:
        """Answer a call that has been received, by this filter or by one that rests on it."""
        notes: list[str] = []
        desired, on_backup, regular = call.wanted, self._nobody, call.whole
        if not regular:
            if not call.estimated.all():
                return RawDecision(np.zeros_like(call.u), ~on_backup, on_backup, ~on_backup, {}, [])
            on_backup = ~(call.given & call.known)
            if on_backup.any():
                desired = np.where(on_backup[:, None], self._backed_up(self.backup, call, notes), desired)
        sun = np.array([self.sun_start - self.inspection.mean_motion * call.t])
        filtered = self.filtering.batch(call.x[None], sun, desired[None])
        u, status, rows = filtered.u[0], filtered.status[0], filtered.rows
        worst, changed = max(status.tolist()), status > DESIRED
        failed = self._nobody
        if worst == FAILED:
            failed, regular = status == FAILED, False
            notes.append("the program failed")
            u = np.where(failed[:, None], self._backed_up(self.backup, call, notes), u)
        if worst > FILTERED or not regular:
            changed = (u != desired).any(axis=1) | on_backup
            on_backup = on_backup | failed
        values = rows.h[0]
        if len(values) > len(self._names):
            values = np.minimum.reduceat(values, self._starts)
        margins, short = by_name(self._names, values), worst == SHORT
        answer = RawDecision(
            u, changed, on_backup, self._nobody, margins, notes, short=short, regular=regular
        )
        if worst > DESIRED or True in changed.tolist():
            answer.active = self._active(rows, u)
        if worst >= SHORT:
            gap = np.maximum.reduceat(self.families.missed(rows, u[None])[0], self._starts)
            answer.missed = {self._names[k]: float(gap[k]) for k in np.flatnonzero(gap > TIGHT).tolist()}
        if answer.short:
            notes.append(
                f"no input satisfies all conditions: least violation, misses {_missed_text(answer.missed)}"
            )
        return answer

    _answer = decide

    def _active(self, rows: BarrierRows, u: Array) -> tuple[str, ...]:
        """Constraints whose condition holds with equality, and thrust limits that are reached."""
        G, bound, families, full = rows.G[0], rows.bound[0], self.families, self._limit
        if self.filtering.loops:
            tight = self.filtering.loops.tight(G, bound, families.first, families.second, u, TIGHT, full)
        else:
            equality = dot(G, families.relative(u)) - bound <= TIGHT * np.abs(G).sum(axis=1)
            tight = np.flatnonzero(np.append(equality, np.abs(u).max(axis=1) >= full))
        return tuple(dict.fromkeys([self._words[k] for k in tight.tolist()]))


def _missed_text(missed: dict[str, float], count: int = 5) -> str:
    """Return the conditions missed by most, `count` of them, in words."""
    worst = sorted(missed.items(), key=lambda item: -item[1])
    text = (
        ", ".join(f"{name} by {value:.3g} N" for name, value in worst[:count]) or "none by more than rounding"
    )
    return f"{text} and {len(worst) - count} more" if len(worst) > count else text
