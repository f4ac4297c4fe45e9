"""Deliberate defects in what is proven and in its checker, each with a quick test that must notice it.

    python -m benchmarks.mutations [N ...]

Every defect is a slip by which a bound is too small, or a claim passes unchecked. It is written into a copy
of the tree in a temporary folder, and its test is run there. The exit code is 1 if a defect is not caught.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PARTS = "polaris", "reach", "scenarios", "tests", "pyproject.toml"

DEFECTS = """\
# Channels and sources
synthesis/tracker/tightening.py
- fixed + (np.linalg.norm(gains, axis=1) * sizes[0] if channel.ball else gains @ sizes)
+ fixed
! synthesis/tracker/test_loop.py::test_intersample_bounds_count_the_rate_at_a_node_and_what_pushes_within_the_period
synthesis/tracker/tightening.py
- (min(channel.lag, len(bound)), 1)
+ (max(min(channel.lag, len(bound)) - 1, 0), 1)
! synthesis/schedule/test_hand_over.py::test_no_flight_needs_more_after_a_hand_over_than_both_sides_say
synthesis/tracker/tightening.py
- self.sizes(channel, self.u_max if channel.lag else bound[0])
+ self.sizes(channel, bound[0])
! synthesis/schedule/test_hand_over.py::test_what_is_remembered_from_before_a_hand_over_is_as_large_as_the_thrusters_allow
synthesis/safety/feedforward.py
- later += effect.at_nodes(np.maximum(sizes[T:] - last, 0.0)) + effect.ever(last)
+ later += effect.ever(last)
! synthesis/schedule/test_hand_over.py::test_later_turns_of_the_tail_are_bounded_by_the_first
certificate/model/craft/feedforward.py
- excess, steady = gains.summed([_over(size, last) for size in sizes[T:]]), gains.always(last)
+ excess, steady = gains.summed([_over(size, size) for size in sizes[T:]]), gains.always(last)
! synthesis/schedule/test_hand_over.py::test_later_turns_of_the_tail_are_bounded_by_the_first
synthesis/sources/observer.py
- measures @ self.offset + measures @ offset
+ measures @ self.offset
! synthesis/tracker/test_loop.py::test_an_offset_of_the_state_counts_as_an_error_of_what_is_measured
model/estimates/prediction.py
- (1.0 if mid else AT_NODES * bool(timing.delay)) * np.array(timing.intersample_offset or 0.0)
+ 0.0 * np.array(timing.intersample_offset or 0.0)
! synthesis/schedule/test_hand_over.py::test_no_flight_needs_more_after_a_hand_over_than_both_sides_say
model/estimates/prediction.py
- 2 * timing.jitter / h
+ timing.jitter / h
! model/test_timing.py::test_commands_out_of_time_are_other_commands_on_time_and_an_impulse_that_is_shifted
synthesis/tracker/tightening.py
- self.factor * sizes.max(axis=0)
+ self.factor * sizes[0]
! synthesis/tracker/test_loop.py::test_the_remainder_bounds_every_state_that_is_left_at_any_later_node
# What S recovers from, and where it takes over
synthesis/safety/continuation.py
- tightening[:, self.clearance.limits.levels :] += np.hstack([falls, falls])
+ tightening += 0 * falls.sum()
! synthesis/tracker/test_margins.py::test_commands_of_recoverable_errors_keep_below_what_errors_of_thrusters_are_booked_for
synthesis/safety/continuation.py
- np.repeat([0, 1, 0], [len(lag)
+ np.repeat([0, 0, 0], [len(lag)
! synthesis/tracker/test_margins.py::test_no_limit_is_left_out_however_late
synthesis/safety/continuation.py
- clearance.planned * clearance.q)
+ clearance.cells * clearance.q)
! synthesis/tracker/test_margins.py::test_all_of_a_tail_that_is_flown_again_lies_ahead_of_every_node_in_it
synthesis/schedule/abort_branch.py
- at_nodes(tube.intersample), until[k])
+ at_nodes(tube.intersample), until[k - 1] if k else 0.0)
! synthesis/schedule/test_powered_abort.py::test_a_tank_counts_the_step_in_which_u_is_aborted_and_of_s_all_before
synthesis/schedule/spending.py
- thrust.sum(axis=-1).max(axis=0).sum()
+ thrust.sum(axis=-1)[1].sum()
! synthesis/schedule/test_arrival.py::test_the_velocity_change_goes_on_for_as_long_as_s_corrects
synthesis/safety/carried_rows.py
- self.tracking.settled_tightening(self.rows) + self._transient[-1]
+ self.tracking.settled_tightening(self.rows)
! synthesis/schedule/test_powered_abort.py::test_long_after_a_takeover_a_fault_still_keeps_an_abort_from_its_orbit
# The checker
certificate/model/craft/tightening.py
- (first + later / (1 - self.settling.c))
+ first
! certificate/test_recovery.py::test_everything_that_is_older_than_the_horizon_counts_to_the_last_digit
certificate/model/limits.py
- if place == 0 and cell > 0 and not first:
+ if place == 0 and cell > 0 and first:
! certificate/test_recovery.py::test_a_limit_that_nothing_meets_is_noticed_wherever_it_is
certificate/model/craft/tightening.py
- max(lag - periods + 1, 0)
+ max(lag + 1, 0)
! synthesis/schedule/test_hand_over.py::test_no_flight_needs_more_after_a_hand_over_than_both_sides_say
certificate/claims/continuation.py
- self.recovery.check_far()
+ pass
! certificate/test_recovery.py::test_a_flight_keeps_no_limit_that_nothing_meets_even_if_no_share_is_claimed
certificate/claims/drift.py
- column(intersample) + column(self.state_offset) + deviation
+ column(intersample) + deviation
! certificate/test_certificate_math.py::test_thrust_may_stop_where_pulses_or_jitter_displace_the_craft
certificate/claims/argument.py
- steps[k].nodes if mode > 0 and (doc.transients or self.code is not None) else []
+ []
! certificate/test_recovery.py::test_s_takes_over_at_any_node_where_a_fault_is_isolated_late
certificate/claims/continuation.py
- parts.append((magnitude(tightenings.rows) * column(self.document.at_nodes)).entries())
+ pass
! certificate/test_recovery.py::test_a_goal_is_missed_by_what_displaces_states_at_nodes_and_commands_are_not
certificate/kernel/periods.py
- for push in (*self.constant, *self.pushes):
+ for push in (*self.constant, *self.pushes)[:1]:
! certificate/test_certificate_math.py::test_a_period_counts_every_push_at_its_end_and_on_the_way
certificate/claims/flights.py
- [limit - upset for limit, upset in zip(node, tightenings, strict=True)] for node in clearance
+ list(node) for node in clearance
! certificate/test_certificate_math.py::test_a_step_of_u_leaves_room_for_what_a_fault_adds_until_it_is_isolated
certificate/claims/mean_spending.py
- box = motion.uneven(*steady, InputSet.in_box(plant.B, list(error[:m])))
+ box = motion.uneven(*steady)
! certificate/test_certificate_math.py::test_what_errors_do_within_a_period_is_answered_in_the_next
certificate/kernel/motion.py
- h / 2 * (a + b) + h**3 / 12 * c
+ h / 2 * (a + b)
! certificate/test_certificate_math.py::test_a_gain_that_bends_upwards_is_more_than_its_trapezoid
certificate/kernel/zonotopes.py
- rests.append([x - a * y for x, y in zip(columns[j], u, strict=True)])
+ pass
! certificate/test_certificate_math.py::test_nearly_parallel_generators_are_merged_with_each_other
certificate/claims/recovery.py
- reach + intersamples.next_to(lag)[row] + disturbance
+ reach + disturbance
! certificate/test_recovery.py::test_between_nodes_a_set_needs_what_its_motion_bends_however_exactly_it_is_looked_at
certificate/model/transients.py
- worst = _peak([worst, *steady, *at_lag])
+ worst = _peak([*steady, *at_lag])
! certificate/test_recovery.py::test_a_fault_may_have_been_isolated_in_any_period_since_a_hand_over
certificate/claims/recovery.py
- self._check_late(k, reached[k], share)
+ pass
! certificate/test_recovery.py::test_a_share_that_is_claimed_is_left_of_limits_beyond_the_memory_too
certificate/claims/arrival.py
- delta_v = self.delta_v_until(node) if reached else self.cost + self.correcting(node)
+ delta_v = self.cost
! synthesis/schedule/test_arrival.py::test_what_s_corrects_after_t_is_part_of_the_velocity_change
"""  # noqa: E501
"""Of each defect a file of the package, a text that occurs once in it, what stands there instead, a test."""


@dataclass(frozen=True)
class Defect:
    """A text in a file of the package, what stands there instead, and the test that fails then."""

    file: str
    old: str
    new: str
    test: str

    def caught(self, tree):
        """Write the defect into a tree, run its test, put the file back; return True if the test fails."""
        file = tree / "polaris" / self.file
        text = file.read_text(encoding="utf-8")
        if text.count(self.old) != 1:
            raise SystemExit(f"{self.file}: a text occurs {text.count(self.old)} times, not once: {self.old}")
        file.write_text(text.replace(self.old, self.new), encoding="utf-8")
        test = ["-m", "pytest", "-qxp", "no:cacheprovider", f"tests/polaris/{self.test}"]
        env = os.environ | {"PYTHONPATH": str(tree)}
        process = subprocess.run([sys.executable, *test], cwd=tree, env=env, capture_output=True, text=True)
        file.write_text(text, encoding="utf-8")
        if " failed" not in process.stdout and " passed" not in process.stdout:  # no test has run
            raise SystemExit(f"{self.test}: {process.stdout[-2000:]}{process.stderr[-2000:]}")
        return process.returncode == 1


def defects():
    """Return all defects."""
    lines = [line for line in DEFECTS.splitlines() if not line.startswith("#")]
    groups = [lines[i : i + 4] for i in range(0, len(lines), 4)]
    return [Defect(file, old[2:], new[2:], test[2:]) for file, old, new, test in groups]


def main():
    chosen = [int(each) for each in sys.argv[1:]]
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for part in PARTS:
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
            copy(ROOT / part, tree / part)
        for i, defect in enumerate(defects(), 1):
            if chosen and i not in chosen:
                continue
            begin, caught = time.monotonic(), defect.caught(tree)
            missed += not caught
            text = f"{i:2} {'caught' if caught else 'MISSED'} {time.monotonic() - begin:5.1f} s"
            print(f"{text}  {defect.file}: {defect.old}", flush=True)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
