"""S along one path to the end of time: the limits that it keeps, and what errors need along any rows."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from flint import arb_mat

from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import above, magnitude
from ..kernel.zonotopes import Zonotope, widest
from ..model.craft.craft import Craft
from ..model.craft.memory import Memory
from ..model.craft.needs import Differences, Needs
from ..model.craft.scheduled import Scheduled
from ..model.limits import Limits
from ..model.transients import lost, upset
from .coasting import prolonged
from .recovery import Recovery


@dataclass(frozen=True, eq=False)
class Tracker:
    """The safety controller from any of some sets: its loop, how long it remembers, and needs along rows."""

    document: Document
    craft: Craft
    memory: Memory
    upsets: Sequence[arb_mat]  # boxes, one of which holds what a fault adds until it is isolated
    _known: dict[Any, Needs] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, document: Document, craft: Craft, upsets: Sequence[arb_mat], sets: Sequence[Zonotope]
    ) -> "Tracker":
        """From errors within any of the sets."""
        memory = Memory.of(craft, widest([*sets], upsets), document.q, document.profile)
        return cls(document, craft, memory, upsets)

    def needs(self, of: Any, rows: arb_mat) -> Needs:
        """Return what errors, and a fault that is isolated late, need along rows; `of` names the rows."""
        if of not in self._known:
            doc, needs = self.document, Needs(self.craft, self.memory, rows)
            if doc.transients:
                needs = replace(needs, upset=upset(needs, [*self.upsets], self._outages))
            self._known[of] = needs
        return self._known[of]

    @cached_property
    def _outages(self) -> list[Differences]:
        return lost(self.document, self.craft, self.memory)

    @property
    def commands(self) -> arb_mat:
        """Rows of what it feeds back, of both signs."""
        return above(self.craft.commands, -self.craft.commands)


@dataclass(frozen=True, eq=False)
class Continuation:
    """The tracker along one path, which the document has for its reference."""

    document: Document
    path: Path
    tracker: Tracker
    facets: Sequence[list[int]] = ()  # others of the same tracker, so that rows of limits are the same

    @cached_property
    def further(self) -> tuple[Path, list[list[int]]]:
        """The path and its facets until the loop has forgotten what it was at T."""
        return prolonged(self.document, self.path, self.tracker.memory)

    @cached_property
    def scheduled(self) -> Scheduled | None:
        """Errors by the time of the flight, if there are any."""
        by_step = self.document.error_by_step and self.tracker.craft.base is not None
        if not (self.document.profile or by_step):
            return None
        return Scheduled(self.document, self.tracker.craft, self.tracker.memory, self.further[0])

    @cached_property
    def recovery(self) -> Recovery:
        """Its limits against what errors need along their rows."""
        path, chosen = self.further
        chosen = [*chosen, *self.facets]
        limits = Limits.of(self.document, path, self.tracker.craft, chosen)
        asked = frozenset(pair for row in chosen for pair in enumerate(row))
        needs = self.tracker.needs(asked, limits.rows)
        return Recovery.of(self.document, path, limits, needs, self.scheduled)

    def keeps(self, reached: dict[int, Zonotope], margins: dict[int, float] | None = None) -> float:
        """Check that every limit is kept to the end from sets at nodes, by a share of its room.

        Returns the least share that was found where a set comes close.
        """
        least = self.recovery.check_sets(reached, margins or {})
        self.recovery.check_far()
        return least

    @cached_property
    def jump(self) -> arb_mat:
        """Size of the step of the reference at the start of the tail, shape (n, 1)."""
        return magnitude(self.path.jump)
