"""Which schedules to prefer to the greedy one: a search over the same proven steps.

Every sequence of modes that is looked at has been proven step by step, as Algorithm 2 proves its own;
the search decides only which of them are looked at. It keeps the best schedules for each number of
switches apart, so that one which has paid for a switch is not displaced by one which has not, and it
searches under stricter dwell times too. Neither depends on the rules asked for, which only pick among
earlier results: loosening a rule never makes the result worse.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from reach.sets.zonotope import Zonotope

SAFETY = 0  # mode number of S
APART = 12  # schedules with as many switches or more are kept together
EACH = 8  # greedy schedules are made under every dwell time up to here

Prove = Callable[[Zonotope, int, int], Zonotope | None]
"""The set that a mode reaches from a set over a step, or None if it is not proven there."""


@dataclass(frozen=True, eq=False)
class _Place:
    """Place that a sequence of modes leads to, under any rules; its successors are worked out once."""

    k: int
    reached: Zonotope
    mode: int = SAFETY
    before: "_Place | None" = None
    after: dict[int, "_Place | None"] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Path:
    """A place with its account: `total` switches, the return to S included."""

    place: _Place
    objective: float = 0.0
    switches: int = 0

    @property
    def total(self) -> int:
        return self.switches + (self.place.mode != SAFETY)


@dataclass(frozen=True, eq=False)
class LookAhead:
    """The search, for K steps from a set."""

    start: Zonotope
    K: int
    prove: Prove  # see `Prove`
    size: Callable[[Zonotope], float]  # reach from the reference: at equal objective the nearer is kept
    objective: tuple[float, ...]  # of one step under each mode; 0 for S
    beam: int  # schedules kept at each step for each number of switches and mode

    def best(
        self, dwell: int, cap: int | None, progress: Callable[[int, int], None] | None = None
    ) -> tuple[int, ...]:
        """Modes of the best schedule found under a dwell time [steps] and a cap on switches.

        Never worse than greedy under the same rules, nor than itself or greedy under a lower cap or a longer
        dwell time of up to `EACH` steps or among `dwell_times`.
        """
        root, tried = _Place(0, self.start), dwell_times(dwell, self.K)
        highest = self.K if cap is None else cap
        bars = [0.0] * (self.K + 2)  # objective with so many switches or fewer, under stricter dwell times
        best, done, searched = _Path(root), 0, 0
        for d in sorted({dwell, *tried, *range(dwell, min(EACH, self.K) + 1)}, reverse=True):
            uncapped = self._greedy(root, d, self.K)
            paths = [uncapped]
            if uncapped.total > highest or len(self.objective) > 2:
                # With one controller a lower cap cuts the end off; with several it may change the beginning.
                least = 0 if len(self.objective) > 2 else highest
                paths += [self._greedy(root, d, c) for c in range(least, min(highest, uncapped.total) + 1)]
            best = max([best, *(path for path in paths if path.total <= highest)], key=_merit)
            if d in tried or d <= EACH:
                _raise(bars, [uncapped])
            if d not in tried:
                continue
            for k, added in enumerate(self._search(root, d, highest, bars)):
                best = max([best, *(path for path in added if path.total <= highest)], key=_merit)
                step = (searched * self.K + k + 1) // len(tried)
                if progress and step > done:
                    progress(step, self.K)
                    done = step
            searched += 1
        place: _Place | None = best.place
        modes = []
        while place is not None and place.before is not None:
            modes.append(place.mode)
            place = place.before
        return (*reversed(modes), *[SAFETY] * (self.K - len(modes)))

    # -- the rules ------------------------------------------------------------------------------------

    def _greedy(self, root: _Place, dwell: int, cap: int) -> _Path:
        """Algorithm 2's own choice: the first controller that is proven for its dwell, else S."""
        path, age = _Path(root), dwell
        while path.place.k < self.K:
            mode = path.place.mode
            for following in range(1, len(self.objective)):
                stays = following == mode
                if stays or age >= dwell:
                    longer = self._go(path, following, 1 if stays else dwell)
                    if longer is not None and (stays or longer.total <= cap):
                        break
            else:
                longer = self._go(path, SAFETY, 1)
            assert longer is not None
            age = longer.place.k - path.place.k + (age if longer.place.mode == mode and path.place.k else 0)
            path = longer
        return path

    def _search(self, root: _Place, dwell: int, cap: int, bars: list[float]) -> Iterator[list[_Path]]:
        """Beam search under one dwell time; yields the paths that every step adds, and raises the bars by it.

        A path is flown for a whole dwell time where it changes its mode: all that wait may change again.
        It is given up where U for all the rest would not take it over the bar of its switches. What waits
        with s switches does so whatever has more, and whatever the cap is.
        """
        highest = max(self.objective)
        waiting: list[dict[tuple[int, int], list[_Path]]] = [{} for _ in range(self.K + 1)]
        waiting[0][0, SAFETY] = [_Path(root)]
        for k in range(self.K):
            added = []
            potential = (self.K - k) * highest
            groups = {
                key: [path for path in paths if path.objective + potential > bars[path.total]]
                for key, paths in waiting[k].items()
            }
            for path in self._beam(groups):
                for mode in range(len(self.objective)):
                    stays = mode == path.place.mode and k > 0
                    switches = path.switches + (k > 0 and not stays) + (mode != SAFETY)
                    # From S only a return to U, for two switches more, could still add anything.
                    if cap < APART and switches + 2 * (mode == SAFETY) > cap:
                        continue
                    longer = self._go(path, mode, 1 if stays else dwell)
                    if longer is not None:
                        key = min(longer.total, APART), longer.place.mode
                        waiting[longer.place.k].setdefault(key, []).append(longer)
                        added.append(longer)
            waiting[k] = {}
            _raise(bars, added)
            yield added

    def _beam(self, groups: dict[tuple[int, int], list[_Path]]) -> list[_Path]:
        """Return the beam: of each group the best by objective and the nearest, and some in between.

        Paths are left out first if another is as good and as near, with no more switches.
        """
        beam: list[_Path] = []
        fronts: dict[int, list[tuple[float, float]]] = {}
        for (_, mode), paths in sorted(groups.items(), key=lambda item: item[0]):
            sizes = {id(path): self.size(path.place.reached) for path in paths}
            front = fronts.setdefault(mode, [])
            chosen = []
            for path in sorted(paths, key=lambda p: (-p.objective, sizes[id(p)])):
                point = path.objective, sizes[id(path)]
                if not any(w >= point[0] and s <= point[1] for w, s in front):
                    front.append(point)
                    chosen.append(path)
            last, places = len(chosen) - 1, min(self.beam, len(chosen))
            beam += [chosen[i * last // max(places - 1, 1)] for i in range(places)]
        return beam

    def _go(self, path: _Path, mode: int, steps: int) -> _Path | None:
        """Return the path after some steps under a mode, or to the end; None if they are not all proven."""
        place: _Place | None = path.place
        switched = path.place.k > 0 and mode != path.place.mode
        for _ in range(min(steps, self.K - path.place.k)):
            assert place is not None
            if mode not in place.after:
                reached = self.prove(place.reached, place.k, mode)
                after = None if reached is None else _Place(place.k + 1, reached, mode, place)
                place.after[mode] = after
            place = place.after[mode]
            if place is None:
                return None
        assert place is not None
        gain = (place.k - path.place.k) * self.objective[mode]
        return _Path(place, path.objective + gain, path.switches + switched)


def dwell_times(dwell: int, K: int) -> tuple[int, ...]:
    """Dwell times searched: 1, 2, 3, 4, and then each half as much again, from the one asked for to K."""
    ladder = [1, 2, 3]
    while ladder[-1] < K:
        ladder.append(max(4, ladder[-1] * 3 // 2))
    return (*(d for d in ladder if dwell <= d < K), K)


def _merit(path: _Path) -> tuple[float, int]:
    """Rank a path by largest objective, then by fewest switches."""
    return path.objective, -path.switches


def _raise(bars: list[float], paths: list[_Path]) -> None:
    """Note the objectives of paths; S alone may follow each of them to the end."""
    for path in paths:
        for s in range(path.total, len(bars)):
            if bars[s] >= path.objective:
                break
            bars[s] = path.objective
